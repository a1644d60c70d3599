"""Listener: binds the port on every address of a host, serves the clients that connect, and publishes who they are.

With a certificate, which can be replaced while the server runs, connections are encrypted.
"""

import asyncio
import contextlib
import errno
import logging
import resource
import socket
import ssl
import struct
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from protocol.send_queue import SendBudget
from robot.logs import LogLimiter
from robot.stop_epochs import STOP_EPOCHS
from server.access.authorization import Access, unlimited
from server.access.rate_limits import is_loopback
from server.errors import ConfigurationError, StartError
from server.gateway.admission import AdmissionPolicy, ConnectionLimiter, check_exposure, host_addresses
from server.gateway.client_context import Gateway
from server.gateway.connection import Connection, Traffic
from server.gateway.http import HttpHandler
from server.gateway.settings import ServerSettings
from server.gateway.transport import TcpStream, Transport, keep_alive
from server.gateway.turns import MessageThreads, Turns
from server.gateway.websocket import WebSocket
from server.graph.permissions import Node
from server.graph.topics import Graph
from server.timers import CallLater, call_later

log = logging.getLogger("armbridge.gateway")

# Addresses that stand for all of this machine's.
EVERY_ADDRESS = ("0.0.0.0", "::")  # noqa: S104 - compared with, not bound

# Bytes of struct tcp_info (linux/tcp.h), and its member tcpi_unacked.
TCP_INFO_BYTES, TCPI_UNACKED_AT = 104, 24


class Tls:
    """A certificate with its key; ``context`` stays the same, each handshake gets the certificate read last.

    Raises ConfigurationError for files that cannot be used.
    """

    def __init__(self, certificate: Path, key: Path) -> None:
        self._certificate = certificate
        self._key = key
        self._log = LogLimiter()
        self._latest = self.context = self._read()
        # Called in every handshake, also when the client names no server.
        self.context.sni_callback = self._use_latest
        self.context.sslobject_class = _handshakes(self._log_plain_text)

    def reload(self) -> None:
        """Read the files again; files that cannot be used change nothing and are named in the log."""
        try:
            self._latest = self._read()
        except ConfigurationError as error:
            log.warning("the certificate stays as it was: %s", error)
        else:
            log.info("certificate read again: %s", self._certificate)

    def _use_latest(self, connection: ssl.SSLObject, _name: str | None, _context: ssl.SSLContext) -> None:
        connection.context = self._latest

    def _log_plain_text(self) -> None:
        """Log once that a client does not encrypt: asyncio closes its connection without a word."""
        line = "refused: a client speaks ws:// or http://, and here is wss:// and https://"
        self._log.write(log, logging.WARNING, line, "plain text")

    def _read(self) -> ssl.SSLContext:
        for setting, file in (("server.tls_certificate", self._certificate), ("server.tls_key", self._key)):
            try:
                file.open("rb").close()
            except OSError as error:
                raise ConfigurationError(f"{setting}: {file} cannot be read: {error.strerror or error}") from error
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.set_alpn_protocols(["http/1.1"])
        try:
            # Without an empty passphrase OpenSSL would ask for one at the terminal.
            context.load_cert_chain(self._certificate, self._key, "")
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                f"server.tls_key: {self._key} and the certificate in {self._certificate} cannot be used ({error}): they"
                " must be PEM, the key of this certificate, and without a passphrase"
            ) from error
        return context


def _handshakes(on_plain_text: Callable[[], None]) -> type[ssl.SSLObject]:
    """Return the class of a context's connections; it reports a client that begins with HTTP instead of TLS."""

    class Handshake(ssl.SSLObject):
        def do_handshake(self) -> None:
            try:
                super().do_handshake()
            except ssl.SSLError as error:
                if error.reason == "HTTP_REQUEST":
                    on_plain_text()
                raise

    return Handshake


COUNT_TOPIC = "/client_count"
LIST_TOPIC = "/connected_clients"

# Least time between two publications of the list: it names every client, and a thousand may come at once [s].
LIST_PERIOD_S = 0.25


class ClientList:
    """The connected clients, published after each change, but no more often than every `LIST_PERIOD_S`."""

    def __init__(self, graph: Graph, call_later: CallLater = call_later) -> None:
        self._graph = graph
        self._call_later = call_later
        self._node = Node("rosbridge_websocket")
        self._clients: dict[Node, dict[str, Any]] = {}
        # Runs while the next publication has to wait.
        self._pause: asyncio.TimerHandle | None = None
        self._changed = False

    def open(self) -> None:
        self._graph.advertise(self._node, COUNT_TOPIC, "std_msgs/msg/Int32", latch=True)
        self._graph.advertise(self._node, LIST_TOPIC, "rosbridge_msgs/msg/ConnectedClients", latch=True)
        self._publish()

    def close(self) -> None:
        if self._pause is not None:
            self._pause.cancel()

    def add(self, client: Node, address: str) -> None:
        connected = self._graph.message_types.now().as_message()
        self._clients[client] = {"ip_address": address, "connection_time": connected}
        self._change()

    def remove(self, client: Node) -> None:
        self._clients.pop(client, None)
        self._change()

    def _change(self) -> None:
        self._changed = True
        if self._pause is None:
            self._publish_change()

    def _publish_change(self) -> None:
        self._pause = None
        if self._changed:
            self._changed = False
            self._publish()
            self._pause = self._call_later(LIST_PERIOD_S, self._publish_change)

    def _publish(self) -> None:
        self._graph.publish(self._node, COUNT_TOPIC, {"data": len(self._clients)})
        self._graph.publish(self._node, LIST_TOPIC, {"clients": list(self._clients.values())})


# Browsers close at once; a client that does not must not hold up the end of the server.
CLOSE_TIMEOUT_S = 0.5

# RFC 8446 needs two round trips; a slow device computes for a second.
TLS_HANDSHAKE_TIMEOUT_S = 10.0
TLS_SHUTDOWN_TIMEOUT_S = 1.0

# Connections that wait to be accepted; a flood of one client's must not keep another's out of the queue.
BACKLOG = 1024

# Port 0 takes a free one of the first address, which another program may have on the next.
FREE_PORT_TRIES = 5

# The address is not there on this machine: without IPv6, ``localhost`` is 127.0.0.1 alone.
_NOT_HERE = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT)

# Family and address to listen on, as `getaddrinfo` returns them.
SocketAddress: TypeAlias = tuple[socket.AddressFamily, tuple[Any, ...]]

# Files besides the clients': of planners, the arm, recordings, the page, refused connections, and connections whose TLS
# handshake is not done. A server that may open few files keeps half of them for these.
SPARE_FILES = 256


class WaitingConnections:
    """Connections that wait at a listening socket until they are accepted, in the order in which they came."""

    def __init__(self, listening: socket.socket) -> None:
        self._listening = listening
        # Number of the connections that came before the last stop, and the epoch in which they count as arrived.
        self._older, self._epoch = 0, 0

    def date_unread(self) -> None:
        """Note that the connections that wait now have come before a stop."""
        try:
            info = self._listening.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_INFO_BYTES)
        except OSError:
            return
        if not self._older:
            self._epoch = STOP_EPOCHS.present
        # As tcp_get_info of net/ipv4/tcp.c fills tcpi_unacked for a socket that listens.
        (self._older,) = struct.unpack_from("=I", info, TCPI_UNACKED_AT)

    def accept(self) -> int:
        """Count the next connection, and return the stop epoch in which it came."""
        if not self._older:
            return STOP_EPOCHS.present
        self._older -= 1
        return self._epoch


class Listener:
    """Listener on one TCP port of every address of a host; clients may ask for any path and query.

    Raises ConfigurationError for a certificate that cannot be used.
    """

    def __init__(
        self,
        graph: Graph,
        settings: ServerSettings,
        http: HttpHandler | None = None,
        access: Access | None = None,
        *,
        takes_goals_along: bool = False,
    ) -> None:
        self._settings = settings
        self._host = settings.host
        self.port = settings.port
        self._http = http or HttpHandler()
        self._access = access or unlimited()
        self.admission = AdmissionPolicy(self._access, settings.classroom.values())
        pair = settings.tls_certificate, settings.tls_key
        self._tls = None if pair[0] is None or pair[1] is None else Tls(pair[0], pair[1])
        self._limiter = ConnectionLimiter(settings)
        self._sockets: list[socket.socket] = []
        self._tcp_sockets: list[socket.socket] = []
        self._waiting: dict[socket.socket, WaitingConnections] = {}
        # One a listening socket.
        self._servers: list[asyncio.Server] = []
        # Each connection from its `connection_made` to its `connection_lost`.
        self._transports: set[Transport] = set()
        self._clients = ClientList(graph)
        self._threads = MessageThreads()
        self._gateway = Gateway(
            graph,
            self._access,
            self.admission.auth_throttle,
            Turns(lambda call: asyncio.get_running_loop().call_soon(call), time.monotonic, self._threads),
            SendBudget(settings.max_queued_bytes),
            settings.limits,
            settings.ros_version,
            takes_goals_along,
        )
        self.traffic = Traffic()

    @property
    def tcp_port(self) -> int | None:
        return self._tcp_sockets[0].getsockname()[1] if self._tcp_sockets else None

    @property
    def url(self) -> str:
        return f"{'ws' if self._tls is None else 'wss'}://{self._place(self.port)}"

    @property
    def tcp_url(self) -> str | None:
        """Address of the port of raw TCP, for people; None for no such port."""
        scheme = "tcp" if self._tls is None else "tls"
        return None if self.tcp_port is None else f"{scheme}://{self._place(self.tcp_port)}"

    @property
    def page_url(self) -> str:
        return f"{'http' if self._tls is None else 'https'}://{self._place(self.port)}/"

    @property
    def page_urls_elsewhere(self) -> Sequence[str]:
        """URLs of the page for browsers on other machines; none for a server that listens to this machine only."""
        listening = [each.getsockname()[0] for each in self._sockets]
        found = [each for each in listening if each not in EVERY_ADDRESS]
        if len(found) < len(listening):
            found += host_addresses()
        scheme = "http" if self._tls is None else "https"
        addresses = [each for each in dict.fromkeys(found) if not is_loopback(each)]
        return [f"{scheme}://{f'[{each}]' if ':' in each else each}:{self.port}/" for each in addresses]

    def _place(self, port: int) -> str:
        return f"[{self._host}]:{port}" if ":" in self._host else f"{self._host}:{port}"

    async def bind(self) -> None:
        """Take the port; clients that connect now wait until :meth:`open`.

        Raises ConfigurationError for an address open to others, StartError for an address that cannot be taken.
        """
        places = await resolve(self._host, self.port)
        addresses = [str(address[0]) for _, address in places]
        check_exposure(self._host, addresses, self._access.tokens, insecure=self._access.settings.insecure)
        self._sockets = listen(places, self._host, self.port)
        self.port = self._sockets[0].getsockname()[1]
        if self._settings.tcp_port is not None:
            self._tcp_sockets = listen(places, self._host, self._settings.tcp_port, "--tcp-port")
            for each in self._tcp_sockets:
                keep_alive(each, self._settings.ping_interval_s, self._settings.ping_timeout_s)
        self._waiting = {each: WaitingConnections(each) for each in (*self._sockets, *self._tcp_sockets)}
        STOP_EPOCHS.receivers.update(self._waiting.values())

    async def open(self) -> None:
        if not self._sockets:
            raise AssertionError("open before bind")
        possible = raise_file_limit(self._settings.max_clients)
        if possible < self._settings.max_clients:
            self._limiter.reduce(possible)
        self._clients.open()
        shared = self._settings, self._limiter, self._transports, self._serve_client
        for each in self._sockets:
            await self._serve_on(each, lambda: WebSocket(*shared, self.admission, self._http))
        for each in self._tcp_sockets:
            await self._serve_on(each, lambda: TcpStream(*shared, self._access.tokens.anonymous))

    async def _serve_on(self, listening: socket.socket, make_transport: Callable[[], Transport]) -> None:
        def accept() -> Transport:
            transport = make_transport()
            transport.date_connection(self._waiting[listening].accept())
            return transport

        # asyncio refuses the time limits of TLS without it.
        tls: dict[str, Any] = {}
        if self._tls is not None:
            tls = {
                "ssl": self._tls.context,
                "ssl_handshake_timeout": TLS_HANDSHAKE_TIMEOUT_S,
                "ssl_shutdown_timeout": TLS_SHUTDOWN_TIMEOUT_S,
            }
        loop = asyncio.get_running_loop()
        self._servers.append(await loop.create_server(accept, sock=listening, backlog=BACKLOG, **tls))

    def reload_certificate(self) -> None:
        if self._tls is None:
            log.info("TLS is not configured (server.tls_certificate); nothing to reload")
        else:
            self._tls.reload()

    async def close(self) -> None:
        self._clients.close()
        for server in self._servers:
            server.close()
        leaving = list(self._transports)
        for transport in leaving:
            transport.leave()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(2 * CLOSE_TIMEOUT_S):
                for transport in leaving:
                    await transport.wait_ended()
        for transport in list(self._transports):
            transport.abort()
        STOP_EPOCHS.receivers.difference_update(self._waiting.values())
        for each in (*self._sockets, *self._tcp_sockets):
            each.close()
        self._threads.close()

    async def _serve_client(self, transport: Transport) -> None:
        connection = Connection(transport, self._gateway)
        self._clients.add(connection.node, connection.address)
        self.traffic.add(connection)
        try:
            await connection.run()
        finally:
            self._clients.remove(connection.node)
            self.traffic.remove(connection)


async def resolve(host: str, port: int) -> list[SocketAddress]:
    """Resolve the addresses of a host, empty for every address of this machine, or raise StartError."""
    try:
        found = await asyncio.get_running_loop().getaddrinfo(
            host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
    # UnicodeError: a name that no domain can have.
    except (OSError, UnicodeError) as error:
        raise StartError(_reason(host, port, error)) from error
    return list(dict.fromkeys((family, address) for family, _, _, _, address in found))


def listen(places: Sequence[SocketAddress], host: str, port: int, option: str = "--port") -> list[socket.socket]:
    """Take a port, 0 for a free one, on every address of this machine, or raise StartError naming ``option``."""
    for tries_left in reversed(range(FREE_PORT_TRIES)):
        try:
            return _listen_on_all(places, port)
        except OSError as error:
            if port or error.errno != errno.EADDRINUSE or not tries_left:
                raise StartError(_reason(host, port, error, option)) from error
    raise AssertionError("no try was the last")


def _listen_on_all(places: Sequence[SocketAddress], port: int) -> list[socket.socket]:
    listening: list[socket.socket] = []
    missing: OSError | None = None
    for place in places:
        try:
            listening.append(_listen_on(place, port, alone=len(places) == 1))
        except OSError as error:
            if error.errno not in _NOT_HERE:
                for each in listening:
                    each.close()
                raise
            missing = error
        else:
            port = listening[0].getsockname()[1]
    if not listening:
        raise missing or OSError(errno.EADDRNOTAVAIL, "no address")
    return listening


def _listen_on(place: SocketAddress, port: int, *, alone: bool) -> socket.socket:
    family, (host, _, *scope) = place
    # Beside a socket for IPv4 it must leave that alone; by itself, ``::`` is for both.
    dual = family == socket.AF_INET6 and alone and socket.has_dualstack_ipv6()
    made = socket.create_server((host, port, *scope), family=family, backlog=BACKLOG, dualstack_ipv6=dual)
    # Connections have it from their listening socket: small messages are sent at once.
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    made.setblocking(False)
    return made


def _reason(host: str, port: int, error: OSError | UnicodeError, option: str = "--port") -> str:
    where = f"{host}:{port}"
    if isinstance(error, UnicodeError):
        return f"cannot listen on {where}: this is no name of a host"
    if error.errno == errno.EADDRINUSE:
        return f"port in use: {where} is taken by another program; choose one with {option}"
    return f"cannot listen on {where}: {error.strerror or error}"


def raise_file_limit(max_clients: int) -> int:
    """Raise the process's limit of open files, warn if it is too low, and return the connections that it allows."""
    wanted = max_clients + SPARE_FILES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft >= wanted or soft == resource.RLIM_INFINITY:
        return max_clients
    possible = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (possible, hard))
    if possible == wanted:
        return max_clients
    clients = min(max_clients, max(possible - SPARE_FILES, possible // 2))
    log.warning(
        "the system lets the server open %d files, so it serves %d clients at a time, not server.max_clients = %d;"
        " raise the hard limit (ulimit -Hn, LimitNOFILE=), or lower the setting",
        possible,
        clients,
        max_clients,
    )
    return clients

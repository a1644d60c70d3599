"""The listening socket: makes a connection of every WebSocket client, and lets the others have their page."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import socket
from collections.abc import Mapping
from typing import Any, cast

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.http11 import Request, Response
from websockets.protocol import State

from protocol.limits import Limits
from server.access.access import Access, unlimited
from server.client_list import ClientList
from server.gateway.connection import Connection
from server.gateway.entrance.descriptors import make_room_for
from server.gateway.entrance.door import Caller
from server.gateway.entrance.entrance import Entrance
from server.gateway.entrance.exposure import check_exposure
from server.gateway.entrance.listening import BACKLOG, listen, resolve
from server.gateway.entrance.turnstile import RETRY_AFTER_S, Turnstile
from server.gateway.http import HttpGate
from server.gateway.http_answers import Answer, names
from server.gateway.traffic import Traffic
from server.gateway.websocket import WRITE_LIMIT_BYTES, WebSocket, address_of
from server.graph import Graph

log = logging.getLogger("armbridge.gateway")

# A message up to this many times the limit is still read, to be refused by the session while the connection lives on;
# beyond it the socket is closed (1009) before it is read.
OVERSIZE = 2

# websockets counts an answer over HTTP as part of the handshake, and cuts it short when the time is up, without a word.
# The largest mesh, 20 MB, takes so long at 170 kB/s, over a poor wireless link.
OPEN_TIMEOUT_S = 120.0

# Browsers close at once; a client that does not must not hold up the end of the server.
CLOSE_TIMEOUT_S = 0.5

# RFC 8446 needs two round trips; a slow device computes for a second.
TLS_HANDSHAKE_TIMEOUT_S = 10.0
TLS_SHUTDOWN_TIMEOUT_S = 1.0

# Lines of websockets for each answer over HTTP, as if it were a failure: a page that is loaded is none.
_HTTP_LINES = ("connection rejected", "HTTP response sent")


class Listener:
    """Accepts clients on one TCP port, whatever path and query they ask for.

    Args:
        graph: what clients take part in.
        host: address to listen on.
        port: TCP port; 0 takes a free one.
        http: answers requests that are no WebSocket's.
        takes_goals_along: whether a client's goals are cancelled when it leaves, unless its URL says otherwise.
        entrance: who gets in; None lets everybody in who addresses this machine.
        access: what those may do who are in; None for everything.
        limits: what one client may cost.

    Attributes:
        door: decides who gets in.
        traffic: what clients say and hear.
    """

    def __init__(
        self,
        graph: Graph,
        host: str,
        port: int,
        http: HttpGate | None = None,
        *,
        takes_goals_along: bool = False,
        entrance: Entrance | None = None,
        access: Access | None = None,
        limits: Limits | None = None,
    ) -> None:
        self._graph = graph
        self._host = host
        self._port = port
        self._http = http or HttpGate()
        entrance = entrance or Entrance()
        self.door = entrance.door
        self._tls = entrance.tls
        self._connection_limits = entrance.limits
        self._pings = entrance.pings
        self._turnstile = Turnstile(entrance.limits)
        self._limits = limits or Limits()
        self._takes_goals_along = takes_goals_along
        self._access = access or unlimited()
        self._sockets: list[socket.socket] = []
        # One a socket.
        self._servers: list[Server] = []
        # From the first byte of HTTP on, or the last of the TLS handshake, to the end.
        self._connections: set[WebSocket] = set()
        self._clients = ClientList(graph)
        self.traffic = Traffic()

    @property
    def port(self) -> int:
        """The port in use."""
        return self._port

    @property
    def url(self) -> str:
        """Where clients of rosbridge connect."""
        return f"{'ws' if self._tls is None else 'wss'}://{self._authority}"

    @property
    def page_url(self) -> str:
        """Where browsers find the page."""
        return f"{'http' if self._tls is None else 'https'}://{self._authority}/"

    @property
    def _authority(self) -> str:
        return f"{f'[{self._host}]' if ':' in self._host else self._host}:{self._port}"

    def refused_connections(self) -> Mapping[str, int]:
        """How many were refused, by why: ``limit``, and what the door has said."""
        return {**self.door.refusals, "limit": self._turnstile.turned_away}

    async def bind(self) -> None:
        """Take the port; clients that come now wait until :meth:`open`.

        Raises:
            ConfigurationError: others can reach the address, and nobody has said that they may.
            StartError: the address is in use, not allowed or not ours.
        """
        places = await resolve(self._host, self._port)
        check_exposure(self._host, (place.address for place in places), self.door.tokens, insecure=self.door.insecure)
        self._sockets = listen(places, self._host, self._port)
        self._port = self._sockets[0].getsockname()[1]

    async def open(self) -> None:
        """Begin to serve clients."""
        if not self._sockets:
            raise AssertionError("open before bind")
        make_room_for(self._connection_limits.max_clients)
        self._clients.open()
        logging.getLogger("websockets.server").addFilter(tells_of_more_than_http)
        for listening in self._sockets:
            self._servers.append(await self._serve_on(listening))

    def _serve_on(self, listening: socket.socket) -> Server:
        options: dict[str, Any] = {}
        if self._tls is not None:
            options = {
                "ssl": self._tls.context,
                "ssl_handshake_timeout": TLS_HANDSHAKE_TIMEOUT_S,
                "ssl_shutdown_timeout": TLS_SHUTDOWN_TIMEOUT_S,
            }
        make = functools.partial(WebSocket, turnstile=self._turnstile, connections=self._connections)
        return serve(
            self._serve_client,
            sock=listening,
            backlog=BACKLOG,
            # websockets' documentation allows for a wrapper, its annotation does not.
            create_connection=cast("type[ServerConnection]", make),
            process_request=self._answer,
            server_header=None,
            # As in rosbridge_server: deflate doubles the cost of every message.
            compression=None,
            # Some clients offer a subprotocol and expect it to be passed over.
            select_subprotocol=lambda _connection, _offered: None,
            max_size=OVERSIZE * self._limits.max_message_bytes,
            write_limit=WRITE_LIMIT_BYTES,
            open_timeout=OPEN_TIMEOUT_S,
            close_timeout=CLOSE_TIMEOUT_S,
            ping_interval=self._pings.interval_s,
            ping_timeout=self._pings.timeout_s,
            **options,
        )

    def reload_certificate(self) -> None:
        """Read the certificate again, for connections from now on."""
        if self._tls is None:
            log.info("nothing to read again: there is no certificate (server.tls_certificate)")
        else:
            self._tls.reload()

    async def close(self) -> None:
        """Close every connection and the port."""
        for server in self._servers:
            server.close()
        # The servers have stopped to accept and begun to tell their clients when this turn of the loop is over; who has
        # not asked for anything yet is not waited for.
        await asyncio.sleep(0)
        for websocket in [each for each in self._connections if each.state is State.CONNECTING]:
            websocket.transport.abort()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(2 * CLOSE_TIMEOUT_S):
                for server in self._servers:
                    await server.wait_closed()
        for each in self._sockets:
            each.close()

    async def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        websocket = cast(WebSocket, connection)
        websocket.take_request()
        visit = websocket.visit
        if visit is not None and visit.turned_away is not None:
            retry = {"Retry-After": str(RETRY_AFTER_S)}
            return Answer.of_text(visit.turned_away.status, visit.turned_away.sentence, retry).response(request)
        admitted = self.door.admit(
            Caller(
                address_of(websocket)[0],
                request.path,
                request.headers,
                upgrade=names(request.headers, "Upgrade", "websocket"),
                encrypted=self._tls is not None,
            )
        )
        if isinstance(admitted, Answer):
            return admitted.response(request)
        websocket.identity = admitted
        return await self._http.process_request(websocket, request)

    async def _serve_client(self, server_connection: ServerConnection) -> None:
        websocket = cast(WebSocket, server_connection)
        connection = Connection(
            websocket,
            self._graph,
            self._limits,
            takes_goals_along=self._takes_goals_along,
            identity=websocket.identity,
            access=self._access,
            wrong_tokens=self.door.wrong_tokens,
        )
        self._clients.add(connection.node, connection.address)
        self.traffic.add(connection)
        try:
            await connection.run()
        finally:
            self._clients.remove(connection.node)
            self.traffic.remove(connection)


def tells_of_more_than_http(record: logging.LogRecord) -> bool:
    """Whether a line of websockets' log is about more than an answer over HTTP."""
    return not str(record.msg).startswith(_HTTP_LINES)

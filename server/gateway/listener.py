"""The listening socket: makes a connection of every WebSocket client, and lets the others have their page."""

from __future__ import annotations

import logging
import socket
from collections.abc import Mapping

from websockets.http11 import Request, Response

from protocol.limits import Limits
from server.access.access import Access, unlimited
from server.client_list import ClientList
from server.gateway.connection import Connection, address_of
from server.gateway.entrance.descriptors import make_room_for
from server.gateway.entrance.door import Caller
from server.gateway.entrance.entrance import Entrance
from server.gateway.entrance.exposure import check_exposure
from server.gateway.entrance.listening import listen, resolve
from server.gateway.entrance.reception import Reception
from server.gateway.entrance.turnstile import RETRY_AFTER_S, Turnstile
from server.gateway.http import HttpGate
from server.gateway.http_answers import Answer, names
from server.gateway.traffic import Traffic
from server.gateway.websocket import WebSocket
from server.graph.topics import Graph

log = logging.getLogger("armbridge.gateway")

# A message up to this many times the limit is still read, to be refused by the session while the connection lives on;
# beyond it the socket is closed (1009) before it is read.
OVERSIZE = 2

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
        self._server: Reception | None = None
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
        max_size_bytes = OVERSIZE * self._limits.max_message_bytes
        self._server = Reception(
            self._sockets, self._turnstile, self._tls, max_size_bytes, self._answer, self._serve_client, self._pings
        )
        await self._server.open()

    def reload_certificate(self) -> None:
        """Read the certificate again, for connections from now on."""
        if self._tls is None:
            log.info("nothing to read again: there is no certificate (server.tls_certificate)")
        else:
            self._tls.reload()

    async def close(self) -> None:
        """Close every connection and the port."""
        if self._server is not None:
            await self._server.close()
        for each in self._sockets:
            each.close()

    async def _answer(self, websocket: WebSocket, request: Request) -> Response | None:
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

    async def _serve_client(self, websocket: WebSocket) -> None:
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

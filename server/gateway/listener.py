"""The listening socket: makes a connection of every WebSocket client, and lets the others have their page."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import socket
from typing import cast

from websockets.asyncio.server import Server, ServerConnection, serve

from protocol.limits import Limits
from server.client_list import ClientList
from server.errors import StartError
from server.gateway.connection import Connection
from server.gateway.http import HttpGate
from server.gateway.websocket import WRITE_LIMIT_BYTES, WebSocket
from server.graph import Graph

log = logging.getLogger("armbridge.gateway")

BACKLOG = 128

# A message up to this many times the limit is still read, to be refused by the session while the connection lives on;
# beyond it the socket is closed (1009) before it is read.
OVERSIZE = 2

# websockets counts an answer over HTTP as part of the handshake, and cuts it short when the time is up, without a word.
# The largest mesh, 20 MB, takes so long at 170 kB/s, over a poor wireless link.
OPEN_TIMEOUT_S = 120.0

# Lines of websockets for each answer over HTTP, as if it were a failure: a page that is loaded is none.
_HTTP_LINES = ("connection rejected", "HTTP response sent")

# Browsers close at once; a client that does not must not hold up the end of the server.
CLOSE_TIMEOUT_S = 0.5


class Listener:
    """Accepts clients on one TCP port, whatever path and query they ask for.

    Args:
        graph: what clients take part in.
        host: address to listen on.
        port: TCP port; 0 takes a free one.
        http: answers requests that are no WebSocket's.
        takes_goals_along: whether a client's goals are cancelled when it leaves, unless its URL says otherwise.
    """

    def __init__(
        self, graph: Graph, host: str, port: int, http: HttpGate | None = None, *, takes_goals_along: bool = False
    ) -> None:
        self._graph = graph
        self._host = host
        self._port = port
        self._http = http or HttpGate()
        self._limits = Limits()
        self._takes_goals_along = takes_goals_along
        self._socket: socket.socket | None = None
        self._server: Server | None = None
        self._clients = ClientList(graph)

    @property
    def port(self) -> int:
        """The port in use."""
        return self._port

    async def bind(self) -> None:
        """Take the port; clients that come now wait until :meth:`open`.

        Raises:
            StartError: the address is in use, not allowed or not ours.
        """
        loop = asyncio.get_running_loop()
        try:
            found = await loop.getaddrinfo(self._host, self._port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
            family, kind, protocol, _, address = found[0]
            listening = socket.socket(family, kind, protocol)
        except OSError as error:
            raise StartError(self._reason(error)) from error
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(address)
            listening.listen(BACKLOG)
        except OSError as error:
            listening.close()
            raise StartError(self._reason(error)) from error
        self._socket = listening
        self._port = listening.getsockname()[1]

    async def open(self) -> None:
        """Begin to serve clients."""
        if self._socket is None:
            raise AssertionError("open before bind")
        self._clients.open()
        logging.getLogger("websockets.server").addFilter(tells_of_more_than_http)
        self._server = await serve(
            self._serve_client,
            sock=self._socket,
            max_size=OVERSIZE * self._limits.max_message_bytes,
            # As in rosbridge_server: deflate doubles the cost of every message.
            compression=None,
            create_connection=WebSocket,
            write_limit=WRITE_LIMIT_BYTES,
            # Some clients offer a subprotocol and expect it to be passed over.
            select_subprotocol=lambda _connection, _offered: None,
            process_request=self._http.process_request,
            open_timeout=OPEN_TIMEOUT_S,
            close_timeout=CLOSE_TIMEOUT_S,
        )

    async def close(self) -> None:
        """Close every connection and the port."""
        if self._server is not None:
            self._server.close()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._server.wait_closed(), 2 * CLOSE_TIMEOUT_S)
        elif self._socket is not None:
            self._socket.close()

    async def _serve_client(self, websocket: ServerConnection) -> None:
        # What `create_connection` has made.
        connection = Connection(
            cast(WebSocket, websocket), self._graph, self._limits, takes_goals_along=self._takes_goals_along
        )
        self._clients.add(connection.node, connection.address)
        try:
            await connection.run()
        finally:
            self._clients.remove(connection.node)

    def _reason(self, error: OSError) -> str:
        where = f"{self._host}:{self._port}"
        if error.errno == errno.EADDRINUSE:
            return f"port in use: {where} is taken by another program; choose one with --port"
        return f"cannot listen on {where}: {error.strerror or error}"


def tells_of_more_than_http(record: logging.LogRecord) -> bool:
    """Whether a line of websockets' log is about more than an answer over HTTP."""
    return not str(record.msg).startswith(_HTTP_LINES)

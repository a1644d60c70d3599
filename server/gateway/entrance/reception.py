"""Leads each connection through the handshake, and hands it over when it is open."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import cast

from websockets.asyncio.server import Server, ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State
from websockets.server import ServerProtocol

from server.gateway.entrance.acceptor import Acceptor
from server.gateway.entrance.tls import Tls
from server.gateway.entrance.turnstile import Turnstile
from server.gateway.websocket import WRITE_LIMIT_BYTES, WebSocket

# websockets counts an answer over HTTP as part of the handshake, and cuts it short when the time is up, without a word.
# The largest mesh, 20 MB, takes so long at 170 kB/s, over a poor wireless link.
OPEN_TIMEOUT_S = 120.0

# Browsers close at once; a client that does not must not hold up the end of the server.
CLOSE_TIMEOUT_S = 0.5


@dataclass(frozen=True)
class Pings:
    """How a client is found out whose machine is gone without a word.

    Attributes:
        interval_s: it is asked so often [s].
        timeout_s: it has so long to answer [s].
    """

    interval_s: float = 20.0
    timeout_s: float = 20.0


class Reception:
    """What websockets' ``serve`` does, for connections that the acceptor has let in.

    Args:
        listening: sockets, not blocking.
        turnstile: who may come in.
        tls: the server's certificate; None for connections that are not encrypted.
        max_size_bytes: of a message; a larger one ends its connection.
        answer: answers a request, or returns None for one that may become a WebSocket.
        attend: serves an open connection until it ends.
        pings: how often clients are asked whether they are there.
    """

    def __init__(
        self,
        listening: Sequence[socket.socket],
        turnstile: Turnstile,
        tls: Tls | None,
        max_size_bytes: int,
        answer: Callable[[WebSocket, Request], Awaitable[Response | None]],
        attend: Callable[[WebSocket], Awaitable[None]],
        pings: Pings,
    ) -> None:
        self._max_size_bytes = max_size_bytes
        self._answer = answer
        self._attend = attend
        self._pings = pings
        self._tls = tls
        self._acceptor = Acceptor(listening, turnstile, self._make, self._tls_context)
        self._server = Server(self._start, self._lead)
        # Those whose handshake is not done.
        self._arriving: set[WebSocket] = set()

    @property
    def connections(self) -> set[ServerConnection]:
        """Those that are open."""
        return self._server.connections

    async def open(self) -> None:
        """Begin to accept."""
        await self._server

    async def close(self) -> None:
        """Close the port, tell every client, and end those that have not come in yet."""
        self._server.close()
        for websocket in self._arriving:
            websocket.transport.abort()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._server.wait_closed(), 2 * CLOSE_TIMEOUT_S)

    def _tls_context(self) -> ssl.SSLContext | None:
        return None if self._tls is None else self._tls.context

    async def _start(self) -> asyncio.Server:
        await self._acceptor.start_serving()
        # Of asyncio's class websockets uses no more than what the acceptor has.
        return cast("asyncio.Server", self._acceptor)

    def _make(self) -> WebSocket:
        protocol = ServerProtocol(
            max_size=self._max_size_bytes,
            # Some clients offer a subprotocol and expect it to be passed over.
            select_subprotocol=lambda _protocol, _offered: None,
            # No extensions. As in rosbridge_server: deflate doubles the cost of every message.
        )
        return WebSocket(
            protocol,
            self._server,
            ping_interval=self._pings.interval_s,
            ping_timeout=self._pings.timeout_s,
            close_timeout=CLOSE_TIMEOUT_S,
            write_limit=WRITE_LIMIT_BYTES,
        )

    async def _lead(self, connection: ServerConnection) -> None:
        # What `_make` has made.
        websocket = cast(WebSocket, connection)
        self._arriving.add(websocket)
        try:
            # Whoever was answered and does not end the connection has it ended, as has who takes too long.
            with contextlib.suppress(TimeoutError, ConnectionClosed):
                async with asyncio.timeout(OPEN_TIMEOUT_S):
                    await websocket.handshake(self._process_request, server_header=None)
            if websocket.state is State.OPEN:
                await self._serve(websocket)
        finally:
            self._arriving.discard(websocket)
            # What was only answered, or not even that, has no handshake for its end.
            websocket.transport.abort()
            self._server.handler_tasks.discard(cast("asyncio.Task[None]", asyncio.current_task()))

    async def _serve(self, websocket: WebSocket) -> None:
        self._arriving.discard(websocket)
        self._server.all_connections.add(websocket)
        websocket.start_keepalive()
        try:
            async with websocket:
                await self._attend(websocket)
        except Exception:  # a bug in serving one client must not take the server with it
            websocket.logger.exception("connection handler failed")
        finally:
            self._server.all_connections.discard(websocket)

    async def _process_request(self, connection: ServerConnection, request: Request) -> Response | None:
        websocket = cast(WebSocket, connection)
        websocket.take_request()
        return await self._answer(websocket, request)

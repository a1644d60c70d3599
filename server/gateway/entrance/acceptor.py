"""Takes connections from the listening sockets, as many as there is room for, and none at the others' expense."""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
import struct
import time
from collections.abc import Callable, Sequence

from server.gateway.entrance.refusal_log import RefusalLog
from server.gateway.entrance.turnstile import Turnstile, Visit
from server.gateway.websocket import WebSocket

log = logging.getLogger("armbridge.gateway")

# In one turn of the event loop: each that is let in costs a handshake, one that is not costs little.
LET_IN_PER_TURN = 4
TURNED_AWAY_PER_TURN = 64

# Without a free descriptor nothing can be accepted, and the socket stays ready.
OUT_OF_DESCRIPTORS_PAUSE_S = 0.1

# RFC 8446 needs two round trips; a slow device computes for a second.
TLS_HANDSHAKE_TIMEOUT_S = 10.0
TLS_SHUTDOWN_TIMEOUT_S = 1.0

# Closed without waiting for the other end, which would leave the port's table full of those that a flood opened.
_AT_ONCE = struct.pack("ii", 1, 0)


class Acceptor:
    """Accepts connections.

    asyncio's own server counts nothing, and with TLS tells of a connection only when its handshake is done.

    Args:
        listening: the sockets, not blocking.
        turnstile: who may come in.
        make: makes the server's end of a connection.
        tls: the certificate of the moment; None for connections that are not encrypted.
    """

    def __init__(
        self,
        listening: Sequence[socket.socket],
        turnstile: Turnstile,
        make: Callable[[], WebSocket],
        tls: Callable[[], ssl.SSLContext | None] = lambda: None,
    ) -> None:
        self.sockets = tuple(listening)
        self._turnstile = turnstile
        self._make = make
        self._tls = tls
        self._loop = asyncio.get_running_loop()
        self._open = False
        self._arriving: set[asyncio.Task[None]] = set()
        self._log = RefusalLog()

    async def start_serving(self) -> None:
        """Begin to accept."""
        self._open = True
        for listening in self.sockets:
            self._loop.add_reader(listening, self.accept, listening)

    def close(self) -> None:
        """Accept no more, and give up what has not come in yet."""
        if self._open:
            self._open = False
            for listening in self.sockets:
                self._loop.remove_reader(listening)
        for listening in self.sockets:
            listening.close()
        for task in self._arriving:
            task.cancel()

    async def wait_closed(self) -> None:
        """Nothing is left to wait for."""

    def is_serving(self) -> bool:
        """Whether connections are accepted."""
        return self._open

    def get_loop(self) -> asyncio.AbstractEventLoop:
        """The event loop that serves."""
        return self._loop

    def accept(self, listening: socket.socket) -> None:
        """Accept what waits, for no longer than a turn."""
        let_in = 0
        for _ in range(TURNED_AWAY_PER_TURN):
            try:
                accepted, address = listening.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                self._pause(listening, error)
                return
            let_in += self._take(accepted, str(address[0]))
            if let_in == LET_IN_PER_TURN:
                return

    def _take(self, accepted: socket.socket, address: str) -> bool:
        visit = self._turnstile.enter(address, time.monotonic())
        if visit is None:
            accepted.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
            accepted.close()
            return False
        if visit.turned_away is not None:
            self._log.tell("connections", address, f"{address}: {visit.turned_away.sentence}")
        accepted.setblocking(False)
        websocket = self._make()
        websocket.visit = visit
        # The event loop keeps no task by itself.
        task = self._loop.create_task(self._bring_in(accepted, websocket, visit), name=f"accept {address}")
        self._arriving.add(task)
        task.add_done_callback(lambda task: self._tidy(task, accepted, websocket))
        return True

    async def _bring_in(self, accepted: socket.socket, websocket: WebSocket, visit: Visit) -> None:
        tls = self._tls()
        try:
            await self._loop.connect_accepted_socket(
                lambda: websocket,
                accepted,
                ssl=tls,
                ssl_handshake_timeout=None if tls is None else TLS_HANDSHAKE_TIMEOUT_S,
                ssl_shutdown_timeout=None if tls is None else TLS_SHUTDOWN_TIMEOUT_S,
            )
        except OSError as error:
            self._tell_failure(visit.address, error)

    def _tidy(self, task: asyncio.Task[None], accepted: socket.socket, websocket: WebSocket) -> None:
        """What never became a connection is never told that it is lost."""
        self._arriving.discard(task)
        if not hasattr(websocket, "transport"):
            accepted.close()
            if websocket.visit is not None:
                websocket.visit.end()

    def _tell_failure(self, address: str, error: OSError) -> None:
        if isinstance(error, ssl.SSLError) and error.reason == "HTTP_REQUEST":
            self._log.tell("tls", address, f"{address} speaks ws:// or http://, and here is wss:// and https://")
        else:
            log.debug("%s: the connection was not made: %s", address, error)

    def _pause(self, listening: socket.socket, error: OSError) -> None:
        self._log.tell("accept", str(error.errno), f"no connection can be accepted: {error.strerror}")
        self._loop.remove_reader(listening)
        self._loop.call_later(OUT_OF_DESCRIPTORS_PAUSE_S, self._resume, listening)

    def _resume(self, listening: socket.socket) -> None:
        if self._open:
            self._loop.add_reader(listening, self.accept, listening)

"""Raw TCP: rosbridge's operations as BSON documents or JSON objects, one behind the other, on a port of their own.

ROSIntegration (Unreal) and rosbridge2cpp speak it, to what was rosbridge_tcp in ROS 1. There is no handshake, so there
is no ``Origin`` to check and no URL with a token or options: a client authenticates by the op ``auth``, and all clients
of the port get the spelling of one generation of ROS.
"""

from __future__ import annotations

import asyncio
import math
import socket
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from protocol.codecs import bson, json
from protocol.errors import one_line
from protocol.framing import StreamSplitter
from protocol.publication import EncodedMessage
from server.gateway.admission import ConnectionLimiter
from server.gateway.http import HttpResponse
from server.gateway.settings import ServerSettings
from server.gateway.transport import INTERNAL_ERROR, Transport
from server.graph.permissions import Identity

# Unanswered probes of TCP after which the client is taken for gone.
KEEPALIVE_PROBES = 4


class TcpStream(Transport):
    """Connection of one client by raw TCP."""

    framed = False

    def __init__(
        self,
        settings: ServerSettings,
        limiter: ConnectionLimiter,
        transports: set[Transport],
        serve: Callable[[Transport], Awaitable[None]],
        identity: Identity | None,
    ) -> None:
        super().__init__(limiter, transports, serve)
        self.identity = identity
        self.query = {"ros": [str(settings.tcp_ros_version)]}
        self._splitter = StreamSplitter(settings.limits.max_message_bytes)
        # True while a frame has its turn of the loop.
        self._writing = False
        self._writing_paused = False

    @property
    def max_message_bytes(self) -> int:
        return self._splitter.max_frame_bytes

    @max_message_bytes.setter
    def max_message_bytes(self, limit_bytes: int) -> None:
        self._splitter.max_frame_bytes = limit_bytes

    def _begin(self, rejection: HttpResponse | None) -> None:
        if rejection is None:
            self._start_serving()
        else:
            self.end(one_line(rejection.body.decode(errors="replace").strip()))

    def _add(self, data: bytes) -> None:
        self._splitter.add(data)

    def _next_frame(self) -> str | bytes | None:
        return self._splitter.next_frame()

    def _clear(self) -> None:
        self._splitter.clear()

    def send_at_once(self, encoded: EncodedMessage) -> bool:
        if not self.takes_more:
            return False
        self.send_all((encoded,))
        return True

    def send_all(self, messages: Sequence[EncodedMessage]) -> None:
        """Send messages, each frame in a send of its own: rosbridge2cpp takes one `recv` for one message."""
        frames = [frame.data for encoded in messages for frame in encoded.frames]
        size_bytes = sum(map(len, frames))
        self.sent_messages += len(frames)
        self.sent_bytes += size_bytes
        self._unsent += frames
        self._unsent_bytes += size_bytes
        if not self._writing:
            self._write_next()

    def _write_next(self) -> None:
        self._writing = bool(self._unsent)
        if self._writing:
            self._writable.clear()
            frame = self._unsent.pop(0)
            self._unsent_bytes -= len(frame)
            self._write_now((frame,))
            asyncio.get_running_loop().call_soon(self._write_next)
        elif not self._writing_paused:
            self._writable.set()

    def pause_writing(self) -> None:
        self._writing_paused = True
        super().pause_writing()

    def resume_writing(self) -> None:
        self._writing_paused = False
        if not self._writing:
            super().resume_writing()

    def end(self, reason: str, _code: int = INTERNAL_ERROR) -> None:
        """End the connection with a status message, in the encoding that the client speaks."""
        if self._ending:
            return
        self._failure = ConnectionAbortedError(reason)
        status: dict[str, Any] = {"op": "status", "level": "error", "msg": reason}
        if not self._transport.is_closing():
            self._write((bson.encode(status) if self._splitter.is_bson else json.encode(status),))
        self._close_after_replies()


def keep_alive(listening: socket.socket, interval_s: float, timeout_s: float) -> None:
    """Have the system probe idle clients and end silent ones, as pings do; accepted sockets inherit it (tcp(7))."""
    for option, value in (
        (socket.TCP_KEEPIDLE, math.ceil(interval_s)),
        (socket.TCP_KEEPINTVL, math.ceil(timeout_s / KEEPALIVE_PROBES)),
        (socket.TCP_KEEPCNT, KEEPALIVE_PROBES),
        (socket.TCP_USER_TIMEOUT, math.ceil(1000 * (interval_s + timeout_s))),
    ):
        listening.setsockopt(socket.IPPROTO_TCP, option, value)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

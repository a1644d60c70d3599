"""Raw TCP: rosbridge's operations as BSON documents or JSON objects, one behind the other, on a port of their own.

ROSIntegration (Unreal) and rosbridge2cpp speak it, to what was rosbridge_tcp in ROS 1. There is no handshake, so there
is no ``Origin`` to check and no URL with a token or options: a client authenticates by the op ``auth``, and all clients
of the port get the spelling of one generation of ROS.
"""

from __future__ import annotations

import asyncio
import logging
import math
import socket
import ssl
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Self, cast

from protocol.codecs import bson, json
from protocol.errors import FrameError, one_line
from protocol.publication import EncodedMessage
from protocol.stream import StreamSplitter
from server.gateway.admission import ConnectionLimiter, ConnectionSlot
from server.gateway.client_transport import address_and_port, reset
from server.gateway.settings import ServerSettings
from server.gateway.transport import OUT_OF_MEMORY, WRITE_LIMIT_BYTES
from server.gateway.turns import TURN_S
from server.graph.permissions import Identity

log = logging.getLogger("armbridge.gateway")

# Time for a client to read the reason why its connection ends, and the last of its replies [s].
END_TIMEOUT_S = 1.0

# Unanswered probes of TCP after which the client is taken for gone.
KEEPALIVE_PROBES = 4


class TcpStream(asyncio.Protocol):
    """Connection of one client by raw TCP; a :class:`~server.gateway.client_transport.ClientTransport`.

    Args:
        limiter: counter of connections.
        identity: identity of the client; None until it has authenticated.
        max_message_bytes: greatest size of a frame.
        query: choices for all clients of the port, as a URL's query has them.
        serve: serves the client until it leaves; called once, in a task.
        streams: every stream of the port; this one is in it from ``connection_made`` to ``connection_lost``.

    Attributes:
        identity: identity of the client; None until it has authenticated.
        peer: IP address and port of the client.
        query: as given.
        received_bytes: bytes received.
        sent_messages: frames sent; a fragment is one.
        sent_bytes: bytes of these frames.
    """

    framed = False

    def __init__(
        self,
        limiter: ConnectionLimiter,
        identity: Identity | None,
        max_message_bytes: int,
        query: Mapping[str, Sequence[str]],
        serve: Callable[[TcpStream], Awaitable[None]],
        streams: set[TcpStream],
    ) -> None:
        self.identity = identity
        self.peer = address_and_port(None)
        self.query = query
        self.received_bytes = 0
        self.sent_messages = 0
        self.sent_bytes = 0
        self._limiter = limiter
        self._serve_client = serve
        self._streams = streams
        self._splitter = StreamSplitter(max_message_bytes)
        self._transport: asyncio.Transport | None = None
        self._slot: ConnectionSlot | None = None
        self._task: asyncio.Task[None] | None = None
        self._on_message: Callable[[str | bytes], None] | None = None
        self._held = False
        # The next turn is to come by itself.
        self._turn_waits = False
        self._at_eof = False
        # Nothing more is read: the client has sent its last, or the connection ends.
        self._read_all = asyncio.Event()
        self._ending = False
        self._failure: str | None = None
        self._broken_off = False
        self._end_timer: asyncio.TimerHandle | None = None
        self._lost = asyncio.Event()
        # Frames that wait for their turn of the loop, and True while one of them has it.
        self._unsent: deque[bytes] = deque()
        self._unsent_bytes = 0
        self._writing = False
        self._paused = False
        self._writable = asyncio.Event()
        self._writable.set()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a place among the connections, and begin to serve the client."""
        self.peer = address_and_port(transport.get_extra_info("peername"))
        self._slot = self._limiter.acquire(self.peer[0], time.monotonic())
        if self._slot is None:
            reset(transport)
            return
        # uvloop's transports have asyncio's methods, but not its classes.
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(WRITE_LIMIT_BYTES)
        self._streams.add(self)
        if self._slot.rejection is not None:
            self.end(one_line(self._slot.rejection.body.decode(errors="replace").strip()))
            return
        self._task = asyncio.create_task(self._serve(), name="serve {}:{} by TCP".format(*self.peer))

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the place."""
        if self._slot is None:
            return
        self._slot.release()
        self._streams.discard(self)
        if self._end_timer is not None:
            self._end_timer.cancel()
        if exc is not None and self._failure is None:
            self._failure, self._broken_off = str(exc), True
        self._ending = True
        self._unsent.clear()
        self._splitter.clear()
        for event in (self._read_all, self._writable, self._lost):
            event.set()

    async def _serve(self) -> None:
        try:
            await self._serve_client(self)
        finally:
            self._close_after_replies()

    # What comes from the client.

    @property
    def max_message_bytes(self) -> int | None:
        """Greatest size of a frame; the connection ends with a longer one, which is not read."""
        return self._splitter.max_frame_bytes

    @max_message_bytes.setter
    def max_message_bytes(self, limit_bytes: int | None) -> None:
        if limit_bytes is not None:
            self._splitter.max_frame_bytes = limit_bytes

    def data_received(self, data: bytes) -> None:
        """Hand over the frames in what the socket has received, until the turn is over."""
        if self._ending or self._slot is None:
            return
        self.received_bytes += len(data)
        try:
            self._splitter.add(data)
        except MemoryError:
            self.end_out_of_memory()
            return
        if not self._turn_waits:
            self._take_turn()

    def eof_received(self) -> bool:
        """End the client when all has been read; return True to let it read what is still to be said."""
        self._at_eof = True
        if self._ending or self._transport is None:
            return False
        if not self._turn_waits:
            self._take_turn()
        return self._transport.can_write_eof()

    def _take_turn(self) -> None:
        """Hand over frames until the turn is over; the rest waits for the next turn, and the socket with it."""
        ends_s = time.monotonic() + TURN_S
        try:
            while self._on_message is not None and not self._held and not self._ending:
                frame = self._splitter.next_frame()
                if frame is None:
                    self._go_on_reading()
                    return
                self._on_message(frame)
                if time.monotonic() >= ends_s:
                    self._take_turn_later()
                    break
        except FrameError as error:
            self.end(str(error))
            return
        except MemoryError:
            self.end_out_of_memory()
            return
        self._stop_reading()

    def end_out_of_memory(self) -> None:
        """End this connection alone; what it holds is freed for the words."""
        self._splitter.clear()
        try:
            self.end(OUT_OF_MEMORY)
        except MemoryError:
            self.abort()

    def _take_turn_later(self) -> None:
        if not self._turn_waits:
            self._turn_waits = True
            asyncio.get_running_loop().call_soon(self._take_next_turn)

    def _take_next_turn(self) -> None:
        self._turn_waits = False
        if not self._ending:
            self._take_turn()

    def _go_on_reading(self) -> None:
        if self._at_eof:
            self._read_all.set()
        elif self._transport is not None and not self._transport.is_closing():
            self._transport.resume_reading()

    def _stop_reading(self) -> None:
        if self._transport is not None and not self._transport.is_closing() and not self._ending:
            self._transport.pause_reading()

    def hold_reading(self) -> None:
        """Read nothing more for now, because the client's inbox is full."""
        self._held = True
        self._stop_reading()

    def release_reading(self) -> None:
        """Read again."""
        self._held = False
        self._take_turn_later()

    def start_delivery(self, on_message: Callable[[str | bytes], None]) -> None:
        """Hand frames over as they come.

        Args:
            on_message: called with a frame; must not raise.
        """
        self._on_message = on_message
        self._take_turn_later()

    def stop_delivery(self) -> None:
        """Hand no more frames over."""
        self._on_message = None

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> bytes:
        """Wait for the end: every frame is handed over by the callback.

        Raises:
            ConnectionAbortedError: the connection has been ended.
            ConnectionResetError: the client has broken it off.
        """
        await self._read_all.wait()
        if self._failure is not None:
            raise (ConnectionResetError if self._broken_off else ConnectionAbortedError)(self._failure)
        raise StopAsyncIteration

    # What goes to the client.

    @property
    def is_open(self) -> bool:
        """True while frames can be sent."""
        return not self._ending and self._transport is not None and not self._transport.is_closing()

    @property
    def takes_more(self) -> bool:
        """True while the socket takes a message without waiting."""
        if self._transport is None or not self.is_open:
            return False
        return self._unsent_bytes + self._transport.get_write_buffer_size() <= WRITE_LIMIT_BYTES

    @property
    def taken_bytes(self) -> int:
        """Bytes of frames that the socket has taken: they grow as long as the client reads."""
        if self._transport is None or not self.is_open:
            return self.sent_bytes
        return self.sent_bytes - self._unsent_bytes - self._transport.get_write_buffer_size()

    def send_at_once(self, encoded: EncodedMessage) -> bool:
        """Send a message, in order of calling, if the socket takes it without waiting; return True when it is sent."""
        if not self.takes_more:
            return False
        self.send_all((encoded,))
        return True

    def send_all(self, messages: Sequence[EncodedMessage]) -> None:
        """Send messages, after `takes_more` was true; each frame in a turn of the loop, which is a send of its own.

        rosbridge2cpp takes what one `recv` returns for one message.
        """
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
            self._write(self._unsent.popleft())
            asyncio.get_running_loop().call_soon(self._write_next)
        elif not self._paused:
            self._writable.set()

    def _write(self, data: bytes) -> None:
        self._unsent_bytes -= len(data)
        try:
            if self._transport is not None:
                self._transport.write(data)
        except MemoryError:
            # Part of a frame may have been written, behind which the client can be told nothing.
            self._failure = OUT_OF_MEMORY
            self.abort()

    def pause_writing(self) -> None:
        """Note that the socket takes no more."""
        self._paused = True
        self._writable.clear()

    def resume_writing(self) -> None:
        """Note that the socket takes more."""
        self._paused = False
        if not self._writing:
            self._writable.set()

    async def drain(self) -> None:
        """Wait until the socket takes more."""
        await self._writable.wait()

    async def close(self, _code: int, reason: str) -> None:
        """Tell the client the reason, and wait until the connection has ended."""
        self.end(reason)
        await self._lost.wait()

    def end(self, reason: str) -> None:
        """End the connection with a status message.

        It is said last, in the encoding that the client speaks. The client may still be sending: closing the socket on
        unread bytes would reset the connection, and the message with it.
        """
        if self._ending:
            return
        self._failure = reason
        status: dict[str, Any] = {"op": "status", "level": "error", "msg": reason}
        if self._transport is not None and not self._transport.is_closing():
            self._write_all()
            self._transport.write(bson.encode(status) if self._splitter.speaks_bson else json.encode(status))
        self._close_after_replies()

    def _close_after_replies(self, *, linger: bool = True) -> None:
        """Close the connection once the client has read what was sent, or has left that for too long.

        Args:
            linger: wait for the client to close its own side.
        """
        if self._ending:
            return
        self._ending = True
        self._splitter.clear()
        self._read_all.set()
        if self._transport is None or self._transport.is_closing():
            return
        self._write_all()
        self._end_timer = asyncio.get_running_loop().call_later(END_TIMEOUT_S, self.abort)
        if linger and self._transport.can_write_eof() and not self._at_eof:
            # The rest that the client sends is read and passed over until then.
            self._transport.write_eof()
            self._transport.resume_reading()
        else:
            self._transport.close()

    def _write_all(self) -> None:
        while self._unsent:
            self._write(self._unsent.popleft())

    def abort(self) -> None:
        """End the connection now."""
        if self._transport is not None:
            self._transport.abort()

    def leave(self) -> None:
        """End the connection without a reason, as the server stops."""
        self._close_after_replies(linger=False)

    async def wait_ended(self) -> None:
        """Wait until the client is not served any more and the connection has ended."""
        await self._lost.wait()
        if self._task is not None:
            await asyncio.wait([self._task])


class TcpListener:
    """Port of raw TCP.

    Args:
        settings: the section ``server``.
        limiter: counter of connections, of all ports together.
        identity: identity of clients that have not authenticated; None where they may do nothing.
        tls: context of the certificate; None to speak in the clear.
        serve: serves a client until it leaves.
    """

    def __init__(
        self,
        settings: ServerSettings,
        limiter: ConnectionLimiter,
        identity: Identity | None,
        tls: ssl.SSLContext | None,
        serve: Callable[[TcpStream], Awaitable[None]],
    ) -> None:
        self._settings = settings
        self._limiter = limiter
        self._identity = identity
        self._tls = tls
        self._serve = serve
        self._streams: set[TcpStream] = set()
        self._servers: list[asyncio.Server] = []

    async def open(self, sockets: Sequence[socket.socket], **tls_options: Any) -> None:
        """Begin to serve clients.

        Args:
            sockets: they listen already.
            tls_options: time limits of TLS, as ``create_server`` takes them.
        """
        loop = asyncio.get_running_loop()
        if self._tls is None:
            # asyncio refuses them.
            tls_options = {}
        for each in sockets:
            keep_alive(each, self._settings.ping_interval_s, self._settings.ping_timeout_s)
            self._servers.append(await loop.create_server(self._make_stream, sock=each, ssl=self._tls, **tls_options))

    def _make_stream(self) -> TcpStream:
        query = {"ros": [str(self._settings.tcp_ros_version)]}
        limit_bytes = self._settings.limits.max_message_bytes
        return TcpStream(self._limiter, self._identity, limit_bytes, query, self._serve, self._streams)

    def close(self) -> None:
        """Close the port and every connection."""
        for server in self._servers:
            server.close()
        for stream in self._streams:
            stream.leave()

    async def wait_closed(self) -> None:
        """Wait until no client is served any more."""
        for stream in list(self._streams):
            await stream.wait_ended()


def keep_alive(listening: socket.socket, interval_s: float, timeout_s: float) -> None:
    """Have the system ask idle clients whether they are there, and end what they leave unanswered, as pings do.

    Accepted sockets inherit it (tcp(7)).

    Args:
        listening: the listening socket.
        interval_s: time without a sign of the client after which it is asked [s].
        timeout_s: time to answer [s].
    """
    for option, value in (
        (socket.TCP_KEEPIDLE, math.ceil(interval_s)),
        (socket.TCP_KEEPINTVL, math.ceil(timeout_s / KEEPALIVE_PROBES)),
        (socket.TCP_KEEPCNT, KEEPALIVE_PROBES),
        (socket.TCP_USER_TIMEOUT, math.ceil(1000 * (interval_s + timeout_s))),
    ):
        listening.setsockopt(socket.IPPROTO_TCP, option, value)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

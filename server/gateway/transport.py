"""Connection of one client over TCP or TLS, for the WebSocket and for raw TCP.

Frames are handed over as they come, in turns that leave time to other connections; reading stops while the client's
inbox is full. Writing stops at one limit, beyond which messages wait where they can be dropped. At its end the client
gets the time to read the reason.
"""

from __future__ import annotations

import asyncio
import fcntl
import logging
import math
import socket
import struct
import sys
import termios
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from protocol.codecs import bson, json
from protocol.errors import FrameError, one_line
from protocol.framing import StreamSplitter
from protocol.publication import EncodedMessage
from robot.stop_epochs import STOP_EPOCHS
from server.gateway.admission import ConnectionLimiter, ConnectionSlot
from server.gateway.http import HttpResponse
from server.gateway.settings import ServerSettings
from server.gateway.turns import TURN_S
from server.graph.permissions import ANYONE, Identity

if TYPE_CHECKING:
    from server.gateway.client import Client

log = logging.getLogger("armbridge.gateway")

# asyncio of Python 3.12.0 to 3.12.8, 3.13.0 and 3.13.1 writes lines without a bound (CVE-2024-12254).
WRITELINES_NEVER_PAUSES = (3, 12) <= sys.version_info < (3, 12, 9) or (3, 13) <= sys.version_info < (3, 13, 2)

# While more than this waits for the socket to take it, the rest waits where it can be dropped.
WRITE_LIMIT_BYTES = 32_768

# Messages that follow one another more quickly than this leave together: more than a message of a flood takes [s].
BURST_S = 0.0002

# Stops whose unread bytes are kept apart; with more, bytes count as older than they are.
MAX_UNREAD = 16

# Time for a client to read the reason why its connection ends, and the last of its replies [s].
END_TIMEOUT_S = 1.0

# Reason of a connection's end, which is the client's and the log's.
OUT_OF_MEMORY = "the server is out of memory for this message"

# RFC 6455, 7.4.1.
INTERNAL_ERROR = 1011

# SO_LINGER of no time: the connection is reset, and leaves no TIME_WAIT of two minutes in the kernel's table, which a
# flood would fill.
_RESET = struct.pack("ii", 1, 0)


class Transport(asyncio.Protocol):
    """Connection of one client.

    Attributes:
        framed: True where the client gets messages one by one; in a stream it may take two for one.
    """

    max_message_bytes: int  # size of a received frame beyond which the connection ends, before it is read
    _transport: asyncio.Transport

    framed = True

    def __init__(
        self, limiter: ConnectionLimiter, transports: set[Transport], serve: Callable[[Transport], Awaitable[None]]
    ) -> None:
        self.identity: Identity | None = ANYONE
        self.peer = ("unknown", 0)
        # Choices of the client, as a URL's query has them: ``ros``, ``on_disconnect``.
        self.query: Mapping[str, Sequence[str]] = {}
        self.received_bytes = 0
        self.sent_messages = 0
        self.sent_bytes = 0
        self._limiter = limiter
        self._transports = transports
        self._serve_client = serve
        self._slot: ConnectionSlot | None = None
        self._task: asyncio.Task[None] | None = None
        self.is_open = False
        self._last_sent_s = -math.inf
        self._unsent: list[bytes] = []
        self._unsent_bytes = 0
        self._client: Client | None = None
        # True once frames are read and left, until the end of the stream.
        self._discards = False
        self._held = False
        self._reading_paused = False
        # The next turn is to come by itself.
        self._turn_waits = False
        # Stop epoch in which the bytes arrived that wait to be handed over.
        self._epoch = STOP_EPOCHS.present
        # Ends, in received bytes, of what stops found unread in the socket, and the epochs in which it had arrived.
        self._unread: deque[tuple[int, int]] = deque()
        self._at_eof = False
        # Nothing more is read: the client has sent its last, or the connection ends.
        self._read_all = asyncio.Event()
        self._ending = False
        self._failure: ConnectionError | None = None
        self._end_timer: asyncio.TimerHandle | None = None
        self._lost = asyncio.Event()
        self._writable = asyncio.Event()
        self._writable.set()

    # What WebSocket and raw TCP do in different ways.

    @abstractmethod
    def _begin(self, rejection: HttpResponse | None) -> None:
        """Begin with a new connection, or end it when the limiter rejects it."""

    @abstractmethod
    def _add(self, data: bytes) -> None:
        """Keep received bytes."""

    @abstractmethod
    def _next_frame(self) -> str | bytes | None:
        """Return the next frame; None when its end has not come yet."""

    @abstractmethod
    def _clear(self) -> None:
        """Forget the bytes that wait."""

    @abstractmethod
    def end(self, reason: str, code: int = INTERNAL_ERROR) -> None:
        """End the connection with a reason, and a WebSocket's close code (RFC 6455, 7.4), for the client."""

    # From the beginning to the end.

    def date_connection(self, epoch: int) -> None:
        """Note that the connection has come in a stop epoch, though it is accepted now."""
        self._epoch = epoch

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a place among the connections."""
        # uvloop's transports have asyncio's methods, but not its classes.
        self._transport = cast(asyncio.Transport, transport)
        peer = transport.get_extra_info("peername")
        if isinstance(peer, tuple):
            # A connection that broke off at once has none any more.
            self.peer = str(peer[0]), int(peer[1])
        self._slot = self._limiter.acquire(self.peer[0], time.monotonic())
        if self._slot is None:
            self._ending = True
            transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            self._transport.abort()
            return
        self._transport.set_write_buffer_limits(WRITE_LIMIT_BYTES)
        self._transports.add(self)
        if self._epoch < STOP_EPOCHS.present:
            self.date_unread(self._epoch)
        STOP_EPOCHS.receivers.add(self)
        self._begin(self._slot.rejection)

    def _start_serving(self) -> None:
        self.is_open = True
        self._task = asyncio.get_running_loop().create_task(self._serve(), name="serve {}:{}".format(*self.peer))

    async def _serve(self) -> None:
        try:
            await self._serve_client(self)
        except Exception:  # a bug in serving one client must not stay unseen, nor leave its connection open
            log.exception("%s:%s cannot be served", *self.peer)
            self.end("")
        finally:
            self._close_after_replies()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._slot is None:
            return
        self._slot.release()
        self._transports.discard(self)
        STOP_EPOCHS.receivers.discard(self)
        if self._end_timer is not None:
            self._end_timer.cancel()
        if exc is not None and self._failure is None:
            self._failure = ConnectionResetError(str(exc))
        self._ending, self.is_open = True, False
        self._clear()
        for event in (self._read_all, self._writable, self._lost):
            event.set()

    def _close_after_replies(self, *, linger: bool = True) -> None:
        """Close the connection once the client has read what was sent, or has left that for too long."""
        if self._ending:
            return
        self._write_unsent()
        self._ending, self.is_open = True, False
        self._clear()
        self._read_all.set()
        if self._transport.is_closing():
            return
        self._end_timer = asyncio.get_running_loop().call_later(END_TIMEOUT_S, self.abort)
        if linger and self._transport.can_write_eof() and not self._at_eof:
            # The rest that the client sends is read and passed over until then.
            self._transport.write_eof()
            self._transport.resume_reading()
        else:
            self._transport.close()

    def abort(self) -> None:
        self.is_open = False
        self._transport.abort()

    def leave(self) -> None:
        self._close_after_replies(linger=False)

    async def close(self, code: int, reason: str) -> None:
        """End the connection with a reason, and wait for its end; arguments as of :meth:`end`."""
        self.end(reason, code)
        await self._lost.wait()

    async def wait_ended(self) -> None:
        """Wait until the client is not served any more and the connection has ended."""
        await self._lost.wait()
        if self._task is not None:
            await asyncio.wait([self._task])

    async def read_to_end(self) -> None:
        """Wait until no further frame comes; ConnectionResetError if the client broke off, else ConnectionError."""
        await self._read_all.wait()
        if self._failure is not None:
            raise self._failure

    # What comes from the client.

    def data_received(self, data: bytes) -> None:
        """Hand over the frames in what the socket has received, until the turn is over."""
        for piece, epoch in self._dated(data):
            if self._ending:
                return
            try:
                self._add(piece)
            except MemoryError:
                self.end_out_of_memory()
                return
            if not self._turn_waits:
                self._epoch = STOP_EPOCHS.present if epoch is None else epoch
                self._take_turn()

    def date_unread(self, epoch: int | None = None) -> None:
        """Note that what the socket holds has arrived in a stop epoch; None for the epoch of a stop that comes now."""
        try:
            descriptor = self._transport.get_extra_info("socket").fileno()
            unread = int.from_bytes(fcntl.ioctl(descriptor, termios.FIONREAD, bytes(4)), sys.byteorder)
        except (OSError, ValueError):
            # It is being closed.
            return
        # With TLS these are bytes of the encrypted stream, a few more than of the client's.
        end = self.received_bytes + unread
        if unread and (not self._unread or self._unread[-1][0] < end):
            full = len(self._unread) >= MAX_UNREAD
            arrived = STOP_EPOCHS.present if epoch is None else epoch
            self._unread.append((end, self._unread.pop()[1] if full else arrived))

    def _dated(self, data: bytes) -> list[tuple[bytes, int | None]]:
        """Count what has been received, and part it by the stop epochs of its arrival, None for the present one."""
        pieces: list[tuple[bytes, int | None]] = []
        begin = self.received_bytes
        self.received_bytes += len(data)
        while self._unread and data:
            end, epoch = self._unread[0]
            if end <= begin:
                self._unread.popleft()
                continue
            pieces.append((data[: end - begin], epoch))
            begin, data = end, data[end - begin :]
        return [*pieces, (data, None)] if data else pieces

    def eof_received(self) -> bool:
        """End the client when all has been read; return True to let it read its last replies."""
        self._at_eof = True
        if self._ending:
            return False
        if not self._turn_waits:
            self._take_turn()
        return self._transport.can_write_eof()

    def _take_turn(self) -> None:
        """Hand over frames until the turn is over; the rest waits for the next turn, and the socket with it."""
        self._turn_waits = False
        ends_s = time.monotonic() + TURN_S
        try:
            while (self._client is not None or self._discards) and not self._held and not self._ending:
                frame = self._next_frame()
                if frame is None:
                    self._go_on_reading()
                    return
                if self._client is not None and not self._discards:
                    before, dated = STOP_EPOCHS.present, len(self._unread)
                    self._client.receive_frame(frame, self._epoch)
                    # Frames behind the client's own stop are later.
                    while STOP_EPOCHS.present > before and len(self._unread) > dated:
                        self._unread.pop()
                    if self._epoch == before:
                        self._epoch = STOP_EPOCHS.present
                if time.monotonic() >= ends_s:
                    self._take_turn_later()
                    break
        except FrameError as error:
            self.end(str(error))
            return
        except MemoryError:
            self.end_out_of_memory()
            return
        if not self._reading_paused and not self._ending and not self._transport.is_closing():
            self._reading_paused = True
            self._transport.pause_reading()

    def _take_turn_later(self) -> None:
        if not self._turn_waits:
            self._turn_waits = True
            asyncio.get_running_loop().call_soon(self._take_turn)

    def _go_on_reading(self) -> None:
        if self._at_eof:
            self._end_of_stream()
        elif self._reading_paused and not self._transport.is_closing():
            self._reading_paused = False
            self._transport.resume_reading()

    def _end_of_stream(self) -> None:
        """Note that the client has sent its last; it may still read."""
        self._read_all.set()

    def end_out_of_memory(self) -> None:
        """End this connection alone; what it holds is freed for the words."""
        self._clear()
        try:
            self.end(OUT_OF_MEMORY)
        except MemoryError:
            self.abort()

    def hold_reading(self) -> None:
        self._held = True

    def release_reading(self) -> None:
        self._held = False
        self._take_turn_later()

    def start_delivery(self, client: Client) -> None:
        self._client = client
        self._take_turn_later()

    def stop_delivery(self) -> None:
        self._client, self._discards = None, False

    # What goes to the client.

    @property
    def takes_more(self) -> bool:
        """True while the socket takes a message without waiting."""
        return self.is_open and self._writable.is_set()

    @property
    def taken_bytes(self) -> int:
        """Bytes of frames that the socket has taken: they grow as long as the client reads."""
        waiting_bytes = self._transport.get_write_buffer_size() + self._unsent_bytes if self.is_open else 0
        return self.sent_bytes - waiting_bytes

    def send_at_once(self, encoded: EncodedMessage) -> bool:
        """Send a message, in order of calling, if the socket takes it without waiting; return True when it is sent.

        In a flood it is written at the end of the event loop's turn: a kernel call for each is a third of all cost.
        """
        if not self.takes_more:
            return False
        pieces = encoded.wire
        size_bytes = sum(map(len, pieces))
        self.sent_messages += encoded.frame_count
        self.sent_bytes += size_bytes
        if not self._unsent:
            now_s = time.monotonic()
            if now_s - self._last_sent_s > BURST_S:
                self._last_sent_s = now_s
                self._write(pieces)
                return True
            asyncio.get_running_loop().call_soon(self._write_unsent)
        self._unsent += pieces
        self._unsent_bytes += size_bytes
        if self._unsent_bytes + self._transport.get_write_buffer_size() > WRITE_LIMIT_BYTES:
            self._write_unsent()
        return True

    def send_all(self, messages: Sequence[EncodedMessage]) -> None:
        """Send messages that have waited, after `takes_more` was true; one call of the kernel takes them together."""
        pieces = [piece for encoded in messages for piece in encoded.wire]
        self.sent_messages += sum(encoded.frame_count for encoded in messages)
        self.sent_bytes += sum(map(len, pieces))
        self._write(pieces)

    def _write_unsent(self) -> None:
        pieces, self._unsent, self._unsent_bytes = self._unsent, [], 0
        if pieces and self.is_open:
            self._write(pieces)

    def _write(self, pieces: Sequence[bytes]) -> None:
        if self._unsent:
            self._write_unsent()
        self._write_now(pieces)

    def _write_now(self, pieces: Sequence[bytes]) -> None:
        try:
            if WRITELINES_NEVER_PAUSES:
                self._transport.write(b"".join(pieces))
            else:
                self._transport.writelines(pieces)
        except MemoryError:
            # Part of a frame may have been written, so no reason can follow.
            self._failure = ConnectionAbortedError(OUT_OF_MEMORY)
            self.abort()

    def pause_writing(self) -> None:
        self._writable.clear()

    def resume_writing(self) -> None:
        self._writable.set()
        if self._client is not None:
            self._client.wake()

    async def drain(self) -> None:
        await self._writable.wait()


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
            super().resume_writing()

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

"""WebSocket connection that hands messages over as they come, in turns that leave time to other connections.

Of websockets it uses, beyond the documented interface: ``process_event``, ``send_data`` and ``start_keepalive`` of
``ServerConnection`` (overridden), ``drain``, ``recv_messages`` with its ``frames``, ``pause`` and ``resume``,
``protocol.handshake_exc``, ``protocol.max_message_size``, ``protocol.parse`` with ``parser``, and ``handler``,
``handler_tasks`` and ``all_connections`` of ``Server``. The tests of this module and of
:mod:`server.gateway.connection` cover each use.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import secrets
import time
from collections.abc import Callable, Coroutine, Sequence
from typing import Any, cast
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import Server, ServerConnection
from websockets.exceptions import InvalidMessage
from websockets.frames import CloseCode, Frame, Opcode
from websockets.http11 import Request, Response
from websockets.protocol import State
from websockets.server import ServerProtocol

from protocol.errors import one_line, shorten
from protocol.publication import EncodedMessage
from server.gateway.admission import ConnectionLimiter, ConnectionSlot
from server.gateway.client_transport import address_and_port, reset
from server.gateway.frame_reader import FrameReader, Piece
from server.gateway.handshake import accept, read_upgrade
from server.gateway.http import bad_request
from server.gateway.turns import TURN_S
from server.graph.permissions import ANYONE, Identity

# Looking a member of an enumeration up takes as long as calling a function.
_OPEN, _TEXT, _BINARY, _PONG = State.OPEN, Opcode.TEXT, Opcode.BINARY, Opcode.PONG

# Messages that follow one another more quickly than this leave together, when the event loop's turn ends: more than a
# message of a flood takes. Where there is no flood the turn ends at once.
BURST_S = 0.0002

# While more than this waits for the socket to take it, the rest waits where it can be dropped. It is where websockets'
# writer has itself paused (its default write_limit), so `drain` waits exactly then.
WRITE_LIMIT_BYTES = 32_768

# What ends the head of an HTTP request.
_END_OF_REQUEST = b"\r\n\r\n"

# Reason of a connection's end, which is the client's and the log's.
OUT_OF_MEMORY = "the server is out of memory for this message"

# Clients send their request at once; one that takes longer only holds the connection (slow loris).
REQUEST_TIMEOUT_S = 10.0


class WebSocket(ServerConnection):
    """Connection of one client.

    Waking a task for each message costs as much as all else that is done for a short one. So a message that comes when
    none waits is handed over at once; what comes after the client's turn is over waits for the task that iterates over
    the connection, as with websockets' own class.

    Args:
        protocol: Sans-I/O connection of websockets.
        server: websockets' server.
        limiter: counter of connections.
        connections: every connection of the listener; this one is in it from ``connection_made`` to
            ``connection_lost``.
        admit: checks a request; returns the answer to one that is refused.
        serve: serves the client until it leaves, when the WebSocket is open.
        options: further arguments of :class:`ServerConnection`.

    Attributes:
        slot: its place among all connections; None for a connection that is closed without an answer.
        rejection: answer to a request that was checked already, and refused.
        identity: identity of the client; None until it has authenticated.
        received_bytes: bytes received, those of the handshake included.
        sent_messages: WebSocket messages sent; a fragment is one.
        sent_bytes: bytes of these messages.
    """

    # Beside those of websockets' own class there is no room in a dictionary whose keys all connections share.
    __slots__ = (
        "_admit",
        "_connections",
        "_frames",
        "_full",
        "_held",
        "_keepalive",
        "_last_sent_s",
        "_limiter",
        "_on_message",
        "_ping_data",
        "_pinged_s",
        "_request_end",
        "_request_refused",
        "_request_timer",
        "_serve",
        "_unread",
        "_unsent",
        "_unsent_bytes",
        "_untouched",
        "identity",
        "received_bytes",
        "rejection",
        "sent_bytes",
        "sent_messages",
        "slot",
    )

    framed = True

    def __init__(
        self,
        protocol: ServerProtocol,
        server: Server,
        *,
        limiter: ConnectionLimiter,
        connections: set[WebSocket],
        admit: Callable[[WebSocket, Request], Response | None],
        serve: Callable[[WebSocket], Coroutine[Any, Any, None]],
        **options: Any,
    ) -> None:
        super().__init__(protocol, server, **options)
        self._limiter = limiter
        self._connections = connections
        self._admit = admit
        self._serve = serve
        # Nothing has come yet.
        self._untouched = True
        # The next ping, or the end of the wait for the answer to one.
        self._keepalive: asyncio.TimerHandle | None = None
        self._ping_data = b""
        self._pinged_s = 0.0
        self.slot: ConnectionSlot | None = None
        self.rejection: Response | None = None
        self.identity: Identity | None = ANYONE
        self._request_timer: asyncio.TimerHandle | None = None
        self._request_refused = False
        self._on_message: Callable[[str | bytes], None] | None = None
        self.received_bytes = 0
        self.sent_messages = 0
        self.sent_bytes = 0
        # None until the request has been read; and the last bytes of what there is of it.
        self._frames: FrameReader | None = None
        self._request_end = b""
        # Bytes still to be read, a queue of messages that is full, and an inbox that is.
        self._unread = b""
        self._full = False
        self._held = False
        self._last_sent_s = -math.inf
        self._unsent: list[bytes] = []
        self._unsent_bytes = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a place among the connections, and limit the time for the request."""
        peer = transport.get_extra_info("peername")
        self.slot = self._limiter.acquire(address_and_port(peer)[0], time.monotonic())
        if self.slot is None:
            # websockets is not told of it.
            reset(transport)
            return
        # Not that of the class between, which makes a task for the handshake: few clients need one.
        super(ServerConnection, self).connection_made(transport)
        self._connections.add(self)
        self.recv_messages.pause = self._pause_reading
        self.recv_messages.resume = self._resume_reading
        self._request_timer = self.loop.call_later(REQUEST_TIMEOUT_S, self._end_request, REQUEST_TIMEOUT_S)

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the place."""
        if self.slot is None:
            return
        self._end_request_timer()
        self._end_keepalive()
        self._unread = b""
        self._connections.discard(self)
        self.slot.release()
        super().connection_lost(exc)
        # Without these cycles the connection is freed at once; the garbage collector took a tenth of its whole cost.
        self.recv_messages.pause = self.recv_messages.resume = _do_nothing
        self.protocol.parser.close()

    def eof_received(self) -> None:
        """End a connection that may stay, as websockets does."""
        if self.slot is not None:
            super().eof_received()

    def send_data(self) -> None:
        """Answer a request that cannot be read; websockets ends such a connection without a word."""
        if self._request_timer is not None and isinstance(error := self.protocol.handshake_exc, InvalidMessage):
            reason = one_line(shorten(str(error.__cause__ or error)))
            self._refuse_request(f"this is no complete HTTP request: {reason}")
        super().send_data()

    def _end_request(self, timeout_s: float) -> None:
        """Answer a request that has not come to its end in time, and end the connection."""
        if self._request_refused or not self.received_bytes:
            self.transport.abort()
            return
        self._refuse_request(f"the request was not complete within {timeout_s:g} s")
        self.transport.close()

    def _refuse_request(self, sentence: str) -> None:
        # A connection on which nothing ever came is one that a browser has opened ahead, or a port scan.
        if not self._request_refused and self.received_bytes:
            self._request_refused = True
            self.transport.write(bad_request(sentence))

    def start_delivery(self, on_message: Callable[[str | bytes], None]) -> None:
        """Hand messages over as they come.

        Args:
            on_message: called with a message, text or bytes; must not raise.
        """
        self._forget_handshake()
        self._on_message = on_message

    def _forget_handshake(self) -> None:
        """Free the headers of request and response: they take as much memory as all else of an idle client."""
        if self.request is not None:
            # websockets itself holds on to the request.
            self.request.headers.clear()
        self.response = None

    def stop_delivery(self) -> None:
        """Leave messages to the task that iterates over the connection."""
        self._on_message = None

    def _end_request_timer(self) -> None:
        if self._request_timer is not None:
            self._request_timer.cancel()
            self._request_timer = None

    @property
    def peer(self) -> tuple[str, int]:
        """IP address and port of the client."""
        return address_and_port(self.remote_address)

    @property
    def query(self) -> dict[str, list[str]]:
        """Fields of the query in the client's URL."""
        path = self.request.path if self.request else ""
        return parse_qs(urlsplit(path).query) if "?" in path else {}

    @property
    def max_message_bytes(self) -> int | None:
        """Size of a message beyond which the connection is closed (1009) before it is read; None for any."""
        return self.protocol.max_message_size

    @max_message_bytes.setter
    def max_message_bytes(self, limit_bytes: int | None) -> None:
        self.protocol.max_message_size = limit_bytes

    @property
    def is_open(self) -> bool:
        """True between the opening and the closing handshake."""
        return self.protocol.state is _OPEN

    def abort(self) -> None:
        """End the connection without a closing handshake."""
        self.transport.abort()

    @property
    def takes_more(self) -> bool:
        """True while the socket takes a message without waiting."""
        # The order counts: the transport of a connection that is lost can be asked nothing.
        if self.protocol.state is not _OPEN:
            return False
        return bool(self.transport.get_write_buffer_size() + self._unsent_bytes <= WRITE_LIMIT_BYTES)

    def send_at_once(self, encoded: EncodedMessage) -> bool:
        """Send a message, in order of calling, if the socket takes it without waiting; return True when it is sent.

        A task and an event for each message would cost more than the message, and so would making its frame anew for
        each client. Messages that follow closely upon another leave together, at the end of the event loop's turn: in a
        flood, one call of the kernel a message is a tenth of all that is spent.
        """
        if not self.takes_more:
            return False
        pieces = encoded.wire_pieces()
        size_bytes = sum(map(len, pieces))
        self.sent_messages += encoded.frame_count
        self.sent_bytes += size_bytes
        if not self._unsent:
            now_s = time.monotonic()
            if now_s - self._last_sent_s > BURST_S:
                self._last_sent_s = now_s
                self._write(pieces)
                return True
            self.loop.call_soon(self._write_unsent)
        self._unsent += pieces
        self._unsent_bytes += size_bytes
        return True

    def send_all(self, messages: Sequence[EncodedMessage]) -> None:
        """Send messages that have waited, while `takes_more` is true; one call of the kernel takes them together."""
        pieces = [piece for encoded in messages for piece in encoded.wire_pieces()]
        size_bytes = sum(map(len, pieces))
        self.sent_messages += sum(encoded.frame_count for encoded in messages)
        self.sent_bytes += size_bytes
        if self._unsent:
            self._unsent += pieces
            self._unsent_bytes += size_bytes
        else:
            self._write(pieces)

    @property
    def taken_bytes(self) -> int:
        """Bytes of messages that the socket has taken: they grow as long as the client reads."""
        if self.protocol.state is not _OPEN:
            return self.sent_bytes
        return self.sent_bytes - self._unsent_bytes - self.transport.get_write_buffer_size()

    def _write_unsent(self) -> None:
        if self.protocol.state is _OPEN:
            self._write(self._unsent)
        self._unsent.clear()
        self._unsent_bytes = 0

    def _write(self, pieces: Sequence[bytes]) -> None:
        try:
            self.transport.writelines(pieces)
        except MemoryError:
            self.end_out_of_memory(mid_frame=True)

    def data_received(self, data: bytes) -> None:
        """Begin a turn with the bytes that the socket has received."""
        if self.slot is None:
            return
        self.received_bytes += len(data)
        if self._untouched:
            self._untouched = False
            if self._open_at_once(data):
                self._start_task(self._serve_at_once())
                return
            self._start_task(self.server.handler(self))
        try:
            if self._unread or not self._may_read:
                self._unread += data
            else:
                self._take(data)
        except MemoryError:
            self.end_out_of_memory()

    def _open_at_once(self, data: bytes) -> bool:
        """Open the WebSocket for a plain request that is admitted; return False to leave the answer to websockets."""
        if self.slot is None or self.slot.rejection is not None or not self.server.is_serving():
            return False
        request = read_upgrade(data)
        if request is None:
            return False
        self.rejection = self._admit(self, request)
        if self.rejection is not None:
            return False
        self._end_request_timer()
        self.request = request
        self.transport.write(accept(request))
        # As websockets' own handshake leaves it: open, and reading frames.
        self.protocol.state = _OPEN
        self.protocol.parser = self.protocol.parse()
        next(self.protocol.parser)
        self._frames = FrameReader()
        # The server ends its connections by this set.
        self.server.all_connections.add(self)
        return True

    def _start_task(self, handler: Coroutine[Any, Any, None]) -> None:
        """Start the task of the connection, which the end of the server waits for."""
        self.server.handler_tasks.add(self.loop.create_task(handler))

    async def _serve_at_once(self) -> None:
        """Serve the client of a WebSocket that was opened at once, as websockets does after its own handshake."""
        self.start_keepalive()
        try:
            await self._serve(self)
        except Exception:
            self.logger.exception("connection handler failed")
            await self.close(CloseCode.INTERNAL_ERROR)
        else:
            if self.protocol.state is not State.CLOSED:
                await self.close()
        finally:
            self.server.all_connections.discard(self)
            self.server.handler_tasks.discard(cast("asyncio.Task[None]", asyncio.current_task()))

    def start_keepalive(self) -> None:
        """Ask from time to time whether the client is still there, by timers; websockets has a task for it."""
        if self.ping_interval is not None:
            self._keepalive = self.loop.call_later(self.ping_interval, self._ping)

    def _ping(self) -> None:
        if self.protocol.state is not _OPEN:
            # It has been told to close, and has had the time.
            self.transport.abort()
            return
        self._ping_data, self._pinged_s = secrets.token_bytes(4), self.loop.time()
        self.protocol.send_ping(self._ping_data)
        self.send_data()
        if self.ping_timeout is not None:
            self._keepalive = self.loop.call_later(self.ping_timeout, self._end_silent)

    def _receive_pong(self, data: bytes) -> None:
        """Let the next ping follow at its time; a pong that answers none is ignored (RFC 6455, 5.5.3)."""
        if self._ping_data and data == self._ping_data and self.ping_interval is not None:
            self._ping_data = b""
            self._end_keepalive()
            latency_s = self.loop.time() - self._pinged_s
            self._keepalive = self.loop.call_later(max(0.0, self.ping_interval - latency_s), self._ping)

    def _end_silent(self) -> None:
        """End a connection whose client has not answered."""
        self.protocol.fail(CloseCode.INTERNAL_ERROR, "keepalive ping timeout")
        self.send_data()
        self._keepalive = self.loop.call_later(self.close_timeout or 0.0, self.transport.abort)

    def _end_keepalive(self) -> None:
        if self._keepalive is not None:
            self._keepalive.cancel()
            self._keepalive = None

    def _take(self, data: bytes) -> None:
        """Read until the turn is over; the rest waits for the next turn, and the socket with it."""
        turn_ends_s = time.monotonic() + TURN_S
        begin = 0 if self._frames is not None else self._take_request(data)
        while self._frames is not None and begin < len(data) and self._may_read:
            begin, piece = self._frames.next(data, begin, self.protocol.max_message_size)
            if piece is not None and not (piece.header_bytes and self._hand_over(piece)):
                super().data_received(bytes(piece.raw))
            if time.monotonic() >= turn_ends_s:
                break
        if begin < len(data):
            self._unread = data[begin:]
            self._stop_reading()
            if self._may_read:
                self.loop.call_soon(self._go_on)

    def _take_request(self, data: bytes) -> int:
        """Read on to the end of the request; return where the frames begin that a client has sent along with it."""
        before = self._request_end
        place = (before + data).find(_END_OF_REQUEST)
        self._request_end = (before + data)[1 - len(_END_OF_REQUEST) :]
        end = len(data)
        if place >= 0:
            end = place + len(_END_OF_REQUEST) - len(before)
            self._frames = FrameReader()
        super().data_received(data[:end])
        return end

    def _hand_over(self, piece: Piece) -> bool:
        """Hand a message over; return False for one that is left to websockets, which knows what to do."""
        # What the queue holds goes first.
        if self._on_message is None or len(self.recv_messages.frames) or self.protocol.state is not _OPEN:
            return False
        try:
            message = piece.message()
        except UnicodeDecodeError:
            return False
        self._on_message(message)
        return True

    def _go_on(self) -> None:
        if not self._may_read:
            return
        data, self._unread = self._unread, b""
        if self.transport.is_closing():
            return
        try:
            self._take(data)
        except MemoryError:
            self.end_out_of_memory()
            return
        if not self._unread and self._may_read:
            self.transport.resume_reading()

    def end_out_of_memory(self, *, mid_frame: bool = False) -> None:
        """End this connection alone; a loop that gets the error ends it with a traceback, or leaves it standing still.

        Args:
            mid_frame: True when part of a frame may have been written, behind which the client can be told nothing.
        """
        self._unread, self._frames = b"", None
        if self.protocol.state is _OPEN:
            self.protocol.fail(CloseCode.INTERNAL_ERROR, OUT_OF_MEMORY)
        if not mid_frame:
            with contextlib.suppress(MemoryError):
                self.send_data()
                self.transport.close()
                return
        self.transport.abort()

    @property
    def _may_read(self) -> bool:
        return not (self._full or self._held)

    def hold_reading(self) -> None:
        """Read nothing more for now, because the client's inbox is full."""
        self._held = True
        self._stop_reading()

    def release_reading(self) -> None:
        """Read again."""
        self._held = False
        self.loop.call_soon(self._go_on)

    def _pause_reading(self) -> None:
        """Stop reading while too many messages wait."""
        self._full = True
        self._stop_reading()

    def _resume_reading(self) -> None:
        self._full = False
        self.loop.call_soon(self._go_on)

    def _stop_reading(self) -> None:
        if not self.transport.is_closing():
            self.transport.pause_reading()

    def process_event(self, event: Any) -> None:
        """Hand a message over that websockets has read, for instance a compressed one, or leave it to the queue."""
        # The first event is the request.
        if self._request_timer is not None:
            self._end_request_timer()
        # What websockets' queue holds goes first.
        if self._on_message is None or not _is_message(event) or len(self.recv_messages.frames):
            if isinstance(event, Frame) and event.opcode is _PONG:
                self._receive_pong(bytes(event.data))
            super().process_event(event)
            return
        try:
            message = event.data.decode() if event.opcode is _TEXT else bytes(event.data)
        except UnicodeDecodeError:
            # websockets closes the connection with 1007 when the message is read from its queue.
            super().process_event(event)
            return
        self._on_message(message)


def _do_nothing() -> None:
    """Stand for a callback of a connection that has ended."""


def _is_message(event: Any) -> bool:
    """Return True for a whole message, False for a fragment, a control frame or the request."""
    return isinstance(event, Frame) and event.fin and (event.opcode is _TEXT or event.opcode is _BINARY)

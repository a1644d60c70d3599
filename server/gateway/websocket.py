"""WebSocket of one client (RFC 6455), its opening handshake, and the requests over HTTP that come to the same port.

Control frames, fragments and everything unusual are for ``ServerProtocol``, the documented sans-I/O interface of
websockets. Whole messages, nearly all that clients send, are read here, which saves a quarter of the time of a flood.
Their mask is taken off by ``websockets.speedups.apply_mask``, the one name in use that websockets does not document: so
pyproject.toml bounds its version, and each new major version has to be tried.
"""

import asyncio
import contextlib
import functools
import logging
import re
import secrets
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from typing import cast

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosedOK
from websockets.frames import CloseCode, Frame, Opcode
from websockets.http11 import Request, Response
from websockets.protocol import State
from websockets.server import ServerProtocol
from websockets.speedups import apply_mask

from robot.stop_epochs import STOP_EPOCHS
from server.gateway.admission import AdmissionPolicy, ConnectionLimiter, HandshakeRequest
from server.gateway.http import HttpHandler, HttpResponse, PostedRequest, names, query_of
from server.gateway.settings import ServerSettings
from server.gateway.transport import INTERNAL_ERROR, OUT_OF_MEMORY, Transport
from server.graph.permissions import Identity

_log = logging.getLogger("armbridge.gateway.websockets")

# Names and values as websockets allows them (RFC 9110, 5.1 and 5.5), and as many headers. No part can give back what it
# has matched to the next one, so matching takes one pass. HTTP/1.0 is the protocol of old controllers.
MAX_HEADERS = 128
_HEAD = re.compile(
    rb"([A-Z]{1,20}) ([!-~]+) (HTTP/1\.[01])\r\n"
    rb"((?:[-!#$%%&'*+.^_`|~0-9a-zA-Z]+:[\t -~\x80-\xff]*\r\n){0,%d})\r\n" % MAX_HEADERS
)
_END_OF_LINE, _END_OF_HEAD = b"\r\n", b"\r\n\r\n"

# As many servers allow: a line, and all of a head, in which a browser may send the cookies of other programs.
MAX_LINE_BYTES, MAX_HEAD_BYTES = 8192, 32_768

_MAY_HAVE_BODY = ("POST", "PUT", "PATCH")


class RequestError(Exception):
    """A request that cannot be read, and the status of its answer."""

    def __init__(self, sentence: str, status: HTTPStatus = HTTPStatus.BAD_REQUEST) -> None:
        super().__init__(f"this is no complete HTTP request: {sentence}")
        self.status = status


# RFC 8446 5.1: the first bytes of a client that begins TLS, which waits for an answer.
_TLS_HANDSHAKE = b"\x16\x03"


def read_request(data: bytes) -> tuple[Request, int] | None:
    """Return a request and the size of its head, behind which its body may follow; None while the head is incomplete.

    Raises RequestError. The parser of websockets reads no requests with a body.
    """
    if data.startswith(_TLS_HANDSHAKE):
        raise RequestError("the client speaks wss:// or https://, and here is ws:// and http://")
    end = data.find(_END_OF_HEAD)
    head_bytes = len(data) if end < 0 else end + len(_END_OF_HEAD)
    line_bytes = data.find(_END_OF_LINE, 0, MAX_LINE_BYTES)
    if line_bytes < 0 and head_bytes > MAX_LINE_BYTES:
        raise RequestError(f"its first line has more than {MAX_LINE_BYTES} bytes", HTTPStatus.REQUEST_URI_TOO_LONG)
    if head_bytes > MAX_HEAD_BYTES or data.count(_END_OF_LINE, 0, head_bytes) > MAX_HEADERS + 2:
        sentence = f"its head has more than {MAX_HEAD_BYTES} bytes or {MAX_HEADERS} headers"
        raise RequestError(sentence, HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
    if end < 0:
        return None
    found = _HEAD.fullmatch(data, 0, head_bytes)
    if found is None:
        raise RequestError("invalid request line or header")
    method, path, protocol, lines = (part.decode("latin-1") for part in found.groups())
    headers = Headers()
    for line in lines.split("\r\n")[:-1]:
        name, _, value = line.partition(":")
        headers[name] = value.strip(" \t")
    has_body = headers.get_all("Transfer-Encoding") or {*headers.get_all("Content-Length")} - {"0"}
    if has_body and method not in _MAY_HAVE_BODY:
        raise RequestError(f"{method} with a body")
    return Request(path, headers, method, protocol), head_bytes


# Clients send their request at once; a slow one only holds the connection (slow loris).
REQUEST_TIMEOUT_S = 10.0

# Time for an answer over HTTP to be read, as the largest mesh of 20 MB is at 170 kB/s over a poor wireless link.
ANSWER_TIMEOUT_S = 120.0

# A message up to this many times the limit is still read, to be refused by the session while the connection lives on;
# beyond it the socket is closed (1009) before it is read.
OVERSIZE = 2

# Frames up to this size are read here; those beyond take websockets' way, whose cost is in their bytes.
SHORT_FRAME_BYTES = 65_536

# Without the debug lines of websockets: they contain every address and every message, and so every token.
_log.setLevel(logging.WARNING)

# For a client that waits with its body for it (RFC 9110, 10.1.1).
_CONTINUE = b"HTTP/1.1 100 Continue\r\n\r\n"

# First byte of a whole message: its last frame (0x80), text or binary, without reserved bits (RFC 6455, 5.2).
_WHOLE_TEXT, _WHOLE_BINARY = _WHOLE = 0x81, 0x82
_OPCODE, _LAST_DATA_OPCODE, _MASKED, _LENGTH = 0x0F, 0x02, 0x80, 0x7F
_MASK_BYTES = 4


class WebSocket(Transport):
    """Connection of one client: a WebSocket, or one request over HTTP."""

    def __init__(
        self,
        settings: ServerSettings,
        limiter: ConnectionLimiter,
        transports: set[Transport],
        serve: Callable[[Transport], Awaitable[None]],
        admission: AdmissionPolicy,
        http: HttpHandler,
    ) -> None:
        super().__init__(limiter, transports, serve)
        self.max_message_bytes = OVERSIZE * settings.limits.max_message_bytes
        self._settings = settings
        self._admission = admission
        self._http = http
        self._protocol = ServerProtocol(state=State.OPEN, max_size=None, logger=_log)
        self._rejection: HttpResponse | None = None
        # A posted request whose body has yet to come: its sender, the body's size, and the stop epoch of its arrival.
        self._post: tuple[Request, Identity, int, int] | None = None
        # The end of the wait for the request; later the next ping, or the end of the wait for its answer.
        self._timer: asyncio.TimerHandle | None = None
        self._opened = False
        # Received bytes, and how far they have been read.
        self._data = b""
        self._begin_at = 0
        # Rest of a frame that is websockets' to read, and the pieces of a message in fragments.
        self._foreign_bytes = 0
        self._fragments: list[bytes] = []
        self._fragments_bytes = 0
        self._is_text = False
        self._ping_data = b""
        self._pinged_s = 0.0

    def _begin(self, rejection: HttpResponse | None) -> None:
        self._rejection = rejection
        self._call_later(REQUEST_TIMEOUT_S, self._end_request)

    def connection_lost(self, exc: Exception | None) -> None:
        self._cancel_timer()
        if self._opened and not self._ending:
            self._failure = self._failure or self._protocol_failure()
        self._leave_post()
        super().connection_lost(exc)

    def _clear(self) -> None:
        self._data, self._begin_at = b"", 0
        self._fragments.clear()

    # The request.

    def data_received(self, data: bytes) -> None:
        if self._opened or self._ending:
            super().data_received(data)
            return
        epoch = self._dated(data)[0][1]
        # No more is read while a request over HTTP is being answered.
        if self._task is None:
            self._data += data
            self._epoch = STOP_EPOCHS.present if epoch is None else epoch
            self._read_request()

    def _respond(self, request: Request) -> None:
        """Open the WebSocket, refuse the request, or leave it to the handler of HTTP."""
        self._cancel_timer()
        upgrade = names(request.headers, "Upgrade", "websocket")
        encrypted = self._transport.get_extra_info("sslcontext") is not None
        admitted = self._rejection or self._admission.check(
            HandshakeRequest(self.peer[0], request.path, request.headers, upgrade, encrypted)
        )
        if isinstance(admitted, HttpResponse):
            self._write((admitted.response(request).serialize(),))
            self._close_after_replies()
        elif upgrade:
            self.identity = admitted
            response = self._protocol.accept(request)
            self._write((response.serialize(),))
            if response.status_code == HTTPStatus.SWITCHING_PROTOCOLS:
                self._open(request)
            else:
                self._close_after_replies()
        else:
            body_bytes = self._http.body_bytes(request)
            if isinstance(body_bytes, HttpResponse):
                self._write((body_bytes.response(request).serialize(),))
                self._close_after_replies()
            elif body_bytes is None or admitted is None:
                self._task = asyncio.get_running_loop().create_task(self._answer(request))
            else:
                self._post = request, admitted, body_bytes, self._epoch
                self._call_later(REQUEST_TIMEOUT_S, self._end_request)
                if request.headers.get("Expect"):
                    self._write((_CONTINUE,))

    def _open(self, request: Request) -> None:
        self._opened = True
        self.query = query_of(request.path)
        # websockets holds on to the request, whose headers take as much memory as all else of an idle client.
        request.headers.clear()
        self._call_later(self._settings.ping_interval_s, self._ping)
        self._start_serving()

    async def _answer(self, request: Request) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                await self._http.answer(request, self._send_answer)
        self._close_after_replies()

    def _read_request(self) -> None:
        """Read a request, and answer a posted one once its body is there."""
        if self._post is None:
            try:
                found = read_request(self._data)
            except RequestError as error:
                self._cancel_timer()
                self._refuse_request(str(error), error.status)
                return
            if found is None:
                return
            # Frames that a client sends along with its request are read when the WebSocket is open.
            self._data = self._data[found[1] :]
            self._respond(found[0])
        if self._post is None or len(self._data) < self._post[2]:
            return
        self._cancel_timer()
        request, identity, body_bytes, epoch = self._post
        posted = PostedRequest(request, self._data[:body_bytes], identity, "{}:{}".format(*self.peer), epoch)
        self._task = asyncio.get_running_loop().create_task(self._answer_posted(posted))

    async def _answer_posted(self, posted: PostedRequest) -> None:
        try:
            answer = await self._http.answer_posted(posted)
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                await self._send_answer(answer.response(posted.request))
        finally:
            self._close_after_replies()

    def _leave_post(self) -> None:
        if self._post is not None and self._task is not None:
            self._task.cancel()

    async def _send_answer(self, response: Response) -> None:
        self._transport.set_write_buffer_limits(0)
        self._write_now((response.serialize(),))
        await self.drain()

    def _end_request(self) -> None:
        self._refuse_request(f"the request was not complete within {REQUEST_TIMEOUT_S:g} s")

    def _refuse_request(self, sentence: str, status: HTTPStatus = HTTPStatus.BAD_REQUEST) -> None:
        # A connection without a byte was opened ahead by a browser, or is a port scan.
        if self.received_bytes:
            self._write((HttpResponse.of_text(status, sentence).response(Request("/", Headers())).serialize(),))
        self._close_after_replies(linger=bool(self.received_bytes))

    def eof_received(self) -> bool:
        if self._post is not None and self._task is not None:
            # A program that has ended and a program that sends no more look the same.
            self._at_eof = True
            self._leave_post()
            return False
        if self._opened or self._task is not None or self._ending:
            return super().eof_received()
        self._at_eof = True
        self._refuse_request("this is no complete HTTP request: connection closed while reading HTTP")
        return False

    # Pings.

    def _call_later(self, delay_s: float, function: Callable[[], None]) -> None:
        self._cancel_timer()
        self._timer = asyncio.get_running_loop().call_later(delay_s, function)

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _ping(self) -> None:
        """Ask the client whether it is still there (RFC 6455, 5.5.2)."""
        if not self.is_open:
            return
        self._ping_data, self._pinged_s = secrets.token_bytes(4), asyncio.get_running_loop().time()
        self._protocol.send_ping(self._ping_data)
        self._flush()
        end = functools.partial(self._fail, CloseCode.INTERNAL_ERROR, "keepalive ping timeout")
        self._call_later(self._settings.ping_timeout_s, end)

    # Frames.

    def _add(self, data: bytes) -> None:
        left = self._data[self._begin_at :]
        self._data, self._begin_at = left + data if left else data, 0

    def _next_frame(self) -> str | bytes | None:
        """Return the next message; short whole ones are read here, all others by websockets."""
        data = self._data
        while self._begin_at < len(data) and not self._ending:
            begin = self._begin_at
            if not self._foreign_bytes:
                header_bytes, size_bytes = _measure(data, begin)
                if not header_bytes:
                    break
                opening = data[begin]
                if (
                    opening in _WHOLE
                    and size_bytes <= SHORT_FRAME_BYTES
                    and not self._fragments_bytes
                    and data[begin + 1] & _MASKED
                    and self._protocol.state is State.OPEN
                ):
                    end = begin + size_bytes
                    if end > len(data):
                        break
                    self._begin_at = end
                    key_at = begin + header_bytes - _MASK_BYTES
                    payload = apply_mask(data[begin + header_bytes : end], data[key_at : key_at + _MASK_BYTES])
                    return self._decode(payload) if opening == _WHOLE_TEXT else payload
                if opening & _OPCODE <= _LAST_DATA_OPCODE and self._is_too_long(size_bytes - header_bytes):
                    break
                self._foreign_bytes = size_bytes
            piece = data[begin : begin + self._foreign_bytes]
            self._begin_at += len(piece)
            self._foreign_bytes -= len(piece)
            message = self._receive_foreign(piece)
            if message is not None:
                return message
        if not self._ending:
            self._data, self._begin_at = data[self._begin_at :], 0
        return None

    def _is_too_long(self, payload_bytes: int) -> bool:
        limit_bytes = self.max_message_bytes
        if self._fragments_bytes + payload_bytes <= limit_bytes:
            return False
        self._fail(CloseCode.MESSAGE_TOO_BIG, f"over size limit ({limit_bytes} bytes)")
        return True

    def _receive_foreign(self, data: bytes) -> str | bytes | None:
        self._protocol.receive_data(data)
        message: str | bytes | None = None
        for event in self._protocol.events_received():
            frame = cast(Frame, event)
            if frame.opcode is Opcode.PONG:
                # Let the next ping follow at its time; a pong that answers none is ignored (RFC 6455, 5.5.3).
                if self._ping_data and bytes(frame.data) == self._ping_data:
                    self._ping_data = b""
                    latency_s = asyncio.get_running_loop().time() - self._pinged_s
                    self._call_later(max(0.0, self._settings.ping_interval_s - latency_s), self._ping)
            elif frame.opcode in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
                message = self._assemble(frame)
        self._flush()
        return message

    def _assemble(self, frame: Frame) -> str | bytes | None:
        if frame.opcode is not Opcode.CONT:
            self._is_text = frame.opcode is Opcode.TEXT
        if not frame.fin:
            self._fragments.append(bytes(frame.data))
            # An empty fragment counts too: while it is not 0, a message is in progress.
            self._fragments_bytes += max(1, len(frame.data))
            return None
        payload = b"".join((*self._fragments, frame.data))
        self._fragments.clear()
        self._fragments_bytes = 0
        return self._decode(payload) if self._is_text else payload

    def _decode(self, payload: bytes) -> str | None:
        try:
            return payload.decode()
        except UnicodeDecodeError as error:
            self._fail(CloseCode.INVALID_DATA, f"{error.reason} at position {error.start}")
            return None

    # The end.

    def _fail(self, code: int, reason: str) -> None:
        """Fail the WebSocket (RFC 6455, 7.1.7)."""
        self._protocol.fail(code, reason)
        self._flush()

    def _flush(self) -> None:
        """Write what websockets has to send, and end the connection at its end."""
        for data in self._protocol.data_to_send():
            if data:
                self._write((data,))
                continue
            self._failure = self._failure or self._protocol_failure()
            self._cancel_timer()
            self._close_after_replies()

    def _protocol_failure(self) -> ConnectionError | None:
        """Return the reason of the end of an open WebSocket; None where both sides have sent a close frame."""
        self._protocol.receive_eof()
        closed = self._protocol.close_exc
        if isinstance(closed, ConnectionClosedOK):
            return None
        # A program that ends often leaves without a close frame (RFC 6455, 7.1.5: code 1006).
        breaks_off = closed.rcvd is None and closed.sent is None
        return ConnectionResetError(str(closed)) if breaks_off else ConnectionAbortedError(str(closed))

    def _end_of_stream(self) -> None:
        if self._opened:
            self._failure = self._failure or self._protocol_failure()
            self._close_after_replies()

    def end(self, reason: str, code: int = INTERNAL_ERROR) -> None:
        if self._protocol.state is State.OPEN and not self._ending:
            self._protocol.send_close(code, reason)
            self._flush()
            self.is_open = False
            # The client's own close frame is read.
            self._held = False
            self._discards = True
            self._take_turn_later()

    def end_out_of_memory(self) -> None:
        self._clear()
        try:
            self._fail(CloseCode.INTERNAL_ERROR, OUT_OF_MEMORY)
        except MemoryError:
            self.abort()

    def leave(self) -> None:
        """Close with 1001 (going away) as the server stops; a client that has sent no request yet is not waited for."""
        if self._opened:
            self.end("", CloseCode.GOING_AWAY)
        elif self._task is None:
            self.abort()


def _measure(data: bytes, begin: int) -> tuple[int, int]:
    """Return the sizes of a frame's header and of the whole frame; zeros when the header has not come whole."""
    received = len(data) - begin
    if received < 2:
        return 0, 0
    second = data[begin + 1]
    header_bytes = 2 + (_MASK_BYTES if second & _MASKED else 0)
    length = second & _LENGTH
    if length >= 126:
        # The length follows in two bytes, or in eight.
        length_bytes = 2 if length == 126 else 8
        header_bytes += length_bytes
        length = int.from_bytes(data[begin + 2 : begin + 2 + length_bytes], "big")
    return (header_bytes, header_bytes + length) if received >= header_bytes else (0, 0)

"""WebSocket frames in what a client's socket has received, told apart by their headers (RFC 6455, 5.2).

Nearly all that clients send are whole messages, one frame each. These are read here in a fraction of the time that
websockets takes, which makes an object of each frame and resumes a generator several times. Everything else is for
websockets, as it came: control frames, fragments, what is compressed, too long, or breaks a rule.
"""

from __future__ import annotations

from typing import NamedTuple

from websockets.speedups import apply_mask

# First byte of a whole message: its last frame (0x80), text or binary, without reserved bits.
_TEXT, _BINARY = 0x81, 0x82

_FIN, _OPCODE, _LAST_DATA_OPCODE = 0x80, 0x0F, 0x02
_MASKED, _LENGTH = 0x80, 0x7F

# In place of a length from 0 to 125, and one more: the length follows in two bytes, or in eight.
_TWO_BYTE_LENGTH = 126

_MASK_BYTES = 4


class Piece(NamedTuple):
    """Next part of the received bytes.

    Attributes:
        raw: the bytes: a whole message in its frame, or else any of other frames.
        header_bytes: size of the message's header; 0 for what is no message.
    """

    raw: bytes | bytearray
    header_bytes: int

    def message(self) -> str | bytes:
        """Return the message, text or bytes.

        Raises:
            UnicodeDecodeError: it is text, and not UTF-8.
        """
        raw, header = self.raw, self.header_bytes
        # A view, for a message may have megabytes.
        payload = apply_mask(memoryview(raw)[header:], raw[header - _MASK_BYTES : header])
        return payload.decode() if raw[0] == _TEXT else payload


class FrameReader:
    """Reads the frames of one client, from its first on."""

    __slots__ = ("_begun", "_frame_bytes", "_in_fragments", "_left_bytes")

    def __init__(self) -> None:
        # A message whose end has not come, or a header; and the size of that message with its header.
        self._begun = bytearray()
        self._frame_bytes = 0
        # Of a frame that is none of ours.
        self._left_bytes = 0
        self._in_fragments = False

    def next(self, data: bytes, begin: int, limit_bytes: int | None) -> tuple[int, Piece | None]:
        """Take the next message, or bytes of another frame.

        Args:
            data: received bytes.
            begin: where they have not been read yet.
            limit_bytes: size of a message beyond which it is left to websockets; None for any.

        Returns:
            How far they have been read, and the piece; None where there is none in what has been read.
        """
        if self._left_bytes:
            return self._take_foreign(data, begin)
        if self._begun:
            return self._take_on(data, begin, limit_bytes)
        header_bytes, size_bytes = _measure(data, begin)
        if header_bytes and not self._is_message(data, begin, size_bytes - header_bytes, limit_bytes):
            return self._begin_foreign(data, begin, size_bytes)
        end = begin + size_bytes
        if header_bytes and end <= len(data):
            return end, Piece(data[begin:end], header_bytes)
        self._begun += data[begin:]
        self._frame_bytes = size_bytes
        return len(data), None

    def _take_on(self, data: bytes, begin: int, limit_bytes: int | None) -> tuple[int, Piece | None]:
        """Go on with a message, or with a header, that has begun in earlier bytes."""
        if not self._frame_bytes:
            # A header comes whole nearly always; one that does not is read byte by byte.
            self._begun.append(data[begin])
            begin += 1
            begun = bytes(self._begun)
            header_bytes, size_bytes = _measure(begun, 0)
            if not header_bytes:
                return begin, None
            if not self._is_message(begun, 0, size_bytes - header_bytes, limit_bytes):
                self._begun = bytearray()
                _, piece = self._begin_foreign(begun, 0, size_bytes)
                return begin, piece
            self._frame_bytes = size_bytes
        end = begin + self._frame_bytes - len(self._begun)
        self._begun += data[begin:end]
        if len(self._begun) < self._frame_bytes:
            return len(data), None
        raw, self._begun, self._frame_bytes = self._begun, bytearray(), 0
        return end, Piece(raw, _measure(raw, 0)[0])

    def _begin_foreign(self, data: bytes, begin: int, size_bytes: int) -> tuple[int, Piece]:
        opcode = data[begin] & _OPCODE
        if opcode <= _LAST_DATA_OPCODE:
            self._in_fragments = not data[begin] & _FIN
        self._left_bytes = size_bytes
        return self._take_foreign(data, begin)

    def _take_foreign(self, data: bytes, begin: int) -> tuple[int, Piece]:
        raw = data[begin : begin + self._left_bytes]
        self._left_bytes -= len(raw)
        return begin + len(raw), Piece(raw, 0)

    def _is_message(self, data: bytes, begin: int, payload_bytes: int, limit_bytes: int | None) -> bool:
        """Tell whether a frame is a whole message that is ours to read."""
        opening = data[begin]
        if (opening != _TEXT and opening != _BINARY) or self._in_fragments or not data[begin + 1] & _MASKED:
            return False
        return limit_bytes is None or payload_bytes <= limit_bytes


def _measure(data: bytes | bytearray, begin: int) -> tuple[int, int]:
    """Return the sizes of a frame's header and of the whole frame; zeros when the header has not come whole."""
    received = len(data) - begin
    if received < 2:
        return 0, 0
    second = data[begin + 1]
    header_bytes = 2 + (_MASK_BYTES if second & _MASKED else 0)
    length = second & _LENGTH
    if length >= _TWO_BYTE_LENGTH:
        length_bytes = 2 if length == _TWO_BYTE_LENGTH else 8
        header_bytes += length_bytes
        length = int.from_bytes(data[begin + 2 : begin + 2 + length_bytes], "big")
    return (header_bytes, header_bytes + length) if received >= header_bytes else (0, 0)

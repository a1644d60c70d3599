"""Framing of a byte stream, as raw TCP carries rosbridge: bytes in, frames out.

There are no frames around the documents, which tell their own ends: a BSON document begins with its length in bytes, a
little-endian int32 that counts itself (bsonspec.org, version 1.1), and a JSON object ends with the brace that closes
it. A client speaks one of the two from its first byte to its last, as rosbridge_server's TCP handler has it
(``bson_only_mode``).
"""

from __future__ import annotations

import re

from protocol.errors import FrameError
from protocol.framing import ObjectEnd

# A stream's first bytes tell what it is; an operation takes more in either encoding.
_LENGTH_BYTES = 4

# An empty document: its length and the closing zero.
_MIN_DOCUMENT_BYTES = 5

# The highest byte of a length up to 150 MB, which settings allow 100 of. No JSON text has such a byte, for it is a
# control character; a length of 123 has the first byte of an object, and differs from it by this one.
_MAX_HIGH_BYTE = 8

# Between objects: JSON's whitespace, and the zero that programs in C send along with a text.
_FILLER = re.compile(rb"[ \t\r\n\0]*+")


class StreamSplitter:
    """Cuts the stream of one client into frames, however it is cut on its way.

    The first byte that belongs nowhere ends the stream: a web page can have a browser send an HTTP request to any port,
    with operations in its body.
    """

    def __init__(self, max_frame_bytes: int) -> None:
        self.max_frame_bytes = max_frame_bytes
        # None until four bytes are there.
        self._is_bson: bool | None = None
        self._data = bytearray()
        # Of the object that the data begins with; None between objects, and for BSON.
        self._end: ObjectEnd | None = None

    @property
    def speaks_bson(self) -> bool:
        """True once the stream has shown to be BSON."""
        return self._is_bson is True

    def add(self, data: bytes) -> None:
        """Take bytes as they come."""
        self._data += data

    def clear(self) -> None:
        """Forget what waits."""
        self._data.clear()
        self._end = None

    def next_frame(self) -> str | bytes | None:
        """Return the next frame, a BSON document or a JSON object; None when its end has not come yet.

        Raises FrameError for a stream that cannot be cut any further.
        """
        if self._is_bson is None:
            if len(self._data) < _LENGTH_BYTES:
                return None
            self._is_bson = _begins_with_bson(self._data)
        size_bytes = self._document_bytes() if self._is_bson else self._object_bytes()
        if size_bytes is None:
            return None
        frame = bytes(memoryview(self._data)[:size_bytes])
        del self._data[:size_bytes]
        self._end = None
        return frame if self._is_bson else _text(frame)

    def _document_bytes(self) -> int | None:
        """Return the size of the document that the data begins with; None when it is not all there."""
        if len(self._data) < _LENGTH_BYTES:
            return None
        size_bytes = int.from_bytes(self._data[:_LENGTH_BYTES], "little", signed=True)
        if not _MIN_DOCUMENT_BYTES <= size_bytes <= self.max_frame_bytes:
            raise FrameError(
                f"a BSON document of {size_bytes} bytes, the limits are {_MIN_DOCUMENT_BYTES} and"
                f" {self.max_frame_bytes}"
            )
        if len(self._data) < size_bytes:
            return None
        if self._data[size_bytes - 1]:
            raise FrameError(f"a BSON document of {size_bytes} bytes that does not end with zero")
        return size_bytes

    def _object_bytes(self) -> int | None:
        """Return the size of the object that the data begins with; None when its end has not come yet."""
        if self._end is None:
            del self._data[: _filler_bytes(self._data)]
            if not self._data:
                return None
            if not self._data.startswith(b"{"):
                raise FrameError(f"between JSON objects: wanted the next one, got {_shown(self._data)}")
            self._end = ObjectEnd()
        found = self._end.find(self._data)
        size_bytes = self._end.position if found else len(self._data)
        if size_bytes > self.max_frame_bytes:
            raise FrameError(
                f"a JSON object of {'' if found else 'more than '}{size_bytes} bytes, the limit is"
                f" {self.max_frame_bytes}"
            )
        return size_bytes if found else None


def _begins_with_bson(data: bytearray) -> bool:
    """Return True for a stream of BSON, False for one of JSON."""
    if data[_LENGTH_BYTES - 1] <= _MAX_HIGH_BYTE:
        return True
    begin = _filler_bytes(data)
    if begin == len(data) or data.startswith(b"{", begin):
        return False
    length = int.from_bytes(data[:_LENGTH_BYTES], "little", signed=True)
    raise FrameError(
        f"a stream that begins with {_shown(data)}: wanted a JSON object, or a BSON document, whose length this would"
        f" be ({length} bytes); WebSocket and HTTP have a port of their own"
    )


def _text(frame: bytes) -> str | bytes:
    try:
        return frame.decode()
    except UnicodeDecodeError:
        return frame


def _filler_bytes(data: bytearray) -> int:
    match = _FILLER.match(data)
    return 0 if match is None else match.end()


def _shown(data: bytearray) -> str:
    """Return the next bytes for a refusal; few, for more of them may be a token."""
    return repr(bytes(data[:_LENGTH_BYTES]))[1:]

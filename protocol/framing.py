"""Framing: where an object ends, fragments of long frames, and frames of a stream that has none.

A fragment is a piece of a long frame, sent as an operation of its own (rosbridge protocol, section 3.1.1).

Raw TCP has no frames around its documents: a BSON document begins with its length in bytes, a little-endian int32 that
counts itself (bsonspec.org, version 1.1), and a JSON object ends with the brace that closes it. A client speaks one of
the two from its first byte to its last, as rosbridge_server's TCP handler has it (``bson_only_mode``).
"""

import re
from dataclasses import dataclass, field

from protocol.codecs import bson, json
from protocol.errors import FrameError, OperationError
from protocol.limits import Limits
from protocol.operations import Fragment

# Nothing below is tried twice: groups are atomic. The rest of a text whose quote has been passed; what has no brace
# that counts; and, so that a long list of small objects is read quickly, whole objects as well. Repeated groups are
# bounded, and matched again where they end: each time costs 100 bytes while the match lasts. They are not possessive,
# as single characters are: where such a group can end in several ways, Python 3.11.2 takes the wrong end (CPython's
# issue 106052).
_SOME = rb"{0,1000}"
_TEXT = rb'(?>(?:[^"\\]++|\\.)' + _SOME + rb")"
_NO_BRACES = rb'[^"{}]++|"' + _TEXT + rb'"'
_INSIDE_TEXT = re.compile(_TEXT, re.DOTALL)
_OUTSIDE_TEXT = re.compile(
    rb"(?>(?:" + _NO_BRACES + rb"|\{(?>(?:" + _NO_BRACES + rb")" + _SOME + rb")\})" + _SOME + rb")", re.DOTALL
)

_QUOTE, _OPEN = b'"{'


class ObjectEnd:
    """Finds the brace that ends an object; ``position`` is how far the object has been read."""

    __slots__ = ("_depth", "_in_text", "position")

    def __init__(self) -> None:
        # Inside of the object, behind its first brace.
        self.position = 1
        self._depth = 1
        self._in_text = False

    def find(self, data: bytearray) -> bool:
        """Read on to the end of the object; False when it has not come yet. The data begins with the object."""
        while self._skip(data):
            mark = data[self.position]
            self.position += 1
            if mark == _QUOTE:
                self._in_text = not self._in_text
            elif mark == _OPEN:
                self._depth += 1
            else:
                self._depth -= 1
            if self._depth == 0:
                return True
            if self._depth > json.MAX_NESTING_DEPTH:
                raise FrameError(f"nested deeper than the limit of {json.MAX_NESTING_DEPTH} levels")
        return False

    def _skip(self, data: bytearray) -> bool:
        """Go to the next mark that counts; return False until there is a complete one."""
        pattern = _INSIDE_TEXT if self._in_text else _OUTSIDE_TEXT
        while (match := pattern.match(data, self.position)) is not None and match.end() > self.position:
            self.position = match.end()
        # A text stops at a backslash only when what it escapes has not come yet.
        return self.position < len(data) and (not self._in_text or data[self.position] == _QUOTE)


def split(frame: str, size: int, fragment_id: str) -> list[bytes]:
    """Cut a frame into fragments of at most ``size`` characters; ``fragment_id`` is unique among a client's frames."""
    pieces = [frame[start : start + size] for start in range(0, len(frame), size)]
    envelope = {"op": "fragment", "id": fragment_id}
    return [
        json.encode({**envelope, "data": piece, "num": number, "total": len(pieces)})
        for number, piece in enumerate(pieces)
    ]


@dataclass(slots=True)
class _Message:
    total: int
    started_s: float
    size_bytes: int = 0
    pieces: dict[int, str] = field(default_factory=dict)


class Reassembly:
    """Puts the fragments of one client together, in any order."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        # Oldest first.
        self._messages: dict[str | int | float, _Message] = {}
        self._fragments = 0
        self._size_bytes = 0

    def add(self, fragment: Fragment, now: float) -> str | None:
        """Take one fragment; return the frame with its last missing fragment, else None.

        Raises OperationError for a contradiction or at a limit, and drops the fragments of this message.
        """
        late = now - self._limits.fragment_timeout_s
        for fragment_id in [key for key, message in self._messages.items() if message.started_s < late]:
            self._remove(fragment_id)
        message = self._messages.get(fragment.id)
        try:
            self._check(fragment, message)
        except OperationError:
            self._remove(fragment.id)
            raise
        if message is None:
            message = self._messages[fragment.id] = _Message(fragment.total, now)
        if fragment.num not in message.pieces:
            self._store(message, fragment)
        if len(message.pieces) < message.total:
            return None
        self._remove(fragment.id)
        return "".join(message.pieces[number] for number in range(message.total))

    def _check(self, fragment: Fragment, message: _Message | None) -> None:
        limits = self._limits
        if fragment.num >= fragment.total:
            raise _refusal("num", f"wanted less than total = {fragment.total}, got {fragment.num}")
        if fragment.total > limits.max_fragments:
            raise _refusal("total", f"{fragment.total}, the limit is {limits.max_fragments}")
        if message is None and len(self._messages) >= limits.max_fragmented_messages:
            raise _refusal("id", f"{len(self._messages)} messages wait for fragments, which is the limit")
        if message is not None and message.total != fragment.total:
            raise _refusal("total", f"{fragment.total}, but other fragments of this id said {message.total}")
        if message is not None and fragment.num in message.pieces:
            return
        if self._fragments >= limits.max_fragments:
            raise _refusal(None, f"{self._fragments} fragments wait for others, which is the limit")
        size_bytes = self._size_bytes + json.size_bytes_of(fragment.data)
        if size_bytes > limits.max_message_bytes:
            raise _refusal("data", f"{size_bytes} bytes of fragments wait, the limit is {limits.max_message_bytes}")

    def _store(self, message: _Message, fragment: Fragment) -> None:
        size_bytes = json.size_bytes_of(fragment.data)
        message.pieces[fragment.num] = fragment.data
        message.size_bytes += size_bytes
        self._size_bytes += size_bytes
        self._fragments += 1

    def _remove(self, fragment_id: str | int | float) -> None:
        message = self._messages.pop(fragment_id, None)
        if message is not None:
            self._size_bytes -= message.size_bytes
            self._fragments -= len(message.pieces)


def _refusal(name: str | None, problem: str) -> OperationError:
    return OperationError("fragment", name, problem)


# A stream's first bytes tell what it is; an operation takes more in either encoding.
_LENGTH_BYTES = 4

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
        self.is_bson: bool | None = None
        self._data = bytearray()
        # Of the object that the data begins with; None between objects, and for BSON.
        self._end: ObjectEnd | None = None

    def add(self, data: bytes) -> None:
        self._data += data

    def clear(self) -> None:
        self._data.clear()
        self._end = None

    def next_frame(self) -> str | bytes | None:
        """Return the next frame, a BSON document or a JSON object; None when its end has not come yet.

        Raises FrameError for a stream that cannot be cut any further.
        """
        if self.is_bson is None:
            if len(self._data) < _LENGTH_BYTES:
                return None
            self.is_bson = _begins_with_bson(self._data)
        size_bytes = self._document_bytes() if self.is_bson else self._object_bytes()
        if size_bytes is None:
            return None
        frame = bytes(memoryview(self._data)[:size_bytes])
        del self._data[:size_bytes]
        self._end = None
        return frame if self.is_bson else _text(frame)

    def _document_bytes(self) -> int | None:
        if len(self._data) < _LENGTH_BYTES:
            return None
        size_bytes = int.from_bytes(self._data[:_LENGTH_BYTES], "little", signed=True)
        if not bson.MIN_DOCUMENT_BYTES <= size_bytes <= self.max_frame_bytes:
            raise FrameError(
                f"a BSON document of {size_bytes} bytes, the limits are {bson.MIN_DOCUMENT_BYTES} and"
                f" {self.max_frame_bytes}"
            )
        if len(self._data) < size_bytes:
            return None
        if self._data[size_bytes - 1]:
            raise FrameError(f"a BSON document of {size_bytes} bytes that does not end with zero")
        return size_bytes

    def _object_bytes(self) -> int | None:
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

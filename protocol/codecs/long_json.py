"""Long JSON text, decoded in pieces.

The decoder holds the interpreter's lock until it has read its text to the end, which takes 0.1 s for 10 MB of numbers.
So a long text is cut at commas into pieces, and each piece is decoded by itself: in front of it go the brackets that
are open there, behind it the closing ones, and the decoded pieces are put together again. In between,
other threads have their turn. ``{"a":[1,2],"b":[3`` and ``4,5]}`` are decoded as ``{"a":[1,2],"b":[3]}`` and
``{KEY:[4,5]}``.
"""

import re
from collections.abc import Callable
from typing import Any

from protocol.errors import FrameError

# Two milliseconds of numbers for the decoder.
PIECE_BYTES = 131_072

# Freeing what was decoded cannot be interrupted, and takes 50 ns a list or object. A mesh of 80,000 triangles, the
# largest that a scene takes, has 280,000.
MAX_CONTAINERS = 400_000

# Stands for the key under which an object is open that was cut; no message has a field of this name.
KEY = "\x00cut"

# Nothing is tried twice: groups are atomic, and bounded for their memory, as in :mod:`protocol.framing`. Anything that
# holds no bracket of its own, and whole lists and objects without others inside.
_SOME = rb"{0,1000}"
_FLAT = rb'[^"\[\]{}]++|"(?>(?:[^"\\]++|\\.)' + _SOME + rb')"'
_FLAT_ALL = rb"(?>(?:" + _FLAT + rb")" + _SOME + rb")"
_SKIPPED = re.compile(
    rb"(?>(?:" + _FLAT + rb"|\[" + _FLAT_ALL + rb"\]|\{" + _FLAT_ALL + rb"\})" + _SOME + rb")", re.DOTALL
)
_TO_NEXT_MARK = re.compile(rb'[^"\[\]{},]*+')
_BLANKS = re.compile(rb"[ \t\r\n]*+")

_OPENING, _QUOTE, _COMMA, _BACKSLASH = b"[{", *b'",\\'
_CLOSED_BY = {b"[": b"]", b"{": b"}"}


def decode_in_pieces(
    text: bytes, decode: Callable[[bytes, int], object], max_depth: int, piece_bytes: int = PIECE_BYTES
) -> object:
    """Decode JSON in UTF-8; ``decode`` decodes a piece, given the piece's offset in the text.

    Raises FrameError: no JSON, nested deeper than ``max_depth``, or more lists and objects than `MAX_CONTAINERS`.
    """
    containers = text.count(b"[") + text.count(b"{")
    if containers > MAX_CONTAINERS:
        raise FrameError(f"{containers} lists and objects, the limit is {MAX_CONTAINERS}")
    cutter, assembly = _Cutter(text, max_depth, piece_bytes), _Assembly()
    while True:
        begin, opened = cutter.position, b"".join(cutter.open)
        end = cutter.next_cut()
        head = _head(opened)
        tail = b"".join(_CLOSED_BY[bracket] for bracket in reversed(cutter.open)) if end < len(text) else b""
        piece = decode(head + text[begin:end] + tail, begin - len(head))
        assembly.add(piece, len(opened), cutter.lowest, len(cutter.open))
        if end == len(text):
            return assembly.value


def _head(opened: bytes) -> bytes:
    """Return the text that opens these brackets, each but the first inside the one before it."""
    inner = b"".join(b'{"\\u0000cut":' if bracket == b"{"[0] else b"[" for bracket in opened[:-1])
    return inner + opened[-1:]


class _Cutter:
    """Finds the commas at which a text is cut.

    ``open`` holds the open brackets at ``position``, behind the latest piece; ``lowest`` the fewest in that piece.
    """

    def __init__(self, text: bytes, max_depth: int, piece_bytes: int) -> None:
        self.position = 0
        self.open: list[bytes] = []
        self.lowest = 0
        self._text = text
        self._max_depth = max_depth
        self._piece_bytes = piece_bytes

    def next_cut(self) -> int:
        """Read a piece; return its end, where a comma or the end of the text is."""
        text, place = self._text, self.position
        self.lowest = len(self.open)
        enough = place + self._piece_bytes
        while place < len(text):
            if place < enough:
                place = _end(_SKIPPED, text, place, min(enough, len(text)))
            if place >= enough:
                # Also through blanks and numbers of megabytes a piece at a time.
                window = min(place + self._piece_bytes, len(text))
                place = _end(_TO_NEXT_MARK, text, place, window)
                if place == window:
                    continue
            if place == len(text):
                break
            mark = text[place]
            if mark == _COMMA and place >= enough:
                # Only a value may follow; a decoder of the next piece would take a bracket for the end of its list.
                self.position = _end(_BLANKS, text, place + 1, min(place + 1 + self._piece_bytes, len(text)))
                if self.open and text[self.position : self.position + 1] not in (b"", b"]", b"}"):
                    return place
            place = self._pass(place)
            if not self.open:
                # The value has ended, or there is none; whatever follows is one piece with it.
                break
        self.position = len(text)
        self.open.clear()
        return len(text)

    def _pass(self, place: int) -> int:
        """Go past a mark, or past the whole text that it begins."""
        mark = self._text[place : place + 1]
        if mark in _OPENING:
            if len(self.open) >= self._max_depth:
                raise FrameError(f"nested deeper than the limit of {self._max_depth} levels")
            self.open.append(mark)
        elif mark[0] == _QUOTE:
            return _string_end(self._text, place)
        elif mark[0] != _COMMA and self.open:
            self.open.pop()
            self.lowest = min(self.lowest, len(self.open))
        return place + 1


class _Assembly:
    def __init__(self) -> None:
        self.value: Any = None
        # Lists and objects that are open at the end of the latest piece, outermost first.
        self._open: list[Any] = []

    def add(self, piece: object, opened: int, lowest: int, still_open: int) -> None:
        if opened == 0:
            self.value = piece
            self._open = [piece] if still_open else []
        else:
            self._merge(piece, opened)
            del self._open[lowest:]
        while len(self._open) < still_open:
            self._open.append(_last(self._open[-1]))

    def _merge(self, piece: Any, opened: int) -> None:
        for level, container in enumerate(self._open[:opened]):
            inner = level + 1 < opened
            if type(container) is list and type(piece) is list:
                rest = piece[1:] if inner else piece
                following = piece[0] if inner else None
                container.extend(rest)
            elif type(container) is dict and type(piece) is dict:
                following = piece.pop(KEY, None) if inner else None
                container.update(piece)
            else:
                raise FrameError("an object with the same key twice, around another list or object")
            piece = following


def _last(container: Any) -> Any:
    return container[-1] if type(container) is list else container[next(reversed(container))]


def _string_end(text: bytes, begin: int) -> int:
    """Return the place behind the string that begins here; the end of the text when it has none."""
    end = begin
    # Searching for a quote looks at many bytes at a time, a pattern at each.
    while (end := text.find(_QUOTE, end + 1)) >= 0:
        escaping = end
        while text[escaping - 1] == _BACKSLASH:
            escaping -= 1
        if (end - escaping) % 2 == 0:
            return end + 1
    return len(text)


def _end(pattern: re.Pattern[bytes], text: bytes, begin: int, end: int) -> int:
    """Return the end of what a pattern matches, again and again where its repetitions are bounded."""
    while (match := pattern.match(text, begin, end)) is not None and match.end() > begin:
        begin = match.end()
    return begin

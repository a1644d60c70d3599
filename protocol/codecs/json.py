"""JSON text frames.

Inbound, more than JSON is understood: the tokens ``NaN`` and ``Infinity``, which Python clients send.
Outbound, NaN and infinities become ``null`` as in rosbridge, and the text is pure ASCII, because some clients
read it as ASCII.
"""

import json
import re
from typing import Any, AnyStr

import orjson

from protocol.codecs.long_json import PIECE_BYTES, decode_in_pieces
from protocol.codecs.pieces import encoded_pieces, json_notation
from protocol.errors import FrameError

# The deepest message of the interface tables nests 15 levels; a service and its envelope add three.
MAX_NESTING_DEPTH = 64

# The longest decimal numeral of a 64-bit integer, with its sign.
_MAX_INTEGER_CHARACTERS = 20

# From here on looking for a bracket again and again is quicker than counting: searches skip what does not match many
# characters at a time, counts look at each.
_LONG_FRAME = 4096

# A long frame with fewer commas, and fewer brackets of either kind, than this is a few long texts, such as a picture.
_FEW = 128
_LIGHT_CHARACTERS = 2_097_152

_NOT_ASCII = re.compile(r"[^\x00-\x7f]+")


def decode(frame: str | bytes) -> object:
    """Decode one frame of JSON text or its UTF-8.

    Raises FrameError: invalid UTF-8, no JSON, deeper than `MAX_NESTING_DEPTH`, or too many lists and objects.
    """
    if len(frame) > 2 * PIECE_BYTES and (isinstance(frame, bytes) or not is_light(frame)):
        return decode_in_pieces(_utf8(frame), _decode_piece, MAX_NESTING_DEPTH)
    try:
        # It takes bytes as they came and checks their UTF-8 on the way.
        value = _loads(frame)
    except orjson.JSONDecodeError as error:
        value = _decode_beyond_json(_text(frame), error)
    if _may_be_too_deep(frame):
        _check_depth(value)
    return value


def size_bytes_of(frame: str | bytes) -> int:
    """Return the size of a frame in UTF-8 [bytes]."""
    # Text knows whether it is ASCII without being read, and most frames are.
    if isinstance(frame, bytes) or frame.isascii():
        return len(frame)
    return len(frame.encode(errors="surrogatepass"))


def is_light(frame: str) -> bool:
    """Return True for a long frame that is decoded and encoded quickly: 1 MiB in a millisecond."""
    # Text that is not ASCII, or is escaped so, is escaped character by character on its way out.
    if len(frame) > _LIGHT_CHARACTERS or not frame.isascii():
        return False
    # One character is looked for at the speed of the memory, two take twenty times as long.
    return not ("\\" in frame and "\\u" in frame) and all(_count(frame, mark, _FEW) <= _FEW for mark in ",[{")


def encode(value: object) -> bytes:
    """Encode one frame: ASCII, no blanks, NaN and infinities as null."""
    encoded = orjson.dumps(value)
    if encoded.isascii():
        return encoded
    # Outside of its strings JSON text is ASCII, so whatever is not may be escaped where it stands.
    return _NOT_ASCII.sub(lambda run: json.dumps(run[0])[1:-1], encoded.decode()).encode("ascii")


_NOTATION = json_notation(encode)


def encode_in_pieces(value: object) -> bytes:
    """Encode one frame as :func:`encode`; other threads have their turn while a long one is encoded."""
    return b"".join(encoded_pieces(value, _NOTATION))


def _loads(text: str | bytes) -> object:
    if len(text) >= _LONG_FRAME:
        # orjson 3.13 copies the text for its error, and ends the process (SIGSEGV) where that finds no memory.
        bytes(len(text))
    return orjson.loads(text)


def _decode_piece(piece: bytes, offset: int) -> object:
    try:
        return _loads(piece)
    except orjson.JSONDecodeError as error:
        return _decode_beyond_json(_text(piece), error, offset)


def _utf8(frame: str | bytes) -> bytes:
    if isinstance(frame, bytes):
        return frame
    try:
        return frame.encode()
    except UnicodeEncodeError as error:
        raise FrameError("text with a lone surrogate", error.start) from error


def _text(frame: str | bytes) -> str:
    try:
        return _utf8(frame).decode()
    except UnicodeDecodeError as error:
        raise FrameError("invalid UTF-8", error.start) from error


def _decode_beyond_json(text: str, strict_error: orjson.JSONDecodeError, offset: int = 0) -> object:
    """Decode text that strict JSON refused, if only for its ``NaN`` and ``Infinity``."""
    # The strict error is reported in every case: the lenient one would name a place further on.
    not_json = FrameError(f"not JSON, {strict_error.msg}", strict_error.pos + offset)
    if "NaN" not in text and "Infinity" not in text:
        raise not_json
    try:
        value: object = json.loads(text, parse_int=_parse_integer)
        # Python's decoder lets escaped lone surrogates through, which no client could be sent.
        orjson.dumps(value)
    except (ValueError, RecursionError, TypeError) as error:
        raise not_json from error
    return value


def _parse_integer(numeral: str) -> int | float:
    # The interpreter refuses to make an int of thousands of digits, and below that takes quadratic time.
    if len(numeral) > _MAX_INTEGER_CHARACTERS:
        return float(numeral)
    number = int(numeral)
    return number if -(2**63) <= number < 2**64 else float(number)


def _may_be_too_deep(frame: str | bytes) -> bool:
    """Count opening brackets: few of them cannot nest deep, and most frames have few."""
    if isinstance(frame, bytes):
        brackets = _count(frame, b"[", MAX_NESTING_DEPTH) + _count(frame, b"{", MAX_NESTING_DEPTH)
    else:
        brackets = _count(frame, "[", MAX_NESTING_DEPTH) + _count(frame, "{", MAX_NESTING_DEPTH)
    return brackets > MAX_NESTING_DEPTH


def _count(frame: AnyStr, mark: AnyStr, limit: int) -> int:
    if len(frame) < _LONG_FRAME:
        return frame.count(mark)
    place = -1
    for number in range(limit + 1):
        place = frame.find(mark, place + 1)
        if place < 0:
            return number
    return limit + 1


def _check_depth(value: object) -> None:
    # Level by level, not by recursion, which the frame could drive as deep as it likes.
    level: list[Any] = [value] if isinstance(value, dict | list) else []
    for _ in range(MAX_NESTING_DEPTH):
        # A decoder makes nothing but these two types, and a large frame has thousands of members to look at.
        level = [
            child
            for parent in level
            for child in (parent.values() if type(parent) is dict else parent)
            if type(child) is dict or type(child) is list
        ]
        if not level:
            return
    raise FrameError(f"nested deeper than the limit of {MAX_NESTING_DEPTH} levels")

"""BSON frames (bsonspec.org, version 1.1), which Unreal's ROSIntegration speaks in both directions.

Inside of the server binary data is base64 text, as in JSON; the one exception are the ``bytes`` that
`protocol.codecs.cbor` puts into messages on their way out.
"""

import struct
from binascii import b2a_base64
from collections.abc import Mapping
from typing import Any

import bson
from bson.errors import BSONError, InvalidDocument
from bson.int64 import Int64

from protocol.codecs.json import MAX_NESTING_DEPTH
from protocol.errors import FrameError

# An empty document: its length and the closing zero.
MIN_DOCUMENT_BYTES = 5

_HIGHEST_INT64 = 2**63 - 1

# The element type of a document inside a document, then the key.
_MSG_KEY = b"\x03msg\x00"

# Types that are the same inside of the server; compared exactly, for the library derives its own from some of them.
_PLAIN = (str, int, float, bool, type(None))


def is_document(frame: bytes) -> bool:
    """Return True for a binary frame that is one BSON document: it begins with its own length and ends with zero."""
    return len(frame) >= MIN_DOCUMENT_BYTES and int.from_bytes(frame[:4], "little") == len(frame) and frame[-1] == 0


def decode(frame: bytes) -> dict[str, Any]:
    """Decode one frame into the values that JSON would have given, binary data as base64 text, or raise FrameError."""
    try:
        document = bson.decode(frame)
    except (BSONError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise FrameError(f"not BSON, {type(error).__name__}") from error
    value: dict[str, Any] = _plain(document, 1)
    return value


def encode(value: Mapping[str, Any]) -> bytes:
    """Encode one frame.

    Unsigned numbers beyond BSON's integers go out as the nearest float, keys without the zeros that end them in BSON.
    """
    try:
        return bson.encode(value)
    except (OverflowError, InvalidDocument):
        return bson.encode(_encodable(value))


def publish(topic: str, encoded_msg: bytes) -> bytes:
    # Without its length and its closing zero, a document is the list of its elements.
    head = bson.encode({"op": "publish", "topic": topic})[4:-1]
    body = b"".join((head, _MSG_KEY, encoded_msg, b"\x00"))
    return struct.pack("<i", len(body) + 4) + body


def _plain(value: Any, depth: int) -> Any:
    if type(value) in _PLAIN:
        return value
    if depth > MAX_NESTING_DEPTH:
        raise FrameError(f"nested deeper than the limit of {MAX_NESTING_DEPTH} levels")
    if type(value) is dict:
        return {key: _plain(child, depth + 1) for key, child in value.items()}
    if type(value) is list:
        return [_plain(child, depth + 1) for child in value]
    if isinstance(value, Int64):
        return int(value)
    if isinstance(value, bytes):
        return b2a_base64(value, newline=False).decode()
    raise FrameError(f"a BSON value of type {type(value).__name__}, which messages do not have")


def _encodable(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key.replace("\x00", ""): _encodable(child) for key, child in value.items()}
    if isinstance(value, list):
        return [_encodable(child) for child in value]
    return float(value) if type(value) is int and value > _HIGHEST_INT64 else value

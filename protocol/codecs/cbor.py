"""CBOR frames (RFC 8949) of rosbridge's ``cbor`` and ``cbor-raw`` compression, and the arrays of binary encodings.

The frames only go out. In binary encodings an array of octets is bytes instead of base64 text, and an array of numbers
is packed instead of a list. A type is compiled once into a packing; types without such arrays need none.
"""

from __future__ import annotations

import array
import functools
from binascii import a2b_base64
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import cbor2

from protocol.codecs.pieces import Notation, encoded_pieces
from protocol.registry import MAX_COMPILED_TYPES, OCTETS, Field, Registry

# Packs one value; None where it stays unchanged.
Pack: TypeAlias = Callable[[Any], Any] | None

# Tags of little-endian typed arrays (RFC 8746 section 2.1, as rosbridge's cbor_conversion.py uses them) and the
# element types of `array` with the same size. rosbridge sends byte as a signed number.
_TYPED_ARRAYS = {
    "uint16": (69, "H"),
    "uint32": (70, "I"),
    "uint64": (71, "Q"),
    "byte": (72, "B"),
    "int8": (72, "b"),
    "int16": (77, "h"),
    "int32": (78, "i"),
    "int64": (79, "q"),
    "float32": (85, "f"),
    "float64": (86, "d"),
}


def packed(registry: Registry, type_name: str, msg: Mapping[str, Any], *, numbers: bool) -> Mapping[str, Any]:
    """Return a complete message with ``bytes`` for each uint8[] and char[], and typed arrays for other numbers."""
    pack = _packing(registry, type_name, numbers)
    return msg if pack is None else pack(msg)


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def _packing(registry: Registry, type_name: str, numbers: bool) -> Pack:
    fields = registry.message(type_name).fields
    packs = [(field.name, _field_packing(registry, field, numbers)) for field in fields]
    if not any(pack for _, pack in packs):
        return None

    def pack_message(msg: Mapping[str, Any]) -> dict[str, Any]:
        return {name: msg[name] if pack is None else pack(msg[name]) for name, pack in packs}

    return pack_message


def _field_packing(registry: Registry, field: Field, numbers: bool) -> Pack:
    if not field.primitive:
        pack = _packing(registry, field.base, numbers)
        return pack if pack is None or field.array is None else lambda messages: list(map(pack, messages))
    if field.array is None:
        return None
    if field.base in OCTETS:
        return a2b_base64
    return _number_packing(field.base) if numbers and field.base in _TYPED_ARRAYS else None


def _number_packing(base: str) -> Callable[[list[Any]], cbor2.CBORTag]:
    tag, code = _TYPED_ARRAYS[base]

    def pack_numbers(numbers: list[Any]) -> cbor2.CBORTag:
        return cbor2.CBORTag(tag, array.array(code, numbers).tobytes())

    return pack_numbers


# RFC 8949, 3.1.
_ARRAY, _MAP = 4, 5

# A map of three pairs: op, topic and msg; the first never changes.
_PUBLISH_HEAD = b"\xa3" + cbor2.dumps("op") + cbor2.dumps("publish") + cbor2.dumps("topic")
_MSG_KEY = cbor2.dumps("msg")


def encode(msg: Mapping[str, Any]) -> bytes:
    return b"".join(encoded_pieces(msg, _NOTATION))


def _length(major_type: int, length: int) -> bytes:
    """Return the head of a map or an array; an encoded integer differs from it in the major type alone."""
    head = cbor2.dumps(length)
    return bytes((head[0] | major_type << 5,)) + head[1:]


# In front of a map or an array stands its length (RFC 8949, 3.1); nothing stands between its members.
_NOTATION = Notation(cbor2.dumps, functools.partial(_length, _MAP), functools.partial(_length, _ARRAY))


def publish(topic: str, encoded_msg: bytes) -> bytes:
    return b"".join((_PUBLISH_HEAD, cbor2.dumps(topic), _MSG_KEY, encoded_msg))

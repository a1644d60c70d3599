"""CDR, the binary form that ROS 2 middleware gives a message: plain XCDR version 1, little-endian.

A primitive is aligned to its own size, counted from behind the four bytes that name the representation (OMG
DDS-XTypes 1.3, section 7.4.3; DDSI-RTPS 2.5, section 10). Text ends with a zero, which counts in its length. What is
empty is one octet, for the C structures behind ROS 2 messages need a member (rosidl,
structure_needs_at_least_one_member).

A type is compiled once into a tree of coders.
"""

from __future__ import annotations

import array
import functools
import struct
import sys
from binascii import a2b_base64
from collections.abc import Mapping
from typing import Any, Protocol

from protocol.codecs.arrays import OCTETS
from protocol.registry import Field, Registry

# Representation CDR_LE, no options.
HEADER = b"\x00\x01\x00\x00"

# As many as there are compiled types in protocol.messages.
MAX_COMPILED_TYPES = 1024

# Element types of `array` and `struct`: the same letters, and without alignment of the library's own the same sizes.
CODES = {
    "bool": "B",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}

_LENGTH = struct.Struct("<I")


def serialize(registry: Registry, type_name: str, msg: Mapping[str, Any]) -> bytes:
    """Return a complete message as CDR, with its header.

    Args:
        registry: where the type is looked up.
        type_name: name of the message's type.
        msg: a message as `protocol.messages.complete` returns it.
    """
    body = bytearray()
    _message_coder(registry, type_name).write(body, msg)
    return HEADER + body


class _Coder(Protocol):
    """Writes a value behind a body."""

    def write(self, body: bytearray, value: Any) -> None:
        """Append a value."""


class _PrimitiveCoder:
    """A number or truth value."""

    def __init__(self, base: str) -> None:
        self._struct = struct.Struct("<?" if base == "bool" else f"<{CODES[base]}")

    def write(self, body: bytearray, value: Any) -> None:
        """Append the value, aligned to its own size."""
        _align(body, self._struct.size)
        body += self._struct.pack(value)


class _StringCoder:
    """Text."""

    def write(self, body: bytearray, value: str) -> None:
        """Append length and text, with its zero."""
        octets = value.encode()
        _write_length(body, len(octets) + 1)
        body += octets
        body.append(0)


class _NumbersCoder:
    """An array of numbers or truth values, behind its length if that is not fixed."""

    def __init__(self, field: Field, fixed_length: int | None) -> None:
        self._code = CODES[field.base]
        self._size = array.array(self._code).itemsize
        self._fixed_length = fixed_length

    def write(self, body: bytearray, value: list[Any]) -> None:
        """Append the elements; where there are none, nothing is aligned either."""
        if self._fixed_length is None:
            _write_length(body, len(value))
        if value:
            _align(body, self._size)
            body += _swapped(array.array(self._code, value)).tobytes()


class _OctetsCoder:
    """An array of octets that a complete message holds as base64 text."""

    def __init__(self, fixed_length: int | None) -> None:
        self._fixed_length = fixed_length

    def write(self, body: bytearray, value: str) -> None:
        """Append the octets."""
        octets = a2b_base64(value)
        if self._fixed_length is None:
            _write_length(body, len(octets))
        body += octets


class _ListCoder:
    """An array of texts or messages, behind its length if that is not fixed."""

    def __init__(self, element: _Coder, fixed_length: int | None) -> None:
        self._element = element
        self._fixed_length = fixed_length

    def write(self, body: bytearray, value: list[Any]) -> None:
        """Append the elements."""
        if self._fixed_length is None:
            _write_length(body, len(value))
        for element in value:
            self._element.write(body, element)


class _MessageCoder:
    """The fields of a message, one behind the other."""

    def __init__(self, coders: Mapping[str, _Coder]) -> None:
        self._coders = list(coders.items())

    def write(self, body: bytearray, value: Mapping[str, Any]) -> None:
        """Append the fields."""
        for name, coder in self._coders:
            coder.write(body, value[name])
        if not self._coders:
            body.append(0)


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def _message_coder(registry: Registry, type_name: str) -> _MessageCoder:
    fields = registry.message(type_name).fields
    return _MessageCoder({field.name: _field_coder(registry, field) for field in fields})


def _field_coder(registry: Registry, field: Field) -> _Coder:
    if field.array is None:
        return _element_coder(registry, field)
    fixed_length = field.array.min_length if field.array.fixed else None
    if field.base in OCTETS:
        return _OctetsCoder(fixed_length)
    if field.base in CODES:
        return _NumbersCoder(field, fixed_length)
    return _ListCoder(_element_coder(registry, field), fixed_length)


def _element_coder(registry: Registry, field: Field) -> _Coder:
    if not field.primitive:
        return _message_coder(registry, field.base)
    return _StringCoder() if field.base == "string" else _PrimitiveCoder(field.base)


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)


def _write_length(body: bytearray, length: int) -> None:
    _align(body, _LENGTH.size)
    body += _LENGTH.pack(length)


def _swapped(numbers: array.array[Any]) -> array.array[Any]:
    """Change between the machine's order of bytes and little-endian."""
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers

"""CDR, the binary form that ROS 2 middleware gives a message: plain XCDR version 1, little-endian.

A primitive is aligned to its own size, counted from behind the four bytes that name the representation (OMG
DDS-XTypes 1.3, section 7.4.3; DDSI-RTPS 2.5, section 10). Text ends with a zero, which counts in its length. An empty
structure is one octet, for the C structures behind ROS 2 messages need a member (rosidl,
structure_needs_at_least_one_member).

A type is compiled once into a tree of functions that write it, and a tree that reads it. Input may come from another
machine or from a damaged file: every length is checked against the octets that are there before anything is allocated
for it.
"""

from __future__ import annotations

import array
import functools
import struct
from binascii import a2b_base64, b2a_base64
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from protocol import values
from protocol.errors import MessageError
from protocol.registry import MAX_COMPILED_TYPES, OCTETS, TEXTS, Field, Registry

# Representation CDR_LE, no options.
HEADER = b"\x00\x01\x00\x00"

# Element types of `array` and `struct`: the same letters, and without alignment of the library's own the same sizes.
# The machines that the program runs on are little-endian, as the representation is.
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

# Of UTF-16.
_CODE_UNIT_BYTES = 2

# Appends a value to the octets of a message.
Write: TypeAlias = Callable[[bytearray, Any], None]


def serialize(registry: Registry, type_name: str, msg: Mapping[str, Any]) -> bytes:
    """Return a complete message (:func:`protocol.messages.complete`) as CDR, with its header."""
    body = bytearray()
    _message_writer(registry, type_name)(body, msg)
    return HEADER + body


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def _message_writer(registry: Registry, type_name: str) -> Write:
    writers = [
        (field.name, field_writer(field, _element_writer(registry, field), aligned=True))
        for field in registry.message(type_name).fields
    ]

    def write(body: bytearray, message: Mapping[str, Any]) -> None:
        for name, write_field in writers:
            write_field(body, message[name])
        if not writers:
            body.append(0)

    return write


def _element_writer(registry: Registry, field: Field) -> Write:
    if not field.primitive:
        return _message_writer(registry, field.base)
    if field.base in TEXTS:
        return _write_text if field.base == "string" else _write_wide_text
    return primitive_writer(field.base, aligned=True)


def _write_text(body: bytearray, value: str) -> None:
    octets = value.encode()
    _align(body, _LENGTH.size)
    body += _LENGTH.pack(len(octets) + 1)
    body += octets
    body.append(0)


def _write_wide_text(body: bytearray, value: str) -> None:
    """Write text in UTF-16 behind its number of code units, without a zero (Fast CDR 2, in ROS 2 since Jazzy)."""
    octets = value.encode("utf-16-le")
    _align(body, _LENGTH.size)
    body += _LENGTH.pack(len(octets) // _CODE_UNIT_BYTES)
    body += octets


def primitive_writer(base: str, *, aligned: bool) -> Write:
    packing = struct.Struct("<?" if base == "bool" else f"<{CODES[base]}")

    def write(body: bytearray, value: Any) -> None:
        if aligned:
            _align(body, packing.size)
        body += packing.pack(value)

    return write


def field_writer(field: Field, write_element: Write, *, aligned: bool) -> Write:
    """Return the writer of a field; ``write_element`` writes one value, arrays of numbers and octets go as a whole."""
    if field.array is None:
        return write_element
    counted, octets = not field.array.fixed, field.base in OCTETS
    code = CODES.get(field.base, "")
    size = array.array(code).itemsize if aligned and code and not octets else 1

    def write(body: bytearray, value: Any) -> None:
        # A complete message holds octets as base64 text.
        elements = a2b_base64(value) if octets else value
        if counted:
            if aligned:
                _align(body, _LENGTH.size)
            body += _LENGTH.pack(len(elements))
        if octets:
            body += elements
        elif code:
            # Where there are no elements, nothing is aligned either.
            if elements:
                _align(body, size)
            body += array.array(code, elements).tobytes()
        else:
            for element in elements:
                write_element(body, element)

    return write


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)


# Some middleware fills a message up to a multiple of four octets.
MAX_PADDING_BYTES = 3


class _Body:
    """The octets behind the header, and how far they have been read."""

    __slots__ = ("octets", "position")

    def __init__(self, octets: bytes) -> None:
        self.octets = octets
        self.position = 0

    def take(self, size: int, alignment: int = 1) -> int:
        """Pass over ``size`` octets that begin at a multiple of ``alignment``; returns where they begin."""
        start = self.position + -self.position % alignment
        if start + size > len(self.octets):
            raise MessageError(f"{size} bytes of CDR at byte {start}", f"{max(0, len(self.octets) - start)}")
        self.position = start + size
        return start

    def length(self) -> int:
        length: int = _LENGTH.unpack_from(self.octets, self.take(_LENGTH.size, _LENGTH.size))[0]
        # Nothing has elements of less than an octet, so this bounds what a wrong length can cost.
        if length > len(self.octets) - self.position:
            raise MessageError(f"at most {len(self.octets) - self.position} elements", f"{length}")
        return length


_Read: TypeAlias = Callable[[_Body], Any]


def deserialize(registry: Registry, type_name: str, octets: bytes) -> dict[str, Any]:
    """Return the complete message that CDR with its header holds.

    Raises InterfaceError for an unknown type, MessageError for octets that are no message of this type.
    """
    if octets[: len(HEADER)] != HEADER:
        raise MessageError(f"CDR with the header {HEADER.hex()}", octets[: len(HEADER)].hex() or "nothing")
    body = _Body(octets[len(HEADER) :])
    message: dict[str, Any] = _message_reader(registry, type_name)(body)
    left = len(body.octets) - body.position
    if left > MAX_PADDING_BYTES:
        raise MessageError(f"{body.position} bytes of {type_name}", f"{left} more")
    return message


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def _message_reader(registry: Registry, type_name: str) -> _Read:
    readers = [(field.name, _field_reader(registry, field)) for field in registry.message(type_name).fields]

    def read(body: _Body) -> dict[str, Any]:
        if not readers:
            body.take(1)
        return {name: read_field(body) for name, read_field in readers}

    return read


def _field_reader(registry: Registry, field: Field) -> _Read:
    if field.array is None:
        return _element_reader(registry, field)
    fixed_length = field.array.min_length if field.array.fixed else None
    if field.base in OCTETS:
        return _octets_reader(fixed_length)
    if field.base in CODES:
        return _numbers_reader(field.base, fixed_length)
    return _list_reader(_element_reader(registry, field), fixed_length)


def _element_reader(registry: Registry, field: Field) -> _Read:
    if not field.primitive:
        return _message_reader(registry, field.base)
    return _text_reader(field) if field.base in TEXTS else _primitive_reader(field.base)


def _primitive_reader(base: str) -> _Read:
    number = struct.Struct("<?" if base == "bool" else f"<{CODES[base]}")
    return lambda body: number.unpack_from(body.octets, body.take(number.size, number.size))[0]


def _text_reader(field: Field) -> _Read:
    convert = values.converter(field.base, field.max_length)
    read_text = _read_text if field.base == "string" else _read_wide_text
    return read_text if field.max_length is None else lambda body: convert(read_text(body))


def _read_text(body: _Body) -> str:
    length = body.length()
    start = body.take(length)
    try:
        return body.octets[start : start + length].removesuffix(b"\0").decode()
    except UnicodeDecodeError:
        raise MessageError("text in UTF-8", f"other octets at byte {start}") from None


def _read_wide_text(body: _Body) -> str:
    size = body.length() * _CODE_UNIT_BYTES
    start = body.take(size)
    try:
        return body.octets[start : start + size].decode("utf-16-le")
    except UnicodeDecodeError:
        raise MessageError("text in UTF-16", f"other octets at byte {start}") from None


def _numbers_reader(base: str, fixed_length: int | None) -> _Read:
    code = CODES[base]
    size = array.array(code).itemsize

    def read(body: _Body) -> list[Any]:
        length = body.length() if fixed_length is None else fixed_length
        if not length:
            return []
        start = body.take(length * size, size)
        numbers = array.array(code, body.octets[start : body.position])
        return list(map(bool, numbers)) if base == "bool" else numbers.tolist()

    return read


def _octets_reader(fixed_length: int | None) -> _Read:
    def read(body: _Body) -> str:
        length = body.length() if fixed_length is None else fixed_length
        start = body.take(length)
        return b2a_base64(body.octets[start : start + length], newline=False).decode()

    return read


def _list_reader(read_element: _Read, fixed_length: int | None) -> _Read:
    def read(body: _Body) -> list[Any]:
        length = body.length() if fixed_length is None else fixed_length
        return [read_element(body) for _ in range(length)]

    return read

"""Reads CDR, as :mod:`protocol.codecs.cdr` writes it, into complete messages.

What is read may come from another machine or a damaged file: every length is held against the octets that are there
before anything is made of it. A type is compiled once into a tree of readers.
"""

from __future__ import annotations

import array
import functools
import struct
import sys
from binascii import b2a_base64
from collections.abc import Callable
from typing import Any, TypeAlias

from protocol.codecs.arrays import OCTETS
from protocol.codecs.cdr import CODES, HEADER, MAX_COMPILED_TYPES
from protocol.errors import MessageError
from protocol.registry import Field, Registry

_LENGTH = struct.Struct("<I")

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
        """Read the length in front of a text or an array."""
        length: int = _LENGTH.unpack_from(self.octets, self.take(_LENGTH.size, _LENGTH.size))[0]
        # Nothing has elements of less than an octet, so this bounds what a wrong length can cost.
        if length > len(self.octets) - self.position:
            raise MessageError(f"at most {len(self.octets) - self.position} elements", f"{length}")
        return length


_Read: TypeAlias = Callable[[_Body], Any]


def deserialize(registry: Registry, type_name: str, octets: bytes) -> dict[str, Any]:
    """Return the complete message that CDR holds, spelled as `protocol.messages.complete` does.

    Args:
        registry: where the type is looked up.
        type_name: name of the message's type.
        octets: CDR, little-endian, with its header.

    Raises:
        InterfaceError: the type is unknown.
        MessageError: the octets are no message of this type.
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
    return _read_text if field.base == "string" else _primitive_reader(field.base)


def _primitive_reader(base: str) -> _Read:
    number = struct.Struct("<?" if base == "bool" else f"<{CODES[base]}")
    return lambda body: number.unpack_from(body.octets, body.take(number.size, number.size))[0]


def _read_text(body: _Body) -> str:
    length = body.length()
    start = body.take(length)
    try:
        return body.octets[start : start + length].removesuffix(b"\0").decode()
    except UnicodeDecodeError:
        raise MessageError("text in UTF-8", f"other octets at byte {start}") from None


def _numbers_reader(base: str, fixed_length: int | None) -> _Read:
    code = CODES[base]
    size = array.array(code).itemsize

    def read(body: _Body) -> list[Any]:
        length = body.length() if fixed_length is None else fixed_length
        if not length:
            return []
        start = body.take(length * size, size)
        numbers = array.array(code, body.octets[start : body.position])
        if sys.byteorder == "big":
            numbers.byteswap()
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

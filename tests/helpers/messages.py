"""Complete messages of any type, made up from a seed: large types would be too much for hypothesis to draw."""

from __future__ import annotations

import base64
import random
import struct
from typing import Any

from protocol.registry import Field, Registry
from protocol.values import INTEGER_RANGES

# Of each width in UTF-8; zero, which ends text in C, among them.
CHARACTERS = "a\x00 ü€😀"


def made_up(registry: Registry, type_name: str, seed: int) -> dict[str, Any]:
    """A message as `protocol.messages.complete` returns it, without NaN, which equals nothing."""
    return _message(registry, type_name, random.Random(seed))


def _message(registry: Registry, type_name: str, source: random.Random) -> dict[str, Any]:
    return {field.name: _field(registry, field, source) for field in registry.message(type_name).fields}


def _field(registry: Registry, field: Field, source: random.Random) -> Any:
    if field.array is None:
        return _element(registry, field, source)
    greatest = field.array.max_length
    length = source.randint(field.array.min_length, 2 if greatest is None else greatest)
    if field.base in ("uint8", "char"):
        return base64.b64encode(source.randbytes(length)).decode()
    return [_element(registry, field, source) for _ in range(length)]


def _element(registry: Registry, field: Field, source: random.Random) -> Any:
    if not field.primitive:
        return _message(registry, field.base, source)
    if field.base in INTEGER_RANGES:
        lowest, highest = INTEGER_RANGES[field.base]
        return source.choice((lowest, highest, source.randint(lowest, highest)))
    if field.base == "bool":
        return source.random() < 0.5
    if field.base == "string":
        return "".join(source.choices(CHARACTERS, k=source.randint(0, 6)))
    number = source.choice((0.0, -1e30, source.gauss(0, 1)))
    return struct.unpack("<f", struct.pack("<f", number))[0] if field.base == "float32" else number

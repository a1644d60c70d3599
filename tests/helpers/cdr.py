"""Reads CDR back; the server only writes it."""

from __future__ import annotations

import struct
from base64 import b64encode
from typing import Any

from protocol.registry import Field, Registry

HEADER_BYTES = 4

CODES = {
    **{f"{sign}int{bits}": code for bits, code in ((8, "b"), (16, "h"), (32, "i"), (64, "q")) for sign in ("", "u")},
    "float32": "f",
    "float64": "d",
    "bool": "?",
    "byte": "B",
    "char": "B",
}


def deserialize(registry: Registry, type_name: str, data: bytes) -> dict[str, Any]:
    """The complete message that CDR, with its header, holds and nothing else."""
    reader = _Reader(registry, data[HEADER_BYTES:])
    message = reader.message(type_name)
    assert reader.position == len(reader.body)
    return message


class _Reader:
    """Takes values off the front of a body."""

    def __init__(self, registry: Registry, body: bytes) -> None:
        self.registry = registry
        self.body = body
        self.position = 0

    def message(self, type_name: str) -> dict[str, Any]:
        fields = self.registry.message(type_name).fields
        if not fields:
            self.take(1)
        return {field.name: self.field(field) for field in fields}

    def field(self, field: Field) -> Any:
        if field.array is None:
            return self.element(field.base)
        length = field.array.min_length if field.array.fixed else self.element("uint32")
        if field.base in ("uint8", "char"):
            return b64encode(self.take(length)).decode()
        return [self.element(field.base) for _ in range(length)]

    def element(self, base: str) -> Any:
        if base == "string":
            octets = self.take(self.element("uint32"))
            assert octets.endswith(b"\x00")
            return octets[:-1].decode()
        if base not in CODES:
            return self.message(base)
        code = CODES[base].upper() if base.startswith("uint") else CODES[base]
        size = struct.calcsize(code)
        self.take(-self.position % size)
        return struct.unpack(f"<{code}", self.take(size))[0]

    def take(self, size: int) -> bytes:
        start, self.position = self.position, self.position + size
        assert self.position <= len(self.body)
        return self.body[start : self.position]

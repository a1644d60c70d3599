"""The interface tables: looks a ROS 2 type up by name and tells its fields, bounds and defaults."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

from protocol.errors import InterfaceError

_INTEGERS = ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
PRIMITIVES = frozenset((*_INTEGERS, "bool", "byte", "char", "float32", "float64", "string"))

# `float64`, `geometry_msgs/Point`, `float64[]`, `float64[9]`, `float64[<=3]`
_TYPE_PATTERN = re.compile(r"(?P<base>[\w/]+)(?P<array>\[(?P<bounded><=)?(?P<size>\d+)?\])?")


@dataclass(frozen=True, slots=True)
class ArrayBounds:
    """How many elements an array field holds.

    Attributes:
        min_length: least number of elements.
        max_length: greatest number of elements, None for no bound.
    """

    min_length: int
    max_length: int | None

    @property
    def fixed(self) -> bool:
        """Whether the array has exactly one possible length."""
        return self.min_length == self.max_length


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message.

    Attributes:
        name: the field's name.
        base: a name of `PRIMITIVES`, or the canonical name of a message type.
        array: bounds of an array field, None for a single value.
        default: default of the interface definition, None where it gives none (then zero, false or empty).
    """

    name: str
    base: str
    array: ArrayBounds | None
    default: bool | int | float | str | None

    @property
    def primitive(self) -> bool:
        """Whether the base is a primitive type, not a message."""
        return self.base in PRIMITIVES


@dataclass(frozen=True, slots=True)
class MessageType:
    """A message type: its canonical name and its fields in order of declaration."""

    name: str
    fields: tuple[Field, ...]


class Registry:
    """All interface types the server knows.

    Args:
        table: canonical name -> the interface's definition, as in ``interfaces/ros2.json``.
    """

    def __init__(self, table: Mapping[str, Mapping[str, Any]]) -> None:
        self._table = table
        self._messages: dict[str, MessageType] = {}

    @classmethod
    def load(cls) -> Registry:
        """Read the ROS 2 tables that ship with this package."""
        # Read through importlib, for the package may be installed as a zip.
        text = resources.files("protocol").joinpath("interfaces", "ros2.json").read_text("utf-8")
        return cls(json.loads(text))

    def canonical(self, name: str) -> str:
        """Return the three-part name of a message type given in two parts or three.

        Raises:
            InterfaceError: no such type, or a service or action.
        """
        parts = name.split("/")
        # Two parts always mean a message: a name may also be an action's, as control_msgs/GripperCommand is.
        canonical = f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name
        definition = self._table.get(canonical)
        if definition is None:
            raise InterfaceError(name, "unknown (package and name must match, in upper and lower case too)")
        if definition["kind"] != "msg":
            raise InterfaceError(name, f"is of kind {definition['kind']}, wanted a message type")
        return canonical

    def message(self, name: str) -> MessageType:
        """Look a message type up, ``std_msgs/String`` or ``std_msgs/msg/String``.

        Raises:
            InterfaceError: no such type, or a service or action.
        """
        canonical = self.canonical(name)
        message_type = self._messages.get(canonical)
        # Parsed when first asked for: a server uses a few dozen of the types, and start-up does not pay for the rest.
        if message_type is None:
            fields = tuple(self._field(row) for row in self._table[canonical]["fields"])
            message_type = self._messages[canonical] = MessageType(canonical, fields)
        return message_type

    def _field(self, row: list[str]) -> Field:
        name, declared, *defaults = row
        match = _TYPE_PATTERN.fullmatch(declared)
        if match is None:
            raise InterfaceError(declared, f"of field {name} cannot be read")
        base = match["base"] if match["base"] in PRIMITIVES else self.canonical(match["base"])
        return Field(name, base, _array_bounds(match), _default(base, defaults[0]) if defaults else None)


def _array_bounds(match: re.Match[str]) -> ArrayBounds | None:
    if match["array"] is None:
        return None
    size = int(match["size"]) if match["size"] else None
    return ArrayBounds(0 if match["bounded"] or size is None else size, size)


def _default(base: str, text: str) -> bool | int | float | str:
    if base == "bool":
        return text == "true"
    if base.startswith("float"):
        return float(text)
    return text if base == "string" else int(text)

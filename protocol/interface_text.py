"""What rosapi tells about a message type: its full text, as `gendeps --cat` prints it, and its TypeDefs.

Both are told of the generation whose registry is given: of ROS 2, or by `Registry.ros1` of ROS 1.
"""

from __future__ import annotations

import json
from typing import Any

from protocol import values
from protocol.registry import ArrayBounds, Constant, Field, MessageType, Registry
from protocol.tables import ROS1_TIMES

# What readers split the text at (genmsg's gendeps).
_SEPARATOR = "=" * 80


def full_text(registry: Registry, type_name: str) -> str:
    """Return a message type's text followed by the texts of all message types in it.

    Args:
        registry: of the generation that is asked about.
        type_name: name of a message type.

    Raises:
        InterfaceError: no such type.
    """
    main, *dependencies = _with_dependencies(registry, type_name)
    # ROS 1 readers know time and duration as primitives.
    sections = (each for each in dependencies if each.name not in ROS1_TIMES)
    parts = (f"{_SEPARATOR}\nMSG: {_short(each.name)}\n{_definition_text(each)}" for each in sections)
    return "\n".join((_definition_text(main), *parts))


def typedefs(registry: Registry, type_name: str) -> list[dict[str, Any]]:
    """Return the rosapi TypeDefs of a message type and of all message types in it, depth first.

    Args:
        registry: of the generation that is asked about.
        type_name: name of a message type.

    Raises:
        InterfaceError: no such type.
    """
    return [_typedef(each) for each in _with_dependencies(registry, type_name)]


def _with_dependencies(registry: Registry, type_name: str) -> list[MessageType]:
    """Return a type and all that it refers to, each once, depth first."""
    found: dict[str, MessageType] = {}
    waiting = [registry.message(type_name)]
    while waiting:
        message_type = waiting.pop()
        if message_type.name not in found:
            found[message_type.name] = message_type
            waiting += [registry.message(field.base) for field in reversed(message_type.fields) if not field.primitive]
    return list(found.values())


def _short(name: str) -> str:
    """Return the two-part name, which is what both generations write in definitions."""
    first, *others = name.split("/")
    return f"{first}/{others[-1]}" if others else first


def _definition_text(message_type: MessageType) -> str:
    lines = [*map(_constant_line, message_type.constants), *map(_field_line, message_type.fields)]
    return "".join(f"{line}\n" for line in lines)


def _constant_line(constant: Constant) -> str:
    return f"{constant.base} {constant.name}={_literal(constant.value)}"


def _field_line(field: Field) -> str:
    line = f"{_short(field.base)}{_brackets(field.array)} {field.name}"
    return line if field.default is None else f"{line} {_literal(field.default)}"


def _brackets(bounds: ArrayBounds | None) -> str:
    if bounds is None:
        return ""
    if bounds.max_length is None:
        return "[]"
    return f"[{bounds.max_length}]" if bounds.fixed else f"[<={bounds.max_length}]"


def _literal(value: bool | int | float | str) -> str:
    """Write a value as definitions do, which for these is as JSON does."""
    return json.dumps(value)


def _typedef(message_type: MessageType) -> dict[str, Any]:
    fields, constants = message_type.fields, message_type.constants
    return {
        "type": _short(message_type.name),
        "fieldnames": [field.name for field in fields],
        "fieldtypes": [_short(field.base) for field in fields],
        "fieldarraylen": [_array_length(field.array) for field in fields],
        "examples": [_example(field) for field in fields],
        "constnames": [constant.name for constant in constants],
        "constvalues": [str(constant.value) for constant in constants],
    }


def _array_length(bounds: ArrayBounds | None) -> int:
    if bounds is None:
        return -1
    return bounds.min_length if bounds.fixed else 0


def _example(field: Field) -> str:
    if field.array is not None:
        return "[]"
    if not field.primitive:
        return "{}"
    return str(values.zero(field.base) if field.default is None else field.default)

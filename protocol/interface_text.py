"""Message types as rosapi describes them: the full text, as `gendeps --cat` prints it, and its TypeDefs.

Both are told as one generation of ROS declares the type; a type that exists only in ROS 2 as if ROS 1 had it.
"""

from __future__ import annotations

import json
from typing import Any

from protocol import values
from protocol.dialect import Dialect, declared_in_ros1, spell_type
from protocol.registry import ROS1_TIMES, ArrayBounds, Constant, Field, MessageType, Registry

# What readers split the text at (genmsg's gendeps).
_SEPARATOR = "=" * 80


def full_text(registry: Registry, type_name: str, dialect: Dialect = "ros2") -> str:
    """Return a message type's text followed by the texts of all message types in it.

    Args:
        registry: the ROS 2 registry.
        type_name: name of a message type.
        dialect: the generation that is asked about.

    Raises:
        InterfaceError: no such type.
    """
    main, *dependencies = _with_dependencies(registry, type_name, dialect)
    # ROS 1 readers know time and duration as primitives.
    sections = (each for each in dependencies if each.name not in ROS1_TIMES)
    parts = (f"{_SEPARATOR}\nMSG: {_spell(each.name, dialect)}\n{_definition_text(each, dialect)}" for each in sections)
    return "\n".join((_definition_text(main, dialect), *parts))


def typedefs(registry: Registry, type_name: str, dialect: Dialect = "ros2") -> list[dict[str, Any]]:
    """Return the rosapi TypeDefs of a message type and of all message types in it, depth first.

    Args:
        registry: the ROS 2 registry.
        type_name: name of a message type.
        dialect: the generation that is asked about.

    Raises:
        InterfaceError: no such type.
    """
    return [_typedef(each, dialect) for each in _with_dependencies(registry, type_name, dialect)]


def _with_dependencies(registry: Registry, type_name: str, dialect: Dialect) -> list[MessageType]:
    """Return a type and all that it refers to, each once, depth first."""
    found: dict[str, MessageType] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop()
        message_type = declared_in_ros1(registry, name) if dialect == "ros1" else registry.message(name)
        if message_type.name not in found:
            found[message_type.name] = message_type
            waiting += [field.base for field in reversed(message_type.fields) if not field.primitive]
    return list(found.values())


def _spell(name: str, dialect: Dialect) -> str:
    """Return the two-part name, which is what both generations write in definitions."""
    if dialect == "ros1":
        return spell_type(name, dialect)
    first, *others = name.split("/")
    return f"{first}/{others[-1]}" if others else first


def _definition_text(message_type: MessageType, dialect: Dialect) -> str:
    lines = [_constant_line(constant, dialect) for constant in message_type.constants]
    lines += [_field_line(field, dialect) for field in message_type.fields]
    return "".join(f"{line}\n" for line in lines)


def _constant_line(constant: Constant, dialect: Dialect) -> str:
    # ROS 1 takes all that follows the sign as the text, quotes too.
    value = str(constant.value) if dialect == "ros1" else _literal(constant.value)
    return f"{constant.base} {constant.name}={value}"


def _field_line(field: Field, dialect: Dialect) -> str:
    if dialect == "ros1":
        # It has neither defaults nor bounds.
        brackets = _brackets(field.array) if field.array is None or field.array.fixed else "[]"
        return f"{_spell(field.base, dialect)}{brackets} {field.name}"
    line = f"{_spell(field.base, dialect)}{_brackets(field.array)} {field.name}"
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


def _typedef(message_type: MessageType, dialect: Dialect) -> dict[str, Any]:
    fields, constants = message_type.fields, message_type.constants
    return {
        "type": _spell(message_type.name, dialect),
        "fieldnames": [field.name for field in fields],
        "fieldtypes": [_spell(field.base, dialect) for field in fields],
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

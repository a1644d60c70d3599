"""Descriptions of interface types: for rosapi as text and TypeDefs, for ROS 2 as the hash of a type's version.

The text is `gendeps --cat`'s. Text and TypeDefs belong to one generation of ROS; a type that exists only in
ROS 2 is described as if ROS 1 had it.

The hash (REP-2016, "RIHS01") is the SHA-256 of a description in JSON, with the fields of the type and of all types in
it; comments, constants and defaults do not count. How it is written, to the blank, is part of the standard
(rosidl_generator_type_description).
"""

import functools
import hashlib
import json
from typing import Any, TypeAlias

from protocol import values
from protocol.dialect import Dialect, declared_in_ros1, spell_type
from protocol.registry import (
    MAX_COMPILED_TYPES,
    ROS1_TIMES,
    TEXTS,
    ArrayBounds,
    Constant,
    Field,
    MessageType,
    Registry,
    Scalar,
)

# What readers split the text at (genmsg's gendeps).
_SEPARATOR = "=" * 80


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def full_text(registry: Registry, type_name: str, dialect: Dialect = "ros2") -> str:
    """Return a message type's text followed by the texts of all message types in it."""
    main, *dependencies = _with_dependencies(registry, type_name, dialect)
    # ROS 1 readers know time and duration as primitives.
    sections = (each for each in dependencies if each.name not in ROS1_TIMES)
    parts = (
        f"{_SEPARATOR}\nMSG: {_spell(each.name, dialect)}\n{_definition_text(registry, each.name, dialect)}"
        for each in sections
    )
    return "\n".join((_definition_text(registry, main.name, dialect), *parts))


def typedefs(registry: Registry, type_name: str, dialect: Dialect = "ros2") -> list[dict[str, Any]]:
    """Return the rosapi TypeDefs of a message type and of all message types in it, depth first."""
    return [_typedef(each, dialect) for each in _with_dependencies(registry, type_name, dialect)]


def _with_dependencies(registry: Registry, type_name: str, dialect: Dialect) -> list[MessageType]:
    """Return a type and all that it refers to, each once, depth first."""
    found: dict[str, MessageType] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop()
        message_type, nested = _declared(registry, name, dialect)
        if message_type.name not in found:
            found[message_type.name] = message_type
            waiting += nested
    return list(found.values())


def _spell(name: str, dialect: Dialect) -> str:
    """Return the two-part name, which is what both generations write in definitions."""
    if dialect == "ros1":
        # It has one kind of text.
        return "string" if name in TEXTS else spell_type(name, dialect)
    first, *others = name.split("/")
    return f"{first}/{others[-1]}" if others else first


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def _declared(registry: Registry, name: str, dialect: Dialect) -> tuple[MessageType, tuple[str, ...]]:
    """Return a message type as a dialect declares it, and the types of its fields, the last first."""
    message_type = declared_in_ros1(registry, name) if dialect == "ros1" else registry.message(name)
    return message_type, tuple(field.base for field in reversed(message_type.fields) if not field.primitive)


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def _definition_text(registry: Registry, name: str, dialect: Dialect) -> str:
    message_type, _ = _declared(registry, name, dialect)
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
    bound = "" if field.max_length is None else f"<={field.max_length}"
    line = f"{_spell(field.base, dialect)}{bound}{_brackets(field.array)} {field.name}"
    return line if field.default is None else f"{line} {_literal(field.default)}"


def _brackets(bounds: ArrayBounds | None) -> str:
    if bounds is None:
        return ""
    if bounds.max_length is None:
        return "[]"
    return f"[{bounds.max_length}]" if bounds.fixed else f"[<={bounds.max_length}]"


def _literal(value: Scalar | tuple[Scalar, ...]) -> str:
    """Write a value as definitions do, which for these is as JSON does, but that they have no escapes for letters."""
    return json.dumps(value, ensure_ascii=False)


# Names of primitive types in rosapi's TypeDefs for ROS 2, which come from rosidl_parser.
_IDL_NAMES = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}


def _typedef(message_type: MessageType, dialect: Dialect) -> dict[str, Any]:
    fields, constants = message_type.fields, message_type.constants
    return {
        "type": _spell(message_type.name, dialect),
        "fieldnames": [field.name for field in fields],
        "fieldtypes": [
            _spell(field.base if dialect == "ros1" else _IDL_NAMES.get(field.base, field.base), dialect)
            for field in fields
        ],
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
        return "[]" if field.default is None else _literal(field.default)
    return str(values.default(field)) if field.primitive else "{}"


# Name and version of this way to hash.
PREFIX = "RIHS01_"

# type_description_interfaces/msg/FieldType; ROS 2 generates code for a char as for a uint8.
_IDS = {
    "int8": 2,
    "uint8": 3,
    "char": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
    "string": 17,
    "wstring": 18,
}
# Added to the id of a text where its length is bounded.
_BOUNDED_TEXT = 4
_NESTED, _ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 1, 48, 96, 144

# Part of every service since ROS 2 Iron.
_EVENT_INFO = "service_msgs/msg/ServiceEventInfo"

_Row: TypeAlias = dict[str, Any]


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def message_hash(registry: Registry, name: str) -> str:
    canonical = registry.canonical(name)
    return _hash(canonical, _with_nested(registry, canonical))


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def service_hash(registry: Registry, name: str) -> str:
    """Return the hash of a service type, which covers its request, its response and the event of both."""
    service = registry.service(name)
    request, response, event = service.request.name, service.response.name, f"{service.name}_Event"
    fields = {
        **_with_nested(registry, request),
        **_with_nested(registry, response),
        **_with_nested(registry, _EVENT_INFO),
        event: [
            _row("info", _NESTED, nested=_EVENT_INFO),
            _row("request", _BOUNDED_SEQUENCE + _NESTED, capacity=1, nested=request),
            _row("response", _BOUNDED_SEQUENCE + _NESTED, capacity=1, nested=response),
        ],
        service.name: [
            _row("request_message", _NESTED, nested=request),
            _row("response_message", _NESTED, nested=response),
            _row("event_message", _NESTED, nested=event),
        ],
    }
    return _hash(service.name, fields)


def _hash(name: str, fields: dict[str, list[_Row]]) -> str:
    described = {each: {"type_name": each, "fields": fields[each]} for each in sorted(fields)}
    description = {"type_description": described.pop(name), "referenced_type_descriptions": list(described.values())}
    return PREFIX + hashlib.sha256(json.dumps(description).encode()).hexdigest()


def _with_nested(registry: Registry, name: str) -> dict[str, list[_Row]]:
    return {
        message.name: [_field_row(field) for field in message.fields] or [_PLACEHOLDER]
        for message in _with_dependencies(registry, name, "ros2")
    }


def _field_row(field: Field) -> _Row:
    type_id, capacity = _IDS.get(field.base, _NESTED), 0
    if field.array is not None:
        bound = field.array.max_length
        type_id += _SEQUENCE if bound is None else _ARRAY if field.array.fixed else _BOUNDED_SEQUENCE
        capacity = bound or 0
    if field.max_length is not None:
        type_id += _BOUNDED_TEXT
    return _row(field.name, type_id, capacity, "" if field.primitive else field.base, field.max_length or 0)


def _row(name: str, type_id: int, capacity: int = 0, nested: str = "", max_length: int = 0) -> _Row:
    kind = {"type_id": type_id, "capacity": capacity, "string_capacity": max_length, "nested_type_name": nested}
    return {"name": name, "type": kind}


# What stands for no fields, as in protocol.codecs.cdr.
_PLACEHOLDER = _row("structure_needs_at_least_one_member", _IDS["uint8"])

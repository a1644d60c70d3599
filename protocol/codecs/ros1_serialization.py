"""ROS 1's binary form of a message, as roscpp and rospy put it on the wire and into bags.

The fields follow one another in the order of ROS 1's declaration, little-endian, without alignment and without a header
of the message as a whole. Texts, and arrays without a fixed length, come behind their length as uint32; a text has no
zero at its end, and an empty message has no octets. Times are two integers of 32 bits (roscpp_serialization,
genpy/generator.py).

A type is compiled once into a tree of functions, and each of them appends a value to the octets before it.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Mapping
from typing import Any

from protocol.codecs.cdr import Write, field_writer, primitive_writer
from protocol.dialect import declared_in_ros1, to_ros1
from protocol.registry import MAX_COMPILED_TYPES, ROS1_TIMES, TEXTS, Field, Registry

_LENGTH = struct.Struct("<I")

# ROS 2's seconds of a time are signed and its nanoseconds of a duration are not: what ROS 1 cannot hold keeps its bits.
_TIME, _WORD = struct.Struct("<II"), 0xFFFF_FFFF

# Types of both generations; a type that exists only in ROS 2 has ROS 2's.
_TIMES = (*ROS1_TIMES, "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


def serialize(registry: Registry, type_name: str, msg: Mapping[str, Any], sequence_number: int = 0) -> bytes:
    """Return a complete message in ROS 1's serialization; a type of ROS 2 alone is written as if ROS 1 had it."""
    octets = bytearray()
    _message_writer(registry, type_name)(octets, to_ros1(registry, type_name, msg, sequence_number))
    return bytes(octets)


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def _message_writer(registry: Registry, type_name: str) -> Write:
    writers = [
        (field.name, field_writer(field, _element_writer(registry, field), aligned=False))
        for field in declared_in_ros1(registry, type_name).fields
    ]

    def write(octets: bytearray, message: Mapping[str, Any]) -> None:
        for name, write_field in writers:
            write_field(octets, message[name])

    return write


def _element_writer(registry: Registry, field: Field) -> Write:
    if field.base in _TIMES:
        return _write_time
    if not field.primitive:
        return _message_writer(registry, field.base)
    return _write_text if field.base in TEXTS else primitive_writer(field.base, aligned=False)


def _write_time(octets: bytearray, value: Mapping[str, int]) -> None:
    octets += _TIME.pack(value["secs"] & _WORD, value["nsecs"] & _WORD)


def _write_text(octets: bytearray, value: str) -> None:
    text = value.encode()
    octets += _LENGTH.pack(len(text))
    octets += text

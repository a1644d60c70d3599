"""Complete messages of any type, made up from a seed, and types as rosbags declares them."""

import base64
import random
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from protocol.messages import Stamp
from protocol.registry import TEXTS, Field, MessageType, Registry
from protocol.values import INTEGER_RANGES

# Of all tests: the types that it has compiled for one of them are there for the others.
REGISTRY = Registry.load()
MESSAGE_TYPES = [name for name in REGISTRY.type_names() if REGISTRY.knows(name)]

# Of each width in UTF-8; zero, which ends text in C, among them.
CHARACTERS = "a\x00 ü€😀"


def time_message(seconds: float) -> dict[str, int]:
    """A builtin_interfaces/Time, or a Duration."""
    return Stamp.from_seconds(seconds).as_message()


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
    if field.base in TEXTS:
        longest = 6 if field.max_length is None else min(6, field.max_length)
        return "".join(source.choices(CHARACTERS, k=source.randint(0, longest)))
    number = source.choice((0.0, -1e30, source.gauss(0, 1)))
    return struct.unpack("<f", struct.pack("<f", number))[0] if field.base == "float32" else number


# rosbags' names of the types of arrays, where they are not the field's.
ARRAY_TYPES = {"bool": "bool", "byte": "uint8", "char": "uint8"}
ROS1_TIMES = {"time": "builtin_interfaces/msg/Time", "duration": "builtin_interfaces/msg/Duration"}


class RosbagsTypes:
    """Types as rosbags, an independent implementation, declares them, beside the declarations of our tables."""

    def __init__(self, store: Any, declared: Callable[[str], MessageType]) -> None:
        self._store = store
        self._declared = declared

    def has(self, name: str) -> bool:
        """Return true if rosbags declares a type, and all types in it, as the tables do."""
        if name in ROS1_TIMES:
            return True
        declared = self._declared(name)
        if declared.name not in self._store.fielddefs:
            return False
        theirs = [field for field, _ in self._store.fielddefs[declared.name][1]]
        return theirs == [field.name for field in declared.fields] and all(
            field.primitive or self.has(field.base) for field in declared.fields
        )

    def message(self, name: str, msg: dict[str, Any]) -> Any:
        """The message, with octets for base64, as an object of rosbags."""
        if name in ROS1_TIMES:
            # It has the signs of ROS 2's times, which leaves the bits as they are.
            sec, nanosec = np.array(msg["secs"]).astype(np.int32), np.array(msg["nsecs"]).astype(np.uint32)
            return self._store.types[ROS1_TIMES[name]](sec=int(sec), nanosec=int(nanosec))
        declared = self._declared(name)
        return self._store.types[declared.name](
            **{field.name: self._value(field, msg[field.name]) for field in declared.fields}
        )

    def _value(self, field: Field, value: Any) -> Any:
        if not field.primitive:
            each = [self.message(field.base, one) for one in (value if field.array is not None else [value])]
            return each if field.array is not None else each[0]
        if field.array is None:
            # A byte is a signed number there.
            return value - 256 if field.base == "byte" and value > 127 else value
        if isinstance(value, bytes):
            return np.frombuffer(value, np.uint8)
        return value if field.base == "string" else np.array(value, ARRAY_TYPES.get(field.base, field.base))

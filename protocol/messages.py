"""Messages: validates a decoded value against its type and completes it, in ROS 2 spelling.

Out of `complete` comes a dict with every field of the type in order of declaration. Arrays of uint8 and char
are base64 text, as they go over the wire; a float that was null is NaN. The input is left as it was.

A type is compiled once into a tree of shapes that knows everything that is forgiven and every error's text; completing
a message walks that tree.

An element of a list may leave all its fields out: ``{}`` stands for a whole planning request. A message of a few
megabytes could thus grow until it holds the server up for minutes, so every completion has a budget of values.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import pybase64

from protocol import values
from protocol.errors import LargeMessageError, MessageError, describe, shorten
from protocol.registry import MAX_COMPILED_TYPES, OCTETS, ArrayBounds, Field, Registry

# Values of the elements of all lists of messages in one message. The largest mesh that is taken into a scene has half
# as many; completing them takes two seconds at worst, and 150 MB.
MAX_VALUES = 1_000_000

# Of a message that a part of the server reads, which takes up to 2 us a value. A planning request with constraints has
# some hundred.
MAX_READ_VALUES = 5_000


@dataclass(frozen=True)
class ListLimits:
    """Limits of the lists in one message, in addition to the limits of every message."""

    # Number of elements in all lists of a field together, by type and field such as
    # ``moveit_msgs/msg/MotionSequenceRequest.items``.
    max_elements: Mapping[str, int] = field(default_factory=dict)
    max_values: int = MAX_READ_VALUES  # number of values in all other lists, of messages as they are when complete
    max_bytes: int | None = None  # size of a client's message, or of the frame with it [bytes]; None for no such limit


class _Lists:
    """Count of one message's lists, against limits."""

    def __init__(self, limits: ListLimits) -> None:
        self._max_elements, self._max_values = limits.max_elements, limits.max_values
        self._elements: dict[str, int] = {}
        self._values_left = limits.max_values

    def add(self, name: str, count: int, values_of_element: int) -> None:
        """Count a list of a field, given with its type; raises MessageError."""
        max_elements = self._max_elements.get(name)
        if max_elements is None:
            self._values_left -= count * values_of_element
            if self._values_left < 0:
                raise MessageError(f"at most {self._max_values} values in all lists, as they are complete", "more")
        else:
            count = self._elements[name] = self._elements.get(name, 0) + count
            if count > max_elements:
                raise MessageError(f"at most {max_elements} elements in all", str(count))


class MessageBudget(threading.local):
    """Budget of one message, in values; each thread completes its messages one after the other."""

    def __init__(self) -> None:
        self.renew("", MAX_VALUES, MAX_VALUES)

    def renew(self, type_name: str, max_values: int, max_values_at_once: int, limits: ListLimits | None = None) -> None:
        self._type_name = type_name
        self._max_values = self._left = max_values
        self._at_once_left = max_values_at_once
        self.lists = None if limits is None else _Lists(limits)

    @property
    def taken(self) -> int:
        """Values that the message has taken."""
        return self._max_values - self._left

    def take(self, count: int) -> None:
        self._left -= count
        self._at_once_left -= count
        if self._left < 0:
            wanted = f"at most {self._max_values} values in all lists of messages, as they are complete"
            raise MessageError(wanted, "more")
        if self._at_once_left < 0:
            raise LargeMessageError(self._type_name)


# One a thread: the completion of a message never waits.
BUDGET = MessageBudget()


@functools.cache
def values_in(registry: Registry, type_name: str) -> int:
    """Count the values that a message of a type has at least, nested messages included, each list as one."""
    fields = registry.message(type_name).fields
    return sum(1 if field.primitive or field.array else values_in(registry, field.base) for field in fields) or 1


HEADER = "std_msgs/msg/Header"
TIME = "builtin_interfaces/msg/Time"
DURATION = "builtin_interfaces/msg/Duration"

# Names of other releases that clients send with ROS 2 types: type -> name sent -> name meant (None: nothing any more).
_OTHER_NAMES: Mapping[str, Mapping[str, str | None]] = {
    TIME: {"secs": "sec", "nsecs": "nanosec"},
    DURATION: {"secs": "sec", "nsecs": "nanosec"},
    HEADER: {"seq": None},
    "moveit_msgs/msg/MotionPlanRequest": {
        # ROS 1 and Humble.
        "cartesian_speed_end_effector_link": "cartesian_speed_limited_link",
        # moveit_msgs 2.7.2, after Jazzy: only Pilz's POLYLINE reads it.
        "smoothness_level": None,
    },
    # ROS 1, and the types of roslib 2.
    "rosapi_msgs/srv/GetParam_Request": {"default": "default_value"},
    # ROS 1 before Noetic.
    "moveit_msgs/msg/PositionIKRequest": {"attempts": None},
}

# Range of builtin_interfaces/Time [ns since the epoch].
_EARLIEST_NS, _LATEST_NS = -(2**31) * 1_000_000_000, 2**31 * 1_000_000_000 - 1


class Stamp(NamedTuple):
    """A point in time, as in builtin_interfaces/Time: seconds of the Unix epoch and nanoseconds."""

    sec: int
    nanosec: int

    @classmethod
    def from_seconds(cls, seconds: float) -> Stamp:
        """Return the stamp of a Unix time [s], clipped to the int32 seconds of builtin_interfaces/Time."""
        nanoseconds = round(seconds * 1_000_000_000)
        # Every message has one: `min` and `max` take a third of its time.
        if not _EARLIEST_NS <= nanoseconds <= _LATEST_NS:
            nanoseconds = min(max(nanoseconds, _EARLIEST_NS), _LATEST_NS)
        return cls(*divmod(nanoseconds, 1_000_000_000))

    def as_message(self) -> dict[str, int]:
        return {"sec": self.sec, "nanosec": self.nanosec}


class _Shape(Protocol):
    """Shape of a field: the values it takes, and the default of a missing one."""

    def complete(self, value: object, received: Stamp) -> Any:
        """Validate a value and return it completed, or raise MessageError."""

    def default(self, received: Stamp) -> Any:
        """Return what stands in for a value that is missing; nothing of it is shared."""


def complete(
    registry: Registry,
    type_name: str,
    value: object,
    received: Stamp,
    max_values: int = MAX_VALUES,
    max_values_at_once: int = MAX_VALUES,
    limits: ListLimits | None = None,
) -> dict[str, Any]:
    """Validate a message and fill in what it leaves out.

    Missing fields get their defaults. A header that is omitted, or has no stamp, gets the time of receipt; a
    stamp that is given stays, even if it is zero. The text ``now`` for a Time is the time of receipt.

    Raises InterfaceError for an unknown type, MessageError for a value that does not fit, a list beyond ``limits`` or
    more than ``max_values`` in lists of messages, and LargeMessageError for more than ``max_values_at_once``.
    """
    BUDGET.renew(type_name, max_values, max_values_at_once, limits)
    return _message_shape(registry, type_name).complete(value, received)


class _PrimitiveShape:
    def __init__(self, field: Field) -> None:
        self._convert = values.converter(field.base, field.max_length)
        self._default: values.Primitive = values.default(field)

    def complete(self, value: object, _received: Stamp) -> values.Primitive:
        return self._convert(value)

    def default(self, _received: Stamp) -> values.Primitive:
        return self._default


class _PrimitiveArrayShape:
    def __init__(self, name: str, field: Field, bounds: ArrayBounds) -> None:
        self._name = name
        self._convert = values.element_converter(field.base, field.max_length)
        self._convert_list = values.list_converter(field.base, field.max_length)
        self._bounds = bounds
        self._default: list[Any] = values.default(field)

    def complete(self, value: object, _received: Stamp) -> list[Any]:
        elements = _elements(value, self._bounds)
        # A list of bounded length has few elements.
        if (lists := BUDGET.lists) is not None and self._bounds.max_length is None:
            lists.add(self._name, len(elements), 1)
        converted = self._convert_list(elements)
        return values.to_list(elements, self._convert) if converted is None else converted

    def default(self, _received: Stamp) -> list[Any]:
        return self._default.copy()


class _OctetArrayShape:
    """An array of octets, which may come as base64 text; of byte, it goes out as a list of integers."""

    def __init__(self, field: Field, bounds: ArrayBounds) -> None:
        self._name = f"{field.base}[]"
        # rosbridge packs uint8[] and char[] alone (message_conversion), so clients expect integers in a byte[].
        self._as_text = field.base in OCTETS
        self._bounds = bounds
        self._default = bytes(values.default(field))

    def complete(self, value: object, _received: Stamp) -> str | list[int]:
        """Take base64 text or a list; whichever came, the spelling that goes out is the same."""
        if self._as_text and type(value) is str and (count := values.octets_in(value)) is not None:
            _check_length(count, self._bounds)
            return value
        octets = values.to_octets(value, self._name)
        _check_length(len(octets), self._bounds)
        return self._spell(octets)

    def default(self, _received: Stamp) -> str | list[int]:
        return self._spell(self._default)

    def _spell(self, octets: bytes) -> str | list[int]:
        return pybase64.b64encode_as_string(octets) if self._as_text else list(octets)


class _MessageArrayShape:
    def __init__(self, name: str, element: _Shape, values_of_element: int, bounds: ArrayBounds) -> None:
        self._name = name
        self._element = element
        self._values_of_element = values_of_element
        self._bounds = bounds

    def complete(self, value: object, received: Stamp) -> list[Any]:
        elements = _elements(value, self._bounds)
        if (lists := BUDGET.lists) is not None:
            lists.add(self._name, len(elements), self._values_of_element)
        BUDGET.take(len(elements) * self._values_of_element)
        return values.to_list(elements, lambda element: self._element.complete(element, received))

    def default(self, received: Stamp) -> list[Any]:
        return [self._element.default(received) for _ in range(self._bounds.min_length)]


class _MessageShape:
    """A message: its fields, each with a shape of its own."""

    def __init__(self, name: str, shapes: Mapping[str, _Shape]) -> None:
        self._name = name
        self._other_names = _OTHER_NAMES.get(name)
        # Bound methods, looked up once: this list is walked for every message of the type.
        self._fields = [(field, shape.complete, shape.default) for field, shape in shapes.items()]

    def complete(self, value: object, received: Stamp) -> dict[str, Any]:
        if type(value) is not dict:
            raise MessageError(self._name, describe(value))
        if self._other_names:
            value = self._translate(value, self._other_names)
        completed = {}
        # A count of the fields found shows unknown ones without a search in every message.
        found = 0
        for name, complete_field, default in self._fields:
            if name not in value:
                completed[name] = default(received)
                continue
            found += 1
            try:
                completed[name] = complete_field(value[name], received)
            except MessageError as error:
                raise error.inside(name) from None
        if found != len(value):
            self._refuse_unknown(value, completed)
        return completed

    def default(self, received: Stamp) -> dict[str, Any]:
        return {name: default(received) for name, _, default in self._fields}

    def _translate(self, value: dict[str, Any], other_names: Mapping[str, str | None]) -> dict[str, Any]:
        # Nearly every message is in ROS 2 spelling already and needs no copy.
        if other_names.keys().isdisjoint(value):
            return value
        translated = {}
        for name, content in value.items():
            meant = other_names.get(name, name)
            if meant is None:
                continue
            # A stamp with both spellings is one of ROS 2 that serves clients of ROS 1 too.
            if meant == name or meant not in value:
                translated[meant] = content
        return translated

    def _refuse_unknown(self, value: dict[str, Any], known: Mapping[str, Any]) -> None:
        name = next(name for name in value if name not in known)
        fields = ", ".join(known) or "no field"
        raise MessageError(f"a field of {self._name} ({fields})", "an unknown one", shorten(name))


class _TimeShape(_MessageShape):
    """builtin_interfaces/Time, which may also be the text ``now``."""

    def complete(self, value: object, received: Stamp) -> dict[str, Any]:
        return received._asdict() if value == "now" else super().complete(value, received)


class _HeaderStampShape(_TimeShape):
    """The stamp of a header: where it is missing, it is the time of receipt."""

    def default(self, received: Stamp) -> dict[str, Any]:
        return received._asdict()


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def _message_shape(registry: Registry, type_name: str) -> _MessageShape:
    # Types of ROS never contain themselves, so this ends.
    message_type = registry.message(type_name)
    shapes = {each.name: _field_shape(registry, message_type.name, each) for each in message_type.fields}
    # Only in a header is a time that is left out the time of receipt; elsewhere zero has a meaning of its own.
    if message_type.name == HEADER:
        stamp = registry.message(TIME)
        shapes["stamp"] = _HeaderStampShape(TIME, {field.name: _PrimitiveShape(field) for field in stamp.fields})
    shape_class = _TimeShape if message_type.name == TIME else _MessageShape
    return shape_class(message_type.name, shapes)


def _field_shape(registry: Registry, type_name: str, field: Field) -> _Shape:
    name = f"{type_name}.{field.name}"
    if not field.primitive:
        element = _message_shape(registry, field.base)
        if field.array is None:
            return element
        return _MessageArrayShape(name, element, values_in(registry, field.base), field.array)
    if field.array is None:
        return _PrimitiveShape(field)
    if field.base in (*OCTETS, "byte"):
        return _OctetArrayShape(field, field.array)
    return _PrimitiveArrayShape(name, field, field.array)


def _elements(value: object, bounds: ArrayBounds) -> list[Any]:
    if type(value) is not list:
        raise MessageError("a list", describe(value))
    _check_length(len(value), bounds)
    return value


def _check_length(length: int, bounds: ArrayBounds) -> None:
    if bounds.max_length is None or bounds.min_length <= length <= bounds.max_length:
        return
    wanted = "exactly" if bounds.fixed else "at most"
    raise MessageError(f"{wanted} {bounds.max_length} elements", f"{length}")

"""The two spellings of a message: ROS 2's, which the server works with, and ROS 1's.

They differ in the times (``secs`` and ``nsecs``), in the header's ``seq``, in the names of types, and in fields
that one generation added, dropped or renamed. What ROS 1 lacks is left out on the way there and has its default
on the way back.

A pair of types is compiled once into a translation; types that both spell alike need none.
"""

from __future__ import annotations

import functools
import re
from bisect import bisect_right
from collections.abc import Callable, Mapping
from typing import Any, Literal, TypeAlias

from protocol import values
from protocol.registry import MAX_COMPILED_TYPES, Field, MessageType, Registry

# Log messages: ROS 1 has a header in place of the stamp, names the node's topics, and counts the levels otherwise
# (rosgraph_msgs/msg/Log.msg, rcl_interfaces/msg/Log.msg).
ROS1_LOG_TYPE, ROS2_LOG_TYPE = "rosgraph_msgs/msg/Log", "rcl_interfaces/msg/Log"

# DEBUG, INFO, WARN, ERROR and FATAL.
_ROS2_LEVELS, _ROS1_LEVELS = (10, 20, 30, 40, 50), (1, 2, 4, 8, 16)

# Fields that both have.
_COMMON = ("name", "msg", "file", "function", "line")


def _log_to_ros1(message: Mapping[str, Any]) -> dict[str, Any]:
    """Spell a complete rcl_interfaces/msg/Log as ROS 1 does; a level between two counts as the lower one."""
    stamp, place = message["stamp"], bisect_right(_ROS2_LEVELS, message["level"])
    return {
        "header": {"seq": 0, "stamp": {"secs": stamp["sec"], "nsecs": stamp["nanosec"]}, "frame_id": ""},
        "level": _ROS1_LEVELS[max(0, place - 1)],
        **{name: message[name] for name in _COMMON},
        "topics": [],
    }


def _log_from_ros1(message: Any) -> Any:
    """Spell a rosgraph_msgs/Log as ROS 2 does; what cannot be understood is passed on for the validation to refuse."""
    if type(message) is not dict:
        return message
    spelled = {name: value for name, value in message.items() if name not in ("header", "topics")}
    header = message.get("header")
    if header is not None:
        stamp = header.get("stamp") if type(header) is dict else header
        names = {"secs": "sec", "nsecs": "nanosec"}
        spelled["stamp"] = (
            {names.get(name, name): part for name, part in stamp.items()} if type(stamp) is dict else stamp
        )
    level = message.get("level")
    if level in _ROS1_LEVELS:
        spelled["level"] = _ROS2_LEVELS[_ROS1_LEVELS.index(level)]
    return spelled


Dialect: TypeAlias = Literal["ros2", "ros1"]

# Translates one value; None where both dialects spell it alike.
Translation: TypeAlias = Callable[[Any], Any] | None

# ROS 1 type -> its name of a field -> ROS 2's name, beyond those that differ in upper and lower case alone.
_RENAMED: Mapping[str, Mapping[str, str]] = {
    "time": {"secs": "sec", "nsecs": "nanosec"},
    "duration": {"secs": "sec", "nsecs": "nanosec"},
    "control_msgs/msg/JointTrajectoryControllerState": {"desired": "reference", "actual": "feedback"},
    "rosapi/srv/GetParam_Request": {"default": "default_value"},
}

# Types that ROS 1 calls otherwise. Times are primitives there; clients write the names of ROS 2 in two parts or three.
_ROS1_LOG_TYPES = {
    ROS2_LOG_TYPE: ROS1_LOG_TYPE,
    "rcl_interfaces/Log": ROS1_LOG_TYPE,
    "builtin_interfaces/msg/Time": "time",
    "builtin_interfaces/Time": "time",
    "builtin_interfaces/msg/Duration": "duration",
    "builtin_interfaces/Duration": "duration",
}

_MEMBER = re.compile(r"_(?=(?:Request|Response|Goal|Result|Feedback)\Z)")

# The one package that ROS 1 calls otherwise.
_ROSAPI_OF_ROS2, _ROSAPI_OF_ROS1 = "rosapi_msgs/", "rosapi/"


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def spell_type(type_name: str, dialect: Dialect) -> str:
    """Return a name of a type or member in a dialect's spelling: ``std_msgs/msg/String`` or ``std_msgs/String``."""
    if dialect == "ros2":
        return type_name
    package, *others = _in_ros1(type_name).split("/")
    # ROS 1 runs the names of a service and of its member together.
    return f"{package}/{_MEMBER.sub('', others[-1])}" if others else package


def to_ros1(registry: Registry, type_name: str, msg: Mapping[str, Any], sequence_number: int = 0) -> dict[str, Any]:
    """Spell a complete message as ROS 1 does; its header's ``seq`` counts from 1 (rospy/topics.py)."""
    translate = _to_ros1(registry, registry.message(type_name).name)
    spelled = dict(msg) if translate is None else translate(msg)
    header = spelled.get("header")
    if type(header) is dict and "seq" in header:
        # uint32.
        spelled["header"] = {**header, "seq": sequence_number % 2**32}
    return spelled


def from_ros1(registry: Registry, type_name: str, msg: object) -> Any:
    """Spell a message of a ROS 1 client as ROS 2 does; unreadable parts are passed on for the validation to refuse."""
    translate = _from_ros1(registry, registry.message(type_name).name)
    return msg if translate is None else translate(msg)


def declared_in_ros1(registry: Registry, type_name: str) -> MessageType:
    """Return a message type as ROS 1 declares it, else as ROS 2 does, or raise InterfaceError."""
    name = _in_ros1(type_name)
    return registry.ros1.message(name) if registry.ros1.knows(name) else registry.message(type_name)


def _in_ros1(type_name: str) -> str:
    if type_name.startswith(_ROSAPI_OF_ROS2):
        return type_name.replace(_ROSAPI_OF_ROS2, _ROSAPI_OF_ROS1, 1)
    return _ROS1_LOG_TYPES.get(type_name, type_name)


def _pair(ours: MessageType, theirs: MessageType) -> list[tuple[Field, Field | None]]:
    exact = {field.name: field for field in ours.fields}
    in_lower_case = {field.name.lower(): field for field in ours.fields}
    renamed = _RENAMED.get(theirs.name, {})
    return [
        (field, exact.get(renamed.get(field.name, field.name)) or in_lower_case.get(field.name.lower()))
        for field in theirs.fields
    ]


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def _to_ros1(registry: Registry, type_name: str) -> Translation:
    if type_name == ROS2_LOG_TYPE:
        return _log_to_ros1
    ours = registry.message(type_name)
    pairs = _pair(ours, declared_in_ros1(registry, ours.name))
    plan = [
        (theirs.name, field.name, _over(field, _to_ros1(registry, field.base) if not field.primitive else None))
        for theirs, field in pairs
        if field is not None
    ]
    # All that ROS 1 alone has are single numbers; a copy would be needed for arrays.
    added = {theirs.name: values.zero(theirs.base) for theirs, field in pairs if field is None}
    if not added and [(name, name, None) for name in (field.name for field in ours.fields)] == plan:
        return None
    order = [theirs.name for theirs, _ in pairs]

    def translate(msg: Mapping[str, Any]) -> dict[str, Any]:
        spelled = {name: msg[our_name] if step is None else step(msg[our_name]) for name, our_name, step in plan}
        return {name: spelled[name] if name in spelled else added[name] for name in order} if added else spelled

    return translate


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def _from_ros1(registry: Registry, type_name: str) -> Translation:
    if type_name == ROS2_LOG_TYPE:
        return _log_from_ros1
    ours = registry.message(type_name)
    pairs = _pair(ours, declared_in_ros1(registry, ours.name))
    names = {theirs.name: field.name if field else None for theirs, field in pairs}
    steps = {field.name: _over(field, _from_ros1(registry, field.base)) for field in ours.fields if not field.primitive}
    # Defaults exist in ROS 2 alone: the w of a quaternion is 0 in ROS 1 (geometry_msgs/Quaternion.msg).
    missing: dict[str, Any] = {
        field.name: zero
        for theirs, field in pairs
        if field is not None and theirs.primitive and (zero := values.default(theirs)) != values.default(field)
    }
    for field in ours.fields:
        step = steps.get(field.name) if field.array is None else None
        if step is not None and (filled := step({})):
            missing[field.name] = filled
    if not any(steps.values()) and not missing and all(name == our_name for name, our_name in names.items()):
        return None

    def translate(msg: Any) -> Any:
        if type(msg) is not dict:
            return msg
        spelled = dict(missing)
        for name, value in msg.items():
            our_name = names.get(name, name)
            if our_name is None:
                continue
            # Given in both spellings, it keeps the wrong name, for the validation to refuse.
            our_name = name if our_name in msg else our_name
            step = steps.get(our_name)
            spelled[our_name] = value if step is None else step(value)
        return spelled

    return translate


def _over(field: Field, translate: Translation) -> Translation:
    if translate is None or field.array is None:
        return translate
    # An array that is none is left for the validation to refuse.
    return lambda value: [translate(element) for element in value] if type(value) is list else value

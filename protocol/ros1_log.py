"""Translation of log messages: ``rosgraph_msgs/Log`` of ROS 1 and ``rcl_interfaces/msg/Log`` of ROS 2.

Nodes publish them on ``/rosout``. ROS 1 has a header in place of the stamp, names the node's topics, and counts the
levels otherwise (rosgraph_msgs/msg/Log.msg, rcl_interfaces/msg/Log.msg).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from typing import Any

ROS1_TYPE, ROS2_TYPE = "rosgraph_msgs/msg/Log", "rcl_interfaces/msg/Log"

# DEBUG, INFO, WARN, ERROR and FATAL.
_ROS2_LEVELS, _ROS1_LEVELS = (10, 20, 30, 40, 50), (1, 2, 4, 8, 16)

# Fields that both have.
_COMMON = ("name", "msg", "file", "function", "line")


def log_to_ros1(message: Mapping[str, Any]) -> dict[str, Any]:
    """Spell a complete rcl_interfaces/msg/Log as ROS 1 does; a level between two counts as the lower one."""
    stamp, place = message["stamp"], bisect_right(_ROS2_LEVELS, message["level"])
    return {
        "header": {"seq": 0, "stamp": {"secs": stamp["sec"], "nsecs": stamp["nanosec"]}, "frame_id": ""},
        "level": _ROS1_LEVELS[max(0, place - 1)],
        **{name: message[name] for name in _COMMON},
        "topics": [],
    }


def log_from_ros1(message: Any) -> Any:
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

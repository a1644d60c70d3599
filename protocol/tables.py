"""The interface tables as they ship: reads them, and derives the messages that ROS 1 makes of each action."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from typing import Any, TypeAlias

# Canonical name -> definition: ``kind`` is msg, srv or action. A message has ``fields`` (rows of name, type and
# perhaps default) and ``consts`` (rows of type, name and value); services and actions have members of that form.
Definition: TypeAlias = Mapping[str, Any]
Table: TypeAlias = Mapping[str, Definition]

# ROS 1 has these as primitives; as messages of two fields everything that walks a type can walk them too.
ROS1_TIMES: Table = {
    "time": {"kind": "msg", "fields": [["secs", "uint32"], ["nsecs", "uint32"]], "consts": []},
    "duration": {"kind": "msg", "fields": [["secs", "int32"], ["nsecs", "int32"]], "consts": []},
}


def read_ros2() -> Table:
    """Read the ROS 2 table."""
    return _read("ros2.json")


def read_ros1() -> Table:
    """Read the ROS 1 table, with the messages of its actions."""
    table = _read("ros1.json")
    messages = {name: row for action in table for name, row in _action_messages(action, table[action]).items()}
    return {**messages, **table}


def _read(file_name: str) -> Table:
    # Read through importlib, for the package may be installed as a zip.
    text = resources.files("protocol").joinpath("interfaces", file_name).read_text("utf-8")
    table: Table = json.loads(text)
    return table


def _action_messages(name: str, definition: Definition) -> Table:
    """Return the seven messages that actionlib generates for an action (ROS 1 actionlib, genaction)."""
    if definition["kind"] != "action":
        return {}
    package, _, action = name.split("/")
    spelled, canonical = f"{package}/{action}", f"{package}/msg/{action}"
    status = [["header", "std_msgs/Header"], ["status", "actionlib_msgs/GoalStatus"]]
    goal = [["header", "std_msgs/Header"], ["goal_id", "actionlib_msgs/GoalID"], ["goal", f"{spelled}Goal"]]
    parts = {
        "Goal": definition["goal"],
        "Result": definition["result"],
        "Feedback": definition["feedback"],
        "ActionGoal": _message(goal),
        "ActionResult": _message([*status, ["result", f"{spelled}Result"]]),
        "ActionFeedback": _message([*status, ["feedback", f"{spelled}Feedback"]]),
        "Action": _message(
            [[f"action_{part}", f"{spelled}Action{part.title()}"] for part in ("goal", "result", "feedback")]
        ),
    }
    return {f"{canonical}{suffix}": {"kind": "msg", **part} for suffix, part in parts.items()}


def _message(fields: list[list[str]]) -> Definition:
    return {"fields": fields, "consts": []}

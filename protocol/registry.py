"""Registry of interface types: looks a type up by name and gives its fields, bounds, defaults and constants.

A `Registry` speaks one generation of ROS. The one of ROS 2, which the server works with, also knows the types
that exist only in ROS 1, in ROS 2 spelling; `Registry.ros1` holds them as ROS 1 declares them. The tables are package
data; the messages that ROS 1 makes of each action are derived from the action when the tables are read. Types of the
user's own packages are added by `protocol.interface_packages`.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal, TypeAlias

from protocol.errors import InterfaceError

# Canonical name -> definition: ``kind`` is msg, srv or action. A message has ``fields`` (rows of name, type and
# perhaps default) and ``consts`` (rows of type, name and value); services and actions have members of that form.
Definition: TypeAlias = Mapping[str, Any]
Table: TypeAlias = Mapping[str, Definition]

Scalar: TypeAlias = bool | int | float | str

# Types that stay compiled, in each form and spelling: the tables hold fewer.
MAX_COMPILED_TYPES = 4096

# ROS 1 has these as primitives; as messages of two fields everything that walks a type can walk them too.
ROS1_TIMES: Table = {
    "time": {"kind": "msg", "fields": [["secs", "uint32"], ["nsecs", "uint32"]], "consts": []},
    "duration": {"kind": "msg", "fields": [["secs", "int32"], ["nsecs", "int32"]], "consts": []},
}


def read_ros2() -> Table:
    return _read("ros2.json")


def read_ros1() -> Table:
    """Read the ROS 1 table, with the messages of its actions."""
    return with_action_messages(_read("ros1.json"))


def with_action_messages(table: Table) -> Table:
    """Return a table of ROS 1 with the messages of its actions."""
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


Kind: TypeAlias = Literal["msg", "srv", "action"]

_INTEGERS = ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
TEXTS = frozenset(("string", "wstring"))
OCTETS = ("uint8", "char")  # arrays of these are base64 text in a complete message, as rosbridge clients have them
PRIMITIVES = frozenset((*_INTEGERS, *TEXTS, "bool", "byte", "char", "float32", "float64"))

# `float64`, `geometry_msgs/Point`, `float64[]`, `float64[9]`, `float64[<=3]`, `string<=20`, `string<=20[<=3]`
_TYPE_PATTERN = re.compile(r"(?P<base>[\w/]+)(?:<=(?P<length>\d+))?(?P<array>\[(?P<bounded><=)?(?P<size>\d+)?\])?")

# A text constant of ROS 2: quoted, perhaps with a comment behind it.
_QUOTED_PATTERN = re.compile(r"(?P<quote>[\"'])(?P<text>(?:\\.|(?!(?P=quote)).)*)(?P=quote)\s*(#.*)?")
_ESCAPED_PATTERN = re.compile(r"\\(.)")

_KIND_WORDS: dict[str, str] = {"msg": "a message type", "srv": "a service type", "action": "an action type"}

# Name of a member's message type behind its service or action -> key of the member in the tables.
_MEMBERS = {member.title(): member for member in ("request", "response", "goal", "result", "feedback")}

# Types of an action's feedback topic and services, and the type of a goal's id in them.
_DERIVED_PATTERN = re.compile(r"(?P<action>.+)_(?:FeedbackMessage|(?:SendGoal|GetResult)(?:_Request|_Response)?)")
_UUID = "unique_identifier_msgs/msg/UUID"

# Types that have another name in ROS 1 or in a port to ROS 2, each the same type to the server.
_RENAMED = {
    "rosgraph_msgs/msg/Log": "rcl_interfaces/msg/Log",
    # Names of roslib 2 and of earlier versions.
    "tf2_web_republisher_interfaces/action/TFSubscription": "tf2_web_republisher/action/TFSubscription",
    "tf2_web_republisher_msgs/action/TFSubscription": "tf2_web_republisher/action/TFSubscription",
}

# How ROS 2 calls the two primitives of ROS 1 that it has no primitives for.
_ROS2_NAMES = {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}


@dataclass(frozen=True, slots=True)
class ArrayBounds:
    """Bounds on the number of elements of an array field; ``max_length`` is None for no bound."""

    min_length: int
    max_length: int | None

    @property
    def fixed(self) -> bool:
        """True when the array has exactly one possible length."""
        return self.min_length == self.max_length


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message; ``base`` is in `PRIMITIVES` or a message type, ``max_length`` is in characters."""

    name: str
    base: str
    array: ArrayBounds | None
    default: Scalar | tuple[Scalar, ...] | None
    max_length: int | None = None

    @property
    def primitive(self) -> bool:
        return self.base in PRIMITIVES


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant of a message type: its primitive type, its name and its value."""

    base: str
    name: str
    value: Scalar


@dataclass(frozen=True, slots=True)
class MessageType:
    """A message type: its canonical name, its fields and its constants in order of declaration."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = ()


@dataclass(frozen=True, slots=True)
class ServiceType:
    """A service type; its members are message types named ``pkg/srv/Name_Request`` and ``…_Response``."""

    name: str
    request: MessageType
    response: MessageType


@dataclass(frozen=True, slots=True)
class ActionType:
    """An action type; its members are message types named ``pkg/action/Name_Goal``, ``…_Result``, ``…_Feedback``."""

    name: str
    goal: MessageType
    result: MessageType
    feedback: MessageType


class Registry:
    """All interface types of one generation of ROS.

    Lookups raise InterfaceError for a name that is unknown or of another kind.
    """

    def __init__(self, table: Table, ros1_table: Table | None = None) -> None:
        self._table = table
        self._ros1_table = ros1_table or {}
        self._messages: dict[str, MessageType] = {}

    @classmethod
    def load(cls) -> Registry:
        """Read the tables that ship with this package."""
        return cls(read_ros2(), read_ros1())

    @functools.cached_property
    def ros1(self) -> Registry:
        """The types as ROS 1 declares them; ``time`` and ``duration`` are message types of these names."""
        return Registry({**ROS1_TIMES, **self._ros1_table})

    def type_names(self) -> Iterator[str]:
        """Go over the canonical names of this generation's messages, services and actions."""
        return (name for name in self._table if name not in ROS1_TIMES)

    def knows(self, name: str, kind: Kind = "msg") -> bool:
        definition = self._find(_canonical(name, kind))
        return definition is not None and definition["kind"] == kind

    def exists_only_in_ros1(self, name: str, kind: Kind = "msg") -> bool:
        """Return True for a type whose users must be speaking ROS 1."""
        canonical = _canonical(name, kind)
        return _definition(self._table, canonical) is None and _definition(self._ros1_table, canonical) is not None

    def canonical(self, name: str, kind: Kind = "msg") -> str:
        """Return the three-part name of a type given in two parts or three."""
        return self._look_up(name, kind)[0]

    def message(self, name: str) -> MessageType:
        """Look a message type up, ``std_msgs/String``, ``std_msgs/msg/String`` or ``std_srvs/srv/SetBool_Request``."""
        message_type = self._messages.get(name)
        if message_type is None:
            canonical, definition = self._look_up(name, "msg")
            # Parsed when first asked for: a server uses a few dozen of the types, and start-up does not pay for others.
            message_type = self._messages.get(canonical) or self._read(canonical, definition)
            self._messages[canonical] = message_type
        return message_type

    def service(self, name: str) -> ServiceType:
        """Look a service type up, ``std_srvs/SetBool`` or ``std_srvs/srv/SetBool``."""
        canonical = self.canonical(name, "srv")
        return ServiceType(canonical, *(self.message(f"{canonical}_{member}") for member in ("Request", "Response")))

    def action(self, name: str) -> ActionType:
        """Look an action type up, ``control_msgs/PointHead`` or ``control_msgs/action/PointHead``."""
        canonical = self.canonical(name, "action")
        return ActionType(canonical, *(self.message(f"{canonical}_{part}") for part in ("Goal", "Result", "Feedback")))

    def _find(self, canonical: str) -> Definition | None:
        return (
            _definition(self._table, canonical) or _definition(self._ros1_table, canonical) or self._derived(canonical)
        )

    def _derived(self, canonical: str) -> Definition | None:
        """Return a type that rosidl derives from an action (rosidl_parser, definition.py, Action)."""
        found = _DERIVED_PATTERN.fullmatch(canonical)
        if found is None or _UUID not in self._table or not self.knows(f"{found['action']}_Feedback"):
            return None
        action, goal_id = found["action"], ["goal_id", _UUID]
        send_goal = [goal_id, ["goal", f"{action}_Goal"]], [["accepted", "bool"], ["stamp", "builtin_interfaces/Time"]]
        get_result = [goal_id], [["status", "int8"], ["result", f"{action}_Result"]]
        derived: dict[str, Definition] = {
            f"{action}_{name}": {"kind": "srv", "request": _message(request), "response": _message(response)}
            for name, (request, response) in (("SendGoal", send_goal), ("GetResult", get_result))
        }
        feedback = {"kind": "msg", **_message([goal_id, ["feedback", f"{action}_Feedback"]])}
        return _definition({**derived, f"{action}_FeedbackMessage": feedback}, canonical)

    def _look_up(self, name: str, kind: Kind) -> tuple[str, Definition]:
        canonical = _canonical(name, kind)
        if self._ros1_table:
            canonical = _RENAMED.get(canonical, canonical)
        definition = self._find(canonical)
        if definition is None:
            raise InterfaceError(name, "unknown (package and name must match, in upper and lower case too)")
        if definition["kind"] != kind:
            raise InterfaceError(name, f"is of kind {definition['kind']}, wanted {_KIND_WORDS[kind]}")
        return canonical, definition

    def _read(self, canonical: str, definition: Definition) -> MessageType:
        constants = (Constant(base, name, _value(base, text)) for base, name, text in definition["consts"])
        return MessageType(canonical, tuple(self._field(row) for row in definition["fields"]), tuple(constants))

    def _field(self, row: list[str]) -> Field:
        name, declared, *defaults = row
        match = _TYPE_PATTERN.fullmatch(declared)
        if match is None:
            raise InterfaceError(declared, f"of field {name} cannot be read")
        default = _default(declared, defaults[0]) if defaults else None
        length = int(match["length"]) if match["length"] else None
        return Field(name, self._base(match["base"]), _array_bounds(match), default, length)

    def _base(self, name: str) -> str:
        if name in PRIMITIVES:
            return name
        return self.canonical(name if name in self._table else _ROS2_NAMES.get(name, name))


def _canonical(name: str, kind: Kind) -> str:
    # A name in two parts does not show its kind: control_msgs/GripperCommand is a message and an action.
    # rosbridge_library drops empty parts, as of /std_msgs/String and std_msgs/String/ (ros_loader, _splittype).
    parts = [part for part in name.split("/") if part]
    return f"{parts[0]}/{kind}/{parts[1]}" if len(parts) == 2 else "/".join(parts)


def _definition(table: Table, canonical: str) -> Definition | None:
    """Look a definition up; a member of a service or action is a message."""
    definition = table.get(canonical)
    if definition is not None:
        return definition
    owner, _, member = canonical.rpartition("_")
    fields = table.get(owner, {}).get(_MEMBERS.get(member, ""))
    return {"kind": "msg", **fields} if fields is not None else None


def _array_bounds(match: re.Match[str]) -> ArrayBounds | None:
    if match["array"] is None:
        return None
    size = int(match["size"]) if match["size"] else None
    return ArrayBounds(0 if match["bounded"] or size is None else size, size)


def _default(declared: str, text: str) -> Scalar | tuple[Scalar, ...]:
    # The elements of an array are written in JSON.
    return tuple(json.loads(text)) if declared.endswith("]") else _value(declared.partition("<=")[0], text)


def _value(base: str, text: str) -> Scalar:
    if base in TEXTS:
        quoted = _QUOTED_PATTERN.fullmatch(text)
        return _ESCAPED_PATTERN.sub(r"\1", quoted["text"]) if quoted else text
    if base == "bool":
        return text.lower() in ("true", "1")
    return float(text) if base.startswith("float") else int(text, 0)

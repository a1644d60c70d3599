"""Costly requests, made of the interface tables: each list and each text of a type in turn, as long as may be."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

from benchmarks.costly_frames import Attack, call, op
from protocol.registry import Field, Registry

KILO, MEGA = 1_000, 1_000_000

# First tries, and what the worst of them are tried with: bytes of all operations, and their number.
# Size of a whole attack [bytes], and number of its operations.
Shape: TypeAlias = tuple[int, int]
FIRST_SHAPES: tuple[Shape, ...] = ((100 * KILO, 1), (100 * KILO, 100))
LARGER_SHAPES: tuple[Shape, ...] = (
    (MEGA, 1),
    (9 * MEGA, 1),
    (MEGA, 100),
    (9 * MEGA, 100),
    (MEGA, 1000),
    (9 * MEGA, 1000),
)

# Texts deeper than this are not made long: there are hundreds in a scene, and the server treats them alike.
MAX_TEXT_DEPTH = 2

MAX_DEPTH = 4  # lists deeper than this are not made long either: a scene has the same ones in several places

# An action without topics of actionlib, from which the types of the others are read.
MORE_ACTIONS = {"/parallel_gripper_controller/gripper_cmd": "control_msgs/ParallelGripperCommand"}

_ACTIONLIB_GOAL, _ACTION_GOAL = "/goal", "ActionGoal"
_MARK = "@"


@dataclass(frozen=True)
class Interfaces:
    """Services, topics that the server has subscribed to, and actions of a server, with their types."""

    services: Mapping[str, str]
    topics: Mapping[str, str]
    actions: Mapping[str, str]


def ask_interfaces(ask: Callable[..., dict[str, Any]]) -> Interfaces:
    """Ask a server's rosapi."""
    services = ask("/rosapi/services")["services"]
    topics = ask("/rosapi/topics")
    types = dict(zip(topics["topics"], topics["types"], strict=True))
    actions = {
        name.removesuffix(_ACTIONLIB_GOAL): type_name.removesuffix(_ACTION_GOAL).replace("/msg/", "/")
        for name, type_name in types.items()
        if type_name.endswith(_ACTION_GOAL)
    }
    return Interfaces(
        {name: ask("/rosapi/service_type", {"service": name})["type"] for name in services},
        {name: of for name, of in types.items() if ask("/rosapi/subscribers", {"topic": name})["subscribers"]},
        {**actions, **MORE_ACTIONS},
    )


@dataclass(frozen=True)
class Recipe:
    """Attack by one operation again and again, whose size can be chosen."""

    name: str  # for tables
    operation: Callable[[int], str]  # makes the operation's text of its size [bytes]
    shapes: tuple[Shape, ...]  # sizes of the whole attack and numbers of its operations for the first tries

    def make(self, shape: Shape) -> Attack:
        """Make the attack of a shape."""
        size_bytes, count = shape
        return Attack(f"{count} x {self.name}", [self.operation(size_bytes // count)] * count)


# Field names from the outermost on, True where the field is a list.
Path: TypeAlias = tuple[tuple[str, bool], ...]

# Makes the text of an operation of its arguments, or its message.
Spell: TypeAlias = Callable[[object], str]


def requests_of_every_type(registry: Registry, interfaces: Interfaces) -> Iterator[Recipe]:
    """Make recipes for each service, topic and action: without any field, and with each list and text in turn."""
    for service, type_name in interfaces.services.items():
        yield from _recipes(registry, service, f"{type_name}_Request", partial(call, service))
    for topic, type_name in interfaces.topics.items():
        yield from _recipes(registry, f"publish {topic}", type_name, partial(_publish, topic))
    for action, type_name in interfaces.actions.items():
        goal_type = f"{registry.canonical(type_name, 'action')}_Goal"
        yield from _recipes(registry, f"goal {action}", goal_type, partial(_send_goal, action, type_name))


def _publish(topic: str, msg: object) -> str:
    return op("publish", topic=topic, msg=msg)


def _send_goal(action: str, type_name: str, args: object) -> str:
    return op("send_action_goal", action=action, action_type=type_name, args=args, id="goal")


def _recipes(registry: Registry, name: str, type_name: str, spell: Spell) -> Iterator[Recipe]:
    text = spell({})
    yield Recipe(f"{name} {{}}", lambda _: text, ((0, 1000),))
    for path, element in _long_fields(registry, type_name):
        spelled = ".".join(field + "[]" * is_list for field, is_list in path)
        yield Recipe(f"{name} {spelled}", partial(_long, path, element, spell), FIRST_SHAPES)


def _long(path: Path, element: str | None, spell: Spell, size_bytes: int) -> str:
    """Make one field long: a list of an element's JSON text, or a text where the element is None."""
    if element is None:
        filled = '"' + "x" * size_bytes + '"'
    else:
        filled = ",".join([element] * max(1, size_bytes // (len(element) + 1)))
    *outer, (last, _) = path
    value: object = {last: _MARK if element is None else [_MARK]}
    for field, is_list in reversed(outer):
        value = {field: [value] if is_list else value}
    return spell(value).replace(json.dumps(_MARK), filled, 1)


def _long_fields(registry: Registry, type_name: str, outer: Path = ()) -> Iterator[tuple[Path, str | None]]:
    if len(outer) == MAX_DEPTH:
        return
    for field in registry.message(type_name).fields:
        here = (*outer, (field.name, field.array is not None))
        if field.array is not None and not field.array.fixed:
            yield here, _element(field)
        elif field.base == "string" and len(here) <= MAX_TEXT_DEPTH:
            yield here, None
        if not field.primitive and (field.array is None or not field.array.fixed):
            yield from _long_fields(registry, field.base, here)


def _element(field: Field) -> str:
    """Return the JSON text of an element that a server of this arm may take."""
    if not field.primitive:
        return "{}"
    if field.base == "string":
        return '"gripper_frame_link"' if "link" in field.name else '"shoulder_pan"'
    return "false" if field.base == "bool" else "0"

"""Actions as ROS 1 knows them: the five topics of actionlib before each action of the server.

A goal on ``NAME/goal`` is sent to the action as anyone's goal; its progress is published on ``NAME/status``,
``NAME/feedback`` and ``NAME/result`` (ROS wiki, actionlib/DetailedDescription). Ids, stamps and statuses of an
action's goals are kept as actionlib keeps them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeAlias

from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from protocol.registry import Registry
from server.graph.actions import Goal, GoalStatus, Result
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.timers import CallLater

GoalId: TypeAlias = Mapping[str, Any]

# actionlib's status_list_timeout: time for which the status of an ended goal is still published [s].
ENDED_KEPT_S = 5.0

# Far more than anybody waits for; further goals are rejected.
MAX_GOALS = 100

ZERO = Stamp(0, 0)


class Status(IntEnum):
    """Values of actionlib_msgs/GoalStatus that are published here."""

    PENDING = 0
    ACTIVE = 1
    PREEMPTED = 2
    SUCCEEDED = 3
    ABORTED = 4
    REJECTED = 5
    PREEMPTING = 6


STATUS_OF_END = {GoalStatus.SUCCEEDED: Status.SUCCEEDED, GoalStatus.CANCELED: Status.PREEMPTED}


@dataclass
class Tracked:
    """A goal."""

    goal_id: GoalId
    status: Status = Status.PENDING
    text: str = ""
    ended_s: float | None = None

    @property
    def key(self) -> str:
        return str(self.goal_id["id"])

    def message(self) -> dict[str, Any]:
        return {"goal_id": self.goal_id, "status": int(self.status), "text": self.text}


class TrackedGoals:
    """All goals of one action that have not been forgotten."""

    def __init__(self, action: str) -> None:
        self._action = action
        self._goals: dict[str, Tracked] = {}
        self._count = 0

    @property
    def full(self) -> bool:
        return sum(goal.ended_s is None for goal in self._goals.values()) >= MAX_GOALS

    def add(self, goal_id: GoalId, now: Stamp) -> Tracked | None:
        """Take a goal on, with an id and a stamp if its client gave none; None when its id is known already."""
        stamp = _stamp(goal_id) if _stamp(goal_id) != ZERO else now
        self._count += 1
        name = goal_id["id"] or f"{self._action}-{self._count}-{stamp.sec}.{stamp.nanosec:09d}"
        if name in self._goals:
            return None
        goal = self._goals[name] = Tracked({"stamp": stamp.as_message(), "id": name})
        return goal

    def on_its_way(self, key: str) -> Tracked | None:
        goal = self._goals.get(key)
        return None if goal is None or goal.ended_s is not None else goal

    def update(self, key: str, status: Status, text: str = "", ended_s: float | None = None) -> Tracked | None:
        """Note the status of a goal, and the monotonic time of its end [s]; return it, None when it is not active."""
        goal = self.on_its_way(key)
        if goal is not None:
            goal.status, goal.text, goal.ended_s = status, text or goal.text, ended_s
        return goal

    def to_cancel(self, goal_id: GoalId) -> list[str]:
        """Return the goals that a message on the topic ``cancel`` selects.

        All of them when it has neither id nor stamp; else the goal of its id, and all goals no younger than its stamp.
        """
        stamp, name = _stamp(goal_id), goal_id["id"]
        everything = not name and stamp == ZERO
        return [
            key
            for key, goal in self._goals.items()
            if goal.ended_s is None and (everything or key == name or ZERO < _stamp(goal.goal_id) <= stamp)
        ]

    def forget(self, now_s: float) -> None:
        """Drop what ended long before a monotonic time [s]."""
        self._goals = {
            key: goal
            for key, goal in self._goals.items()
            if goal.ended_s is None or now_s - goal.ended_s < ENDED_KEPT_S
        }
        for key in list(self._goals)[: -2 * MAX_GOALS]:
            if self._goals[key].ended_s is not None:
                del self._goals[key]

    def messages(self) -> list[dict[str, Any]]:
        """The actionlib_msgs/GoalStatus of each, the oldest first."""
        return [goal.message() for goal in self._goals.values()]


def _stamp(goal_id: GoalId) -> Stamp:
    return Stamp(goal_id["stamp"]["sec"], goal_id["stamp"]["nanosec"])


log = logging.getLogger("armbridge.actionlib")

# actionlib's default status_frequency; clients take a server for gone when statuses stay away for seconds.
STATUS_PERIOD_S = 0.2

GOAL_ID = "actionlib_msgs/GoalID"
STATUS_ARRAY = "actionlib_msgs/GoalStatusArray"


def has_actionlib_types(registry: Registry, type_name: str) -> bool:
    """Tell whether ROS 1 has an action of this type, and so the messages of its topics."""
    return registry.knows(_message_type(type_name, "ActionGoal"))


class ActionlibBridge:
    """Keeps the topics of several actions."""

    def __init__(self, graph: Graph, clock: Callable[[], float], call_later: CallLater) -> None:
        self._graph = graph
        self._clock = clock
        self._call_later = call_later
        self._bridged: list[BridgedAction] = []

    def open(self, names: Iterable[str]) -> None:
        """Open the topics of actions that are offered; one of a type that ROS 1 lacks has none."""
        for name in names:
            type_name = self._graph.actions.names.type_of(name)
            if type_name is not None and has_actionlib_types(self._graph.message_types.registry, type_name):
                self._bridged.append(BridgedAction(self._graph, name, type_name, self._clock))
        self._beat()

    def _beat(self) -> None:
        for action in self._bridged:
            action.publish_status()
        self._call_later(STATUS_PERIOD_S, self._beat)


class BridgedAction:
    """The topics of one action."""

    def __init__(self, graph: Graph, name: str, type_name: str, clock: Callable[[], float]) -> None:
        self._graph = graph
        self._name = name
        self._type_name = type_name
        self._clock = clock
        self._node = Node(f"actionlib of {name}")
        self._tracked = TrackedGoals(name)
        self._goals: dict[str, Goal] = {}
        # ROS 1's results and feedback lack fields that ROS 2 added.
        self._fields = {part: self._fields_of(part) for part in ("Result", "Feedback")}
        for part in ("Result", "Feedback"):
            graph.advertise(self._node, f"{name}/{part.lower()}", _message_type(type_name, f"Action{part}"))
        graph.advertise(self._node, f"{name}/status", STATUS_ARRAY)
        goal_type = _message_type(type_name, "ActionGoal")
        goals = Subscriber(self._take_goal, on_unauthorized=self._reject_unauthorized)
        graph.subscribe(self._node, f"{name}/goal", goal_type, goals)
        graph.subscribe(self._node, f"{name}/cancel", GOAL_ID, Subscriber(self._take_cancel))

    def publish_status(self) -> None:
        """Tell how all goals are, if anybody listens."""
        self._tracked.forget(self._clock())
        topic = f"{self._name}/status"
        if self._graph.subscribers(topic):
            self._graph.publish(self._node, topic, {"status_list": self._tracked.messages()})

    def _take_goal(self, published: PublishedMessage) -> None:
        message, full = published.msg, self._tracked.full
        tracked = self._tracked.add(message["goal_id"], self._graph.message_types.now())
        if tracked is None:
            log.warning("%s: a goal of the id %r is known already", self._name, message["goal_id"]["id"])
            return
        if full:
            self._end(tracked.key, Status.REJECTED, f"too many goals of {self._name} are on their way", {})
            return
        self._tracked.update(tracked.key, Status.ACTIVE)
        sender = published.publisher if isinstance(published.publisher, Node) else self._node
        self._send(tracked.key, sender, message["goal"])
        self.publish_status()

    def _reject_unauthorized(self, message: Mapping[str, Any], sender: Node, reason: str) -> None:
        """Reject a goal that its sender may not send; nobody else waits for it, and it takes no place."""
        if message:
            status = {"goal_id": message["goal_id"], "status": int(Status.REJECTED), "text": reason}
            self._graph.tell(sender, f"{self._name}/status", {"status_list": [*self._tracked.messages(), status]})
            self._graph.tell(sender, f"{self._name}/result", {"status": status})

    def _send(self, key: str, sender: Node, message: Mapping[str, Any]) -> None:
        at_once: list[Result] = []
        goal = self._graph.actions.send_goal(
            sender,
            self._name,
            self._type_name,
            message,
            at_once.append,
            lambda feedback: self._on_feedback(key, feedback),
        )
        if goal is None or goal.ended:
            self._on_result(key, at_once[0])
            return
        self._goals[key] = goal
        # Not by the sender's callback: when the sender leaves, others may still be listening.
        goal.when_ended(lambda result: self._on_result(key, result))

    def _take_cancel(self, published: PublishedMessage) -> None:
        for key in self._tracked.to_cancel(published.msg):
            goal = self._goals.get(key)
            if goal is not None:
                self._tracked.update(key, Status.PREEMPTING)
                goal.cancel()
        self.publish_status()

    def _on_result(self, key: str, result: Result) -> None:
        self._goals.pop(key, None)
        if result.ok:
            status = STATUS_OF_END.get(GoalStatus(result.status), Status.ABORTED)
            self._end(key, status, _sentence(result.values), result.values)
        else:
            taken_on = result.status != GoalStatus.UNKNOWN
            self._end(key, Status.ABORTED if taken_on else Status.REJECTED, str(result.values), {})

    def _end(self, key: str, status: Status, text: str, values: Mapping[str, Any]) -> None:
        goal = self._tracked.update(key, status, text, self._clock())
        if goal is not None:
            self._publish("Result", goal, values)
            self.publish_status()

    def _on_feedback(self, key: str, values: Mapping[str, Any]) -> None:
        goal = self._tracked.on_its_way(key)
        if goal is not None:
            self._publish("Feedback", goal, values)

    def _publish(self, part: str, goal: Tracked, values: Mapping[str, Any]) -> None:
        known = {name: values[name] for name in self._fields[part] if name in values}
        message = {"status": goal.message(), part.lower(): known}
        self._graph.publish(self._node, f"{self._name}/{part.lower()}", message)

    def _fields_of(self, part: str) -> tuple[str, ...]:
        message_type = self._graph.message_types.registry.message(_message_type(self._type_name, part))
        return tuple(field.name for field in message_type.fields)


def _message_type(type_name: str, part: str) -> str:
    """The message of ROS 1 that belongs to an action: ``moveit_msgs/msg/MoveGroupActionGoal``."""
    package, _, action = type_name.split("/")
    return f"{package}/msg/{action}{part}"


def _sentence(result: Mapping[str, Any]) -> str:
    """Return a result's sentence, for which ROS 1's error codes have no field."""
    code = result.get("response", result).get("error_code")
    if isinstance(code, Mapping):
        return str(code.get("message", ""))
    return str(result.get("error_string", ""))

"""Actions as ROS 1 knows them: the five topics of actionlib before each action of the server.

A goal on ``NAME/goal`` is sent to the action as anyone's goal; its progress is published on ``NAME/status``,
``NAME/feedback`` and ``NAME/result`` (ROS wiki, actionlib/DetailedDescription). Ids, stamps and statuses of an
action's goals are kept as actionlib keeps them.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeAlias

from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from protocol.registry import Registry
from server.graph.actions import ActionGoal, GoalStatus, Result
from server.graph.permissions import Node
from server.graph.topics import Graph

log = logging.getLogger("armbridge.actionlib")

GoalId: TypeAlias = Mapping[str, Any]

# actionlib's status_list_timeout: time for which the status of an ended goal is still published [s].
ENDED_KEPT_S = 5.0

# Far more goals than anybody waits for; further ones are rejected.
MAX_GOALS = 100

ZERO = Stamp(0, 0)


class ActionlibStatus(IntEnum):
    """Values of actionlib_msgs/GoalStatus that are published here."""

    PENDING = 0
    ACTIVE = 1
    PREEMPTED = 2
    SUCCEEDED = 3
    ABORTED = 4
    REJECTED = 5
    PREEMPTING = 6


STATUS_OF_END = {GoalStatus.SUCCEEDED: ActionlibStatus.SUCCEEDED, GoalStatus.CANCELED: ActionlibStatus.PREEMPTED}


@dataclass(eq=False)
class Tracked:
    """A goal of actionlib; ``sent`` is the goal of the action, until it has ended."""

    goal_id: GoalId
    status: ActionlibStatus = ActionlibStatus.PENDING
    text: str = ""
    ended_s: float | None = None
    sent: ActionGoal | None = None

    def message(self) -> dict[str, Any]:
        return {"goal_id": self.goal_id, "status": int(self.status), "text": self.text}


def _stamp(goal_id: GoalId) -> Stamp:
    return Stamp(goal_id["stamp"]["sec"], goal_id["stamp"]["nanosec"])


# actionlib's default status_frequency; clients take a server for gone when statuses stay away for seconds.
STATUS_PERIOD_S = 0.2

GOAL_ID = "actionlib_msgs/GoalID"
STATUS_ARRAY = "actionlib_msgs/GoalStatusArray"


def has_actionlib_types(registry: Registry, type_name: str) -> bool:
    """Return True if ROS 1 has an action of this type, and so the messages of its topics."""
    return registry.knows(_message_type(type_name, "ActionGoal"))


def bridge_actions(graph: Graph) -> None:
    """Open and keep the topics of all actions that are offered now; an action of a type that ROS 1 lacks has none."""
    registry = graph.message_types.registry
    bridged = [
        BridgedAction(graph, name, type_name)
        for name, type_name in graph.actions.names.types().items()
        if has_actionlib_types(registry, type_name)
    ]

    def beat() -> None:
        for action in bridged:
            action.publish_status()
        graph.call_later(STATUS_PERIOD_S, beat)

    beat()


class BridgedAction:
    """The topics of one action."""

    def __init__(self, graph: Graph, name: str, type_name: str) -> None:
        self._graph = graph
        self._name = name
        self._type_name = type_name
        self._node = graph.node(f"actionlib of {name}")
        # Goals that have not been forgotten, by id, the oldest first.
        self._goals: dict[str, Tracked] = {}
        self._count = 0
        # ROS 1's results and feedback lack fields that ROS 2 added.
        registry = graph.message_types.registry
        self._fields = {
            part: [field.name for field in registry.message(_message_type(type_name, part)).fields]
            for part in ("Result", "Feedback")
        }
        for part in ("Result", "Feedback"):
            self._node.advertise(f"{name}/{part.lower()}", _message_type(type_name, f"Action{part}"))
        self._node.advertise(f"{name}/status", STATUS_ARRAY)
        goal_type = _message_type(type_name, "ActionGoal")
        self._node.subscribe(f"{name}/goal", goal_type, self._take_goal, on_unauthorized=self._reject_unauthorized)
        self._node.subscribe(f"{name}/cancel", GOAL_ID, self._take_cancel)

    def publish_status(self) -> None:
        # Drop goals that ended long ago, and the oldest ended goals where there are very many.
        now_s = self._graph.clock()
        self._goals = {
            key: goal
            for key, goal in self._goals.items()
            if goal.ended_s is None or now_s - goal.ended_s < ENDED_KEPT_S
        }
        for key in list(self._goals)[: -2 * MAX_GOALS]:
            if self._goals[key].ended_s is not None:
                del self._goals[key]
        topic = f"{self._name}/status"
        if self._node.subscribers(topic):
            self._node.publish(topic, {"status_list": self._messages()})

    def _messages(self) -> list[dict[str, Any]]:
        return [goal.message() for goal in self._goals.values()]

    def _take_goal(self, published: PublishedMessage) -> None:
        message = published.msg
        full = sum(goal.ended_s is None for goal in self._goals.values()) >= MAX_GOALS
        goal = self._tracked(message["goal_id"])
        if goal is None:
            log.warning("%s: a goal of the id %r is known already", self._name, message["goal_id"]["id"])
            return
        if full:
            self._end(goal, ActionlibStatus.REJECTED, f"{MAX_GOALS} goals of {self._name} are active, the limit", {})
            return
        goal.status = ActionlibStatus.ACTIVE
        sender = published.publisher if isinstance(published.publisher, Node) else self._node
        self._send(goal, sender, message["goal"])
        self.publish_status()

    def _tracked(self, goal_id: GoalId) -> Tracked | None:
        """Track a goal, with an id and a stamp if its client gave none; None when its id is known already."""
        stamp = _stamp(goal_id) if _stamp(goal_id) != ZERO else self._node.message_types.now()
        self._count += 1
        key = goal_id["id"] or f"{self._name}-{self._count}-{stamp.sec}.{stamp.nanosec:09d}"
        if key in self._goals:
            return None
        goal = self._goals[key] = Tracked({"stamp": stamp.as_message(), "id": key})
        return goal

    def _reject_unauthorized(self, message: Mapping[str, Any], sender: Node, reason: str) -> None:
        """Reject a goal that its sender may not send; nobody else waits for it, and it takes no place."""
        if message:
            status = {"goal_id": message["goal_id"], "status": int(ActionlibStatus.REJECTED), "text": reason}
            self._node.deliver_to(sender, f"{self._name}/status", {"status_list": [*self._messages(), status]})
            self._node.deliver_to(sender, f"{self._name}/result", {"status": status})

    def _send(self, goal: Tracked, sender: Node, message: Mapping[str, Any]) -> None:
        at_once: list[Result] = []
        sent = self._graph.actions.send_goal(
            sender,
            self._name,
            self._type_name,
            message,
            at_once.append,
            lambda feedback: None if goal.ended_s is not None else self._publish("Feedback", goal, feedback),
        )
        if sent is None or sent.ended:
            self._on_result(goal, at_once[0])
            return
        goal.sent = sent
        # Not by the sender's callback: when the sender leaves, others may still be listening.
        sent.when_ended(lambda result: self._on_result(goal, result))

    def _take_cancel(self, published: PublishedMessage) -> None:
        """Cancel all goals, however they came, without id and stamp; else the goal of the id, and up to the stamp."""
        stamp, name = _stamp(published.msg), published.msg["id"]
        everything = not name and stamp == ZERO
        for key, goal in list(self._goals.items()):
            selected = everything or key == name or ZERO < _stamp(goal.goal_id) <= stamp
            if selected and goal.sent is not None:
                goal.status = ActionlibStatus.PREEMPTING
                goal.sent.cancel()
        if everything:
            self._graph.actions.cancel(self._name)
        self.publish_status()

    def _on_result(self, goal: Tracked, result: Result) -> None:
        goal.sent = None
        if result.ok:
            status = STATUS_OF_END.get(GoalStatus(result.status), ActionlibStatus.ABORTED)
            self._end(goal, status, _sentence(result.values), result.values)
        else:
            taken_on = result.status != GoalStatus.UNKNOWN
            self._end(goal, ActionlibStatus.ABORTED if taken_on else ActionlibStatus.REJECTED, str(result.values), {})

    def _end(self, goal: Tracked, status: ActionlibStatus, text: str, values: Mapping[str, Any]) -> None:
        goal.status, goal.text, goal.ended_s = status, text, self._graph.clock()
        self._publish("Result", goal, values)
        self.publish_status()

    def _publish(self, part: str, goal: Tracked, values: Mapping[str, Any]) -> None:
        known = {name: values[name] for name in self._fields[part] if name in values}
        message = {"status": goal.message(), part.lower(): known}
        self._node.publish(f"{self._name}/{part.lower()}", message)


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

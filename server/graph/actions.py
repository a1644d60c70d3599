"""Actions of the graph: local parts and remote clients offer them and send goals alike.

A sender gets exactly one result: the provider's, or the reason for which there is none. Each action has topics, as in
ROS 2: ``<action>/_action/status`` and ``<action>/_action/feedback``, which the node that offers it publishes. The
status topic is latched; it has the goals that are worked on, and of ended ones for a while (rcl_action,
action_server.c). Feedback is published while somebody listens.
"""

from __future__ import annotations

import enum
import logging
import uuid
from base64 import b64encode
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from protocol.errors import InterfaceError, MessageError
from protocol.messages import ListLimits
from protocol.operations import OperationId
from server.errors import GraphError
from server.graph.message_types import MessageTypes
from server.graph.permissions import Node, Rule
from server.graph.providers import PendingRequest, Provider, Providers
from server.timers import CallLater

if TYPE_CHECKING:
    from server.graph.topics import Graph

log = logging.getLogger("armbridge.graph")

# Between the name of an action and the names of its services and topics (rcl_action, names.c).
ACTION_PARTS = "/_action/"
STATUS, FEEDBACK, CANCEL_SERVICE = (f"{ACTION_PARTS}{part}" for part in ("status", "feedback", "cancel_goal"))
STATUS_TYPE = "action_msgs/msg/GoalStatusArray"

# rcl_action's default result_timeout: time for which the status of an ended goal is still published [s].
ENDED_KEPT_S = 10.0

# Far more than anybody waits for. Of more goals the newest are published, so that a flood costs little for each goal.
MAX_PUBLISHED = 100


class GoalStatus(enum.IntEnum):
    """Status of a goal: values of action_msgs/GoalStatus."""

    # The goal was never taken on.
    UNKNOWN = 0
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


@dataclass(frozen=True)
class Result:
    """The end of a goal."""

    ok: bool
    status: int
    values: Any


class ActionGoal(PendingRequest[Result]):
    """A goal that its provider is to end with :meth:`finish` or :meth:`fail`; only the first end counts.

    ``names`` are the action's name and its type.
    """

    answered = "Result"

    def __init__(
        self,
        names: tuple[str, str],
        request: dict[str, Any],
        message_types: MessageTypes,
        sender: Node,
        on_feedback: Callable[[dict[str, Any]], None] | None = None,
        goal_id: bytes | None = None,
    ) -> None:
        self.action, type_name = names
        super().__init__(f"Action {self.action}", type_name, request, message_types)
        self.sender = sender
        self.goal_id = goal_id or uuid.uuid4().bytes
        # The action_msgs/GoalInfo, and the latest action_msgs/GoalStatus.
        uuid_of_goal = {"uuid": b64encode(self.goal_id).decode()}
        self.info: dict[str, Any] = {"goal_id": uuid_of_goal, "stamp": message_types.now().as_message()}
        self.status: int = GoalStatus.EXECUTING
        self.sender_id: OperationId = None
        self.sender_left = False
        self._on_feedback = on_feedback
        self._when_canceled: list[Callable[[], None]] = []

    @property
    def cancel_requested(self) -> bool:
        return self.status == GoalStatus.CANCELING

    def feedback(self, values: object) -> None:
        """Send feedback; fields that the message leaves out get their defaults."""
        completed = self._message_types.complete(f"{self.type_name}_Feedback", values)
        if not self.ended and self._on_feedback is not None:
            self._on_feedback(completed)

    def finish(self, status: GoalStatus, values: object) -> None:
        """End the goal with a result message; what it leaves out gets its default, unless it is a `CompleteResponse`.

        Raises MessageError for values that do not fit: the goal has failed, and its sender knows.
        """
        self._end(Result(ok=True, status=status, values=self._completed(values)))

    def fail(self, values: object, status: int = GoalStatus.ABORTED) -> None:
        """End the goal without a result message, with a sentence or with what the provider gave."""
        self._end(Result(ok=False, status=status, values=values))

    def _end(self, end: Result) -> None:
        if not self.ended:
            self.status = end.status
        super()._end(end)
        self._when_canceled, self._on_feedback = [], None

    def when_canceled(self, callback: Callable[[], None]) -> None:
        """Call ``callback`` when somebody asks for the end of the goal; at once when somebody has."""
        self._when_canceled.append(callback)
        if self.cancel_requested:
            callback()

    def cancel(self) -> None:
        """Ask the provider to end the goal, which still ends as the provider says."""
        if self.cancel_requested or self.ended:
            return
        self.status = GoalStatus.CANCELING
        for callback in self._when_canceled:
            callback()


class _PublishedStatus(NamedTuple):
    message: dict[str, Any]  # action_msgs/GoalStatus
    ended_s: float | None  # time of the goal's end [s]


# A goal may take long, and must end even if its provider has forgotten it.
MAX_GOAL_S = 3600.0

# As for topics: far more than any robot has.
MAX_ACTIONS = 1_000

# action_msgs/srv/CancelGoal: what it answers, and the goal id that stands for all goals.
CANCEL_ACCEPTED, CANCEL_UNKNOWN_GOAL = 0, 2
ALL_GOALS = b64encode(bytes(16)).decode()


class Actions(Providers[ActionGoal]):
    """All actions, with their goals by id in base64; each has a service ``<action>/_action/cancel_goal``."""

    def __init__(self, topics: Graph, clock: Callable[[], float], call_later: CallLater) -> None:
        super().__init__("action", MAX_ACTIONS, topics.message_types, topics.hint, call_later)
        self._services = topics.services
        self._topics = topics
        self._clock = clock
        # By action and goal id, the oldest goal first; without the goals, whose requests may have megabytes.
        self._published: dict[str, dict[str, _PublishedStatus]] = {}

    def offer(
        self,
        node: Node,
        name: str,
        type_name: str,
        start: Callable[[ActionGoal], None],
        limits: ListLimits | None = None,
        *,
        rule: Rule | None = None,
        max_goal_s: float = MAX_GOAL_S,
    ) -> None:
        """Offer an action, in place of another client's; ``start`` gets each goal, and ends it later.

        Without a rule it has a client's. Raises GraphError for an unknown type or a name of the server's.
        """
        offer = self._claim(node, name, type_name, start, max_goal_s, limits)
        self._services.offer(
            node, name + CANCEL_SERVICE, "action_msgs/srv/CancelGoal", lambda request: _cancel(offer, request)
        )
        self._add(offer, rule)
        self._published[name] = {}
        feedback_type = f"{offer.type_name}_FeedbackMessage"
        try:
            self._topics.advertise(node, name + STATUS, STATUS_TYPE, latch=True)
            # A type that is relayed without being known has none.
            if self._message_types.registry.knows(feedback_type):
                self._topics.advertise(node, name + FEEDBACK, feedback_type)
        except GraphError as error:
            # Somebody has made a topic of this name; the action works without.
            log.warning("action %s: its topics are not published: %s", name, error)

    def remove(self, node: Node) -> None:
        """Forget a node that has left: its actions end; its goals go on, as in ROS, unless it takes them along."""
        for goal in self._made.of(node):
            goal.sender_left = True
            if node.takes_goals_along:
                goal.cancel()
        self._withdraw_all(node)

    def send_goal(
        self,
        sender: Node,
        name: str,
        type_name: str,
        arguments: object,
        on_result: Callable[[Result], None],
        on_feedback: Callable[[dict[str, Any]], None] | None = None,
        goal_id: bytes | None = None,
    ) -> ActionGoal | None:
        """Send a goal; return it, or None when it was not taken on.

        ``on_result`` is called once, perhaps before this returns, unless the sender leaves before.
        """
        try:
            offer = self._offer(name, type_name, goal_id)
            request = self._completed(offer, arguments)
        except (GraphError, InterfaceError, MessageError) as error:
            on_result(Result(ok=False, status=GoalStatus.UNKNOWN, values=str(error)))
            return None

        def hear(feedback: dict[str, Any]) -> None:
            if on_feedback is not None and not goal.sender_left:
                on_feedback(feedback)
            self._publish_feedback(offer.node, goal, feedback)

        goal = ActionGoal((name, offer.type_name), request, self._message_types, sender, hear, goal_id)
        limit_s, key = offer.limit_s, goal.info["goal_id"]["uuid"]
        self._keep(goal, offer, key, goal.sender, limit_s, f"Action {goal.action} took more than {limit_s:g} s")
        self._publish_status(offer.node, goal)
        goal.when_canceled(lambda: self._publish_status(offer.node, goal))
        goal.when_ended(lambda _result: self._publish_status(offer.node, goal))
        goal.when_ended(lambda result: None if goal.sender_left else on_result(result))
        try:
            offer.start(goal)
        except Exception as error:  # a bug in an action must not leave its client waiting
            log.exception("action %s failed", goal.action)
            goal.fail(f"Action {goal.action} failed inside the server: {type(error).__name__}: {error}")
        return goal

    def cancel(self, name: str, selected: Callable[[ActionGoal], bool] = lambda _goal: True) -> None:
        """Cancel the selected goals of an action, or all; nothing happens when nobody offers it."""
        offer = self._offers.get(name)
        for goal in list(offer.requests.values()) if offer is not None else ():
            if selected(goal):
                goal.cancel()

    def _offer(self, name: str, type_name: str, goal_id: bytes | None) -> Provider[ActionGoal]:
        offer = self._offers.get(name)
        if offer is None:
            raise GraphError("action", name, self._missing(name))
        if self._message_types.canonical(type_name, "action") != offer.type_name:
            raise GraphError("action", name, f"is of type {offer.type_name}, not {type_name}")
        if goal_id is not None and b64encode(goal_id).decode() in offer.requests:
            raise GraphError("action", name, f"has a goal of the id {goal_id.hex()} already")
        return offer

    def _end_requests(self, offer: Provider[ActionGoal]) -> None:
        self._services.withdraw(offer.node, offer.name + CANCEL_SERVICE)
        super()._end_requests(offer)
        del self._published[offer.name]
        for topic in (STATUS, FEEDBACK):
            self._topics.unadvertise(offer.node, offer.name + topic)

    def _publish_feedback(self, node: Node, goal: ActionGoal, feedback: Mapping[str, Any]) -> None:
        topic = goal.action + FEEDBACK
        if self._is_open(node, topic, f"{goal.type_name}_FeedbackMessage") and self._topics.subscribers(topic):
            message = {"goal_id": goal.info["goal_id"], "feedback": feedback}
            self._topics.publish(node, topic, message, prevalidated=True)

    def _publish_status(self, node: Node, goal: ActionGoal) -> None:
        """Publish the goals of an action as one begins, is asked to end, or has ended."""
        published, now_s = self._published.get(goal.action), self._clock()
        if published is None or not self._is_open(node, goal.action + STATUS, STATUS_TYPE):
            return
        message = {"goal_info": goal.info, "status": int(goal.status)}
        published[goal.info["goal_id"]["uuid"]] = _PublishedStatus(message, now_s if goal.ended else None)
        ended = [(goal_id, each.ended_s) for goal_id, each in published.items() if each.ended_s is not None]
        for place, (goal_id, ended_s) in enumerate(ended):
            # A goal that was never taken on has no status in ROS.
            unknown = published[goal_id].message["status"] == GoalStatus.UNKNOWN
            if unknown or ended_s <= now_s - ENDED_KEPT_S or place < len(ended) - MAX_PUBLISHED:
                del published[goal_id]
        statuses = [each.message for each in list(published.values())[-MAX_PUBLISHED:]]
        self._topics.publish(node, goal.action + STATUS, {"status_list": statuses}, prevalidated=True)

    def _is_open(self, node: Node, topic: str, type_name: str) -> bool:
        """Return True for a topic of the node's action; a client that offers one may have made its own of this name."""
        return self._topics.topic_type(topic) == type_name and node in self._topics.publishers(topic)


def _cancel(offer: Provider[ActionGoal], request: dict[str, Any]) -> dict[str, Any]:
    wanted = request["goal_info"]["goal_id"]["uuid"]
    canceling = {
        goal_id: goal
        for goal_id, goal in offer.requests.items()
        if wanted in (goal_id, ALL_GOALS) and not goal.cancel_requested
    }
    for goal in canceling.values():
        goal.cancel()
    return {
        "return_code": CANCEL_ACCEPTED if canceling or wanted == ALL_GOALS else CANCEL_UNKNOWN_GOAL,
        "goals_canceling": [{"goal_id": {"uuid": goal_id}} for goal_id in canceling],
    }

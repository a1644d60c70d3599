"""Actions of the graph: local parts and remote clients offer them and send goals alike.

A sender gets exactly one result: the provider's, or the reason for which there is none.
"""

from __future__ import annotations

import enum
import logging
import uuid
from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from protocol.errors import InterfaceError, MessageError
from protocol.operations import Mark
from server.errors import GraphError
from server.graph.list_limits import ListLimits
from server.graph.message_types import MessageTypes
from server.graph.node import Node
from server.graph.permissions import Rule
from server.graph.providers import PendingRequest, Provider, Providers
from server.graph.services import Services
from server.timers import CallLater

if TYPE_CHECKING:
    from server.graph.action_topics import ActionTopics


class GoalStatus(enum.IntEnum):
    """Final status of a goal: values of action_msgs/GoalStatus."""

    # The goal was never taken on.
    UNKNOWN = 0
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

    def __init__(
        self,
        names: tuple[str, str],
        request: dict[str, Any],
        message_types: MessageTypes,
        sender: Node,
        on_feedback: Callable[[dict[str, Any]], None] | None = None,
        goal_id: bytes | None = None,
    ) -> None:
        super().__init__()
        self.sender = sender
        self.action, self.type_name = names
        self.request = request
        self.goal_id = goal_id or uuid.uuid4().bytes
        self.sender_id: Mark = None
        self.cancel_requested = False
        self.sender_left = False
        self._message_types = message_types
        self._on_feedback = on_feedback
        self._on_every_feedback: Callable[[dict[str, Any]], None] | None = None
        self._when_canceled: list[Callable[[], None]] = []

    def on_every_feedback(self, callback: Callable[[dict[str, Any]], None]) -> None:
        """Have this called with every complete feedback message, whether its sender wants it or not."""
        self._on_every_feedback = callback

    def feedback(self, values: object) -> None:
        """Tell how the goal goes; what the message leaves out gets its default."""
        completed = self._message_types.complete(f"{self.type_name}_Feedback", values)
        if self.ended:
            return
        if self._on_feedback is not None:
            self._on_feedback(completed)
        if self._on_every_feedback is not None:
            self._on_every_feedback(completed)

    def finish(self, status: GoalStatus, values: object) -> None:
        """End the goal with a result message; what it leaves out gets its default.

        Raises MessageError for values that do not fit: the goal has failed, and its sender knows.
        """
        try:
            completed = self._message_types.complete(f"{self.type_name}_Result", values)
        except MessageError as error:
            self.fail(f"Action {self.action} gave a result that does not fit {self.type_name}: {error}")
            raise
        self._end(Result(ok=True, status=status, values=completed))

    def fail(self, values: object, status: int = GoalStatus.ABORTED) -> None:
        """End the goal without a result message, with a sentence or with what the provider gave."""
        self._end(Result(ok=False, status=status, values=values))

    def _end(self, end: Result) -> None:
        super()._end(end)
        self._when_canceled, self._on_feedback, self._on_every_feedback = [], None, None

    def when_canceled(self, callback: Callable[[], None]) -> None:
        """Have this called when somebody asks for the end of the goal; at once when somebody has."""
        self._when_canceled.append(callback)
        if self.cancel_requested:
            callback()

    def cancel(self) -> None:
        """Ask the provider to end the goal, which still ends as the provider says."""
        if self.cancel_requested or self.ended:
            return
        self.cancel_requested = True
        for callback in self._when_canceled:
            callback()

    def forget_sender(self) -> None:
        """Tell nobody of feedback and result any more, for the one who wanted them has left."""
        self.sender_left = True
        self._on_feedback = None


log = logging.getLogger("armbridge.graph")

# A goal may take long; one whose provider has forgotten it must end nevertheless.
MAX_GOAL_S = 3600.0

# As for topics: far more than any robot has.
MAX_ACTIONS = 1_000

# action_msgs/srv/CancelGoal: what it answers, and the goal id that stands for all goals.
CANCEL_ACCEPTED, CANCEL_UNKNOWN_GOAL = 0, 2
ALL_GOALS = b64encode(bytes(16)).decode()


class Actions(Providers[ActionGoal]):
    """All actions, with their goals by id in base64; each has a service ``<action>/_action/cancel_goal``."""

    def __init__(
        self, message_types: MessageTypes, services: Services, topics: ActionTopics, call_later: CallLater
    ) -> None:
        super().__init__("action", MAX_ACTIONS, message_types, call_later)
        self._services = services
        self._topics = topics

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
            node, _cancel_service(name), "action_msgs/srv/CancelGoal", lambda request: _cancel(offer, request)
        )
        self._add(offer, rule)
        self._topics.open(node, name, offer.type_name)

    def remove(self, node: Node) -> None:
        """Forget a node that has left: its actions end; its goals go on, as in ROS, unless it takes them along."""
        for goal in self._made.of(node):
            goal.forget_sender()
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
        goal = ActionGoal((name, offer.type_name), request, self._message_types, sender, on_feedback, goal_id)
        limit_s, key = offer.limit_s, b64encode(goal.goal_id).decode()
        self._keep(goal, offer, key, goal.sender, limit_s, f"Action {goal.action} took more than {limit_s:g} s")
        self._topics.follow(offer.node, goal)
        goal.when_ended(lambda result: None if goal.sender_left else on_result(result))
        try:
            offer.start(goal)
        except Exception as error:  # a bug in an action must not leave its client waiting
            log.exception("action %s failed", goal.action)
            goal.fail(f"Action {goal.action} failed inside the server: {type(error).__name__}: {error}")
        return goal

    def cancel_left_behind(self, name: str, sender_id: Mark) -> None:
        """Cancel the goals of an action with this mark whose senders have left."""
        offer = self._offers.get(name)
        for goal in list(offer.requests.values()) if offer is not None else ():
            if goal.sender_left and goal.sender_id == sender_id:
                goal.cancel()

    def _offer(self, name: str, type_name: str, goal_id: bytes | None) -> Provider[ActionGoal]:
        offer = self._offers.get(name)
        if offer is None:
            raise GraphError("action", name, "does not exist")
        if self._message_types.canonical(type_name, "action") != offer.type_name:
            raise GraphError("action", name, f"is of type {offer.type_name}, not {type_name}")
        if goal_id is not None and b64encode(goal_id).decode() in offer.requests:
            raise GraphError("action", name, f"has a goal of the id {goal_id.hex()} already")
        return offer

    def _end_requests(self, offer: Provider[ActionGoal]) -> None:
        self._services.withdraw(offer.node, _cancel_service(offer.name))
        super()._end_requests(offer)
        self._topics.close(offer.node, offer.name)


def _cancel_service(action: str) -> str:
    return f"{action}/_action/cancel_goal"


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

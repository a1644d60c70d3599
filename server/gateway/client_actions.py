"""The actions of one client: those that it offers, and the goals that it sends to others'."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from typing import Any

from protocol.errors import NothingToDoError, OperationError
from protocol.limits import Limits
from protocol.names import qualify
from protocol.operations import (
    ActionFeedback,
    ActionResult,
    AdvertiseAction,
    CancelActionGoal,
    Operation,
    SendActionGoal,
    UnadvertiseAction,
)
from protocol.session import with_id
from server.gateway.client_status import Tell
from server.gateway.spelling import Spelling
from server.graph.actions import Actions, Goal, GoalStatus, Result
from server.graph.node import Node

# rosbridge_library (capabilities/advertise_action.py) takes every other status for an aborted goal.
_TOLD_STATUSES = (GoalStatus.SUCCEEDED, GoalStatus.CANCELED)


class ClientActions:
    """Carries a client's operations on actions out.

    Args:
        node: the client.
        actions: where actions are offered and goals sent.
        spelling: how the client spells messages.
        limits: what it may cost.
        send: sends the client an operation, which is never dropped.
        ask: sends the client a goal, if there is room for it, and says whether there was.
        send_feedback: sends an operation that may be dropped when the client reads too slowly.
        tell: tells the client something about one of its operations.
    """

    def __init__(
        self,
        node: Node,
        actions: Actions,
        spelling: Spelling,
        limits: Limits,
        send: Callable[[dict[str, Any]], None],
        ask: Callable[[dict[str, Any]], bool],
        send_feedback: Callable[[dict[str, Any]], None],
        tell: Tell,
    ) -> None:
        self._node = node
        self._actions = actions
        self._spelling = spelling
        self._limits = limits
        self._send = send
        self._ask_client = ask
        self._tell = tell
        self._send_feedback = send_feedback
        self._offered: set[str] = set()
        # Goals that the client is to reach, by the ids that it got, none of which is ever given twice.
        self._asked: dict[str | int | None, Goal] = {}
        self._numbers = itertools.count(1)
        # Goals that the client has sent: action and the client's id.
        self._sent: dict[Goal, tuple[str, str | int | None]] = {}

    @property
    def handlers(self) -> Mapping[type[Operation], Callable[..., None]]:
        """What carries which operation out."""
        return {
            SendActionGoal: self._send_goal,
            CancelActionGoal: self._cancel,
            AdvertiseAction: self._advertise,
            UnadvertiseAction: self._unadvertise,
            ActionFeedback: self._tell_feedback,
            ActionResult: self._finish,
        }

    # As a provider.

    def _advertise(self, operation: AdvertiseAction) -> None:
        name, limit = qualify(operation.action), self._limits.max_offers
        if name not in self._offered and len(self._offered) >= limit:
            raise OperationError(operation.op, None, f"this client has {len(self._offered)}, the limit is {limit}")
        self._spelling.learn(operation.type, "action")
        former = self._actions.provider(name)
        self._actions.offer(self._node, name, operation.type, lambda goal: self._ask(operation, goal))
        self._offered.add(name)
        if former not in (None, self._node):
            self._tell("warning", operation, f"action {operation.action}: takes the place of another client's")

    def _unadvertise(self, operation: UnadvertiseAction) -> None:
        name = qualify(operation.action)
        if name not in self._offered:
            raise NothingToDoError(operation.op, None, f"action {operation.action}: this client does not offer it")
        self._actions.withdraw(self._node, name)
        self._offered.remove(name)

    def _ask(self, offer: AdvertiseAction, goal: Goal) -> None:
        mark = f"action_goal:{offer.action}:{next(self._numbers)}"
        self._asked[mark] = goal
        goal.when_ended(lambda _result: self._asked.pop(mark))
        fields = {
            "op": "send_action_goal",
            "id": mark,
            "action": offer.action,
            "action_type": offer.type,
            "args": self._spelling.to_client(f"{goal.type_name}_Goal", goal.request),
            "feedback": True,
        }
        if not self._ask_client(fields):
            goal.fail(f"Action {goal.action}: its provider does not read its goals quickly enough", GoalStatus.UNKNOWN)
            return
        goal.when_canceled(lambda: self._send({"op": "cancel_action_goal", "id": mark, "action": offer.action}))

    def _tell_feedback(self, operation: ActionFeedback) -> None:
        goal = self._goal(operation)
        goal.feedback(self._spelling.from_client(f"{goal.type_name}_Feedback", operation.values))

    def _finish(self, operation: ActionResult) -> None:
        goal = self._goal(operation)
        if operation.result:
            status = GoalStatus(operation.status) if operation.status in _TOLD_STATUSES else GoalStatus.ABORTED
            values = {} if operation.values is None else operation.values
            goal.finish(status, self._spelling.from_client(f"{goal.type_name}_Result", values))
        else:
            values = f"Action {goal.action} failed" if operation.values is None else operation.values
            goal.fail(values, operation.status)

    def _goal(self, operation: ActionFeedback | ActionResult) -> Goal:
        goal = self._asked.get(operation.id)
        if goal is None:
            raise OperationError(operation.op, "id", "no goal of this id is on its way")
        return goal

    def fail(self, mark: str | int | None, problem: str) -> None:
        """End the goal of this id, if there is one, whose result cannot be read."""
        goal = self._asked.get(mark)
        if goal is not None:
            goal.fail(f"Action {goal.action} gave a result that cannot be read: {problem}")

    # As a sender.

    def _send_goal(self, operation: SendActionGoal) -> None:
        self._spelling.learn(operation.action_type, "action")
        name = qualify(operation.action)
        type_name = self._actions.type_of(name)

        def on_result(result: Result) -> None:
            values = self._spelling.to_client(f"{type_name}_Result", result.values) if result.ok else result.values
            fields = {"op": "action_result", "action": operation.action, "values": values, "status": int(result.status)}
            self._send(with_id({**fields, "result": result.ok}, operation.id))

        def on_feedback(message: dict[str, Any]) -> None:
            values = self._spelling.to_client(f"{type_name}_Feedback", message)
            fields = {"op": "action_feedback", "action": operation.action, "values": values}
            self._send_feedback(with_id(fields, operation.id))

        if len(self._sent) >= self._limits.max_calls_in_flight:
            problem = f"{len(self._sent)} goals of this client are on their way, which is the limit"
            on_result(Result(ok=False, status=GoalStatus.UNKNOWN, values=problem))
            return
        arguments = self._spelling.from_client(f"{type_name}_Goal", operation.args)
        listener = on_feedback if operation.feedback else None
        goal = self._actions.send_goal(self._node, name, operation.action_type, arguments, on_result, listener)
        if goal is not None and not goal.ended:
            self._sent[goal] = name, operation.id
            goal.when_ended(lambda _result: self._sent.pop(goal))

    def turn_away(self, operation: SendActionGoal, problem: str) -> None:
        """Answer a goal that the client may not send."""
        fields = {"op": "action_result", "action": operation.action, "values": problem, "result": False}
        self._send(with_id({**fields, "status": int(GoalStatus.UNKNOWN)}, operation.id))

    def _cancel(self, operation: CancelActionGoal) -> None:
        """Cancel the goal of this id; one that is unknown has most likely just ended."""
        wanted = qualify(operation.action), operation.id
        for goal in [goal for goal, sent in self._sent.items() if sent == wanted]:
            goal.cancel()

"""Actions of one client: those that it offers, and the goals that it sends to others' actions."""

from __future__ import annotations

import itertools
from typing import Any

from protocol.errors import NothingToDoError, OperationError
from protocol.operations import (
    ActionFeedback,
    ActionResult,
    AdvertiseAction,
    CancelActionGoal,
    Mark,
    SendActionGoal,
    UnadvertiseAction,
    qualify,
)
from protocol.session import with_id
from server.gateway.client_context import MAX_VALUES_IN_FLIGHT, VALUES_LIMIT, ClientContext
from server.graph.actions import Goal, GoalStatus, Result
from server.graph.message_types import ReceivedMessage

# rosbridge_library (capabilities/advertise_action.py) takes every other status for an aborted goal.
_PASSED_STATUSES = (GoalStatus.SUCCEEDED, GoalStatus.CANCELED)


class ClientActions:
    """Actions that one client offers, and the goals that it sends to others' actions."""

    def __init__(self, context: ClientContext) -> None:
        self._client = context
        self._node = context.node
        self._actions = context.graph.actions
        self._limits = context.session.limits
        self._offered: set[str] = set()
        # Goals that the client is to reach, by the ids that it got; no id is given twice.
        self._requested: dict[Mark, Goal] = {}
        self._numbers = itertools.count(1)
        # Goals that the client has sent: action and the client's id.
        self._sent: dict[Goal, tuple[str, Mark]] = {}
        self._values_in_flight = 0

    # As a provider.

    def advertise(self, operation: AdvertiseAction) -> None:
        """Offer an action."""
        name, limit = qualify(operation.action), self._limits.max_offers
        if name not in self._offered and len(self._offered) >= limit:
            raise OperationError(operation.op, None, f"this client has {len(self._offered)}, the limit is {limit}")
        self._client.translator.detect_dialect(operation.type, "action")
        former = self._actions.provider(name)
        self._actions.offer(self._node, name, operation.type, lambda goal: self._request(operation, goal))
        self._offered.add(name)
        if former not in (None, self._node):
            self._client.status.tell(
                "warning", operation, f"action {operation.action}: takes the place of another client's"
            )

    def unadvertise(self, operation: UnadvertiseAction) -> None:
        """Withdraw an action."""
        name = qualify(operation.action)
        if name not in self._offered:
            raise NothingToDoError(operation.op, None, f"action {operation.action}: this client does not offer it")
        self._actions.withdraw(self._node, name)
        self._offered.remove(name)

    def _request(self, offer: AdvertiseAction, goal: Goal) -> None:
        id_ = f"action_goal:{offer.action}:{next(self._numbers)}"
        self._requested[id_] = goal
        goal.when_ended(lambda _result: self._requested.pop(id_))
        fields = {
            "op": "send_action_goal",
            "id": id_,
            "action": offer.action,
            "action_type": offer.type,
            "args": goal.request,
            "feedback": True,
        }
        if not self._client.send_request(fields, f"{goal.type_name}_Goal"):
            goal.fail(f"Action {goal.action}: its provider does not read its goals quickly enough", GoalStatus.UNKNOWN)
            return
        goal.when_canceled(lambda: self._client.send({"op": "cancel_action_goal", "id": id_, "action": offer.action}))

    def report_feedback(self, operation: ActionFeedback, message: ReceivedMessage) -> None:
        """Pass feedback on a goal of the client on to its sender."""
        self._goal(operation).feedback(self._client.translator.from_client(message))

    def finish(self, operation: ActionResult, message: ReceivedMessage) -> None:
        """End a goal of the client with its result."""
        goal = self._goal(operation)
        if operation.result:
            status = GoalStatus(operation.status) if operation.status in _PASSED_STATUSES else GoalStatus.ABORTED
            goal.finish(status, self._client.translator.from_client(message))
        else:
            values = f"Action {goal.action} failed" if operation.values is None else operation.values
            goal.fail(values, operation.status)

    def _goal(self, operation: ActionFeedback | ActionResult) -> Goal:
        goal = self._requested.get(operation.id)
        if goal is None:
            raise OperationError(operation.op, "id", "no goal of this id is on its way")
        return goal

    def fail(self, id_: Mark, problem: str) -> None:
        """End the goal of this id, if there is one, whose result cannot be read."""
        goal = self._requested.get(id_)
        if goal is not None:
            goal.fail(f"Action {goal.action} gave a result that cannot be read: {problem}")

    # As a sender.

    def send_goal(self, operation: SendActionGoal, message: ReceivedMessage) -> None:
        """Send a goal."""
        self._client.translator.detect_dialect(operation.action_type, "action")
        name = qualify(operation.action)
        type_name = self._actions.type_of(name)

        def on_result(result: Result) -> None:
            fields = {
                "op": "action_result",
                "action": operation.action,
                "values": result.values,
                "status": int(result.status),
                "result": result.ok,
            }
            message_type = f"{type_name}_Result" if result.ok else ""
            self._client.send_message(with_id(fields, operation.id), "values", message_type)

        def on_feedback(feedback: dict[str, Any]) -> None:
            fields = {"op": "action_feedback", "action": operation.action, "values": feedback}
            self._client.send_feedback(with_id(fields, operation.id), f"{type_name}_Feedback")

        if len(self._sent) >= self._limits.max_calls_in_flight:
            problem = f"{len(self._sent)} goals of this client are on their way, which is the limit"
            on_result(Result(ok=False, status=GoalStatus.UNKNOWN, values=problem))
            return
        if self._values_in_flight >= MAX_VALUES_IN_FLIGHT:
            problem = f"goals of this client with {self._values_in_flight} values are on their way, {VALUES_LIMIT}"
            on_result(Result(ok=False, status=GoalStatus.UNKNOWN, values=problem))
            return
        arguments = self._client.translator.from_client(message)
        listener = on_feedback if operation.feedback else None
        goal = self._actions.send_goal(self._node, name, operation.action_type, arguments, on_result, listener)
        if goal is not None and not goal.ended:
            goal.sender_id = operation.id
            self._sent[goal] = name, operation.id
            self._values_in_flight += message.values
            goal.when_ended(lambda _result: self._forget(goal, message.values))

    def _forget(self, goal: Goal, values: int) -> None:
        del self._sent[goal]
        self._values_in_flight -= values

    def reject(self, operation: SendActionGoal, problem: str) -> None:
        """Answer a goal that the client may not send."""
        self.reject_goal(operation.action, operation.id, problem)

    def reject_goal(self, action: str, id_: Mark, problem: str) -> None:
        """Answer a goal that is not sent; ``action`` is as the client spells it."""
        status = int(GoalStatus.UNKNOWN)
        fields = {"op": "action_result", "action": action, "values": problem, "status": status, "result": False}
        self._client.send(with_id(fields, id_))

    def cancel(self, operation: CancelActionGoal) -> None:
        """Cancel the goal of this id; an unknown goal has most likely just ended.

        A client that connects for each request, as ros-mcp does, cancels goals of its former connections. In
        rosbridge_library (capabilities/send_action_goal.py) all clients share one table of goals.
        """
        wanted = name, id_ = qualify(operation.action), operation.id
        own = [goal for goal, sent in self._sent.items() if sent == wanted]
        for goal in own:
            goal.cancel()
        if not own and id_ is not None:
            self._actions.cancel_left_behind(name, id_)

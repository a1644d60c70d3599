"""Services and actions of one client: its offers, and its calls and goals to other providers."""

import itertools
from collections.abc import Callable
from typing import Any, Generic, Literal

from protocol import operations as ops
from protocol.errors import NothingToDoError, OperationError
from protocol.operations import Operation, OperationId, qualify
from protocol.session import with_id
from server.gateway.client_context import MAX_VALUES_IN_FLIGHT, ClientContext
from server.graph.actions import ActionGoal, Actions, GoalStatus, Result
from server.graph.message_types import ReceivedMessage
from server.graph.permissions import WORKING, Role
from server.graph.providers import AnyRequest
from server.graph.services import Call, Response, Services

# Calls of services that plan which wait for their responses, by the client's role: a planner takes them one by one,
# each for up to seconds.
MAX_PLANNING_CALLS = {Role.VIEW: 16, Role.PROPOSE: 16, Role.OPERATE: 64, Role.ADMIN: 64}

# rosbridge_library (capabilities/advertise_action.py) takes every other status for an aborted goal.
_PASSED_STATUSES = (GoalStatus.SUCCEEDED, GoalStatus.CANCELED)


class _Requests(Generic[AnyRequest]):
    """Services or actions that a client offers, the requests to them, and the client's own requests to others."""

    def __init__(self, context: ClientContext, kind: Literal["service", "action"], offers: Services | Actions) -> None:
        self._client = context
        self._node = context.node
        self._limits = context.session.limits
        self._kind = kind
        self._offers = offers
        self._offered: set[str] = set()
        # Requests that the client has to answer, by the ids that it got. No id is given twice, so that no late answer
        # ends another request.
        self._requested: dict[OperationId, AnyRequest] = {}
        self._numbers = itertools.count(1)
        self._values_in_flight = 0

    def _advertise(self, operation: Operation, spelled: str, offer: Callable[[str], None]) -> None:
        name, limit = qualify(spelled), self._limits.max_offers
        if name not in self._offered and len(self._offered) >= limit:
            raise OperationError(operation.op, None, f"this client has {len(self._offered)}, the limit is {limit}")
        former = self._offers.provider(name)
        offer(name)
        self._offered.add(name)
        if former not in (None, self._node):
            text = f"{self._kind} {spelled}: takes the place of another client's"
            self._client.status.report("warning", operation, text)

    def _withdraw(self, operation: Operation, spelled: str) -> None:
        name = qualify(spelled)
        if name not in self._offered:
            raise NothingToDoError(operation.op, None, f"{self._kind} {spelled}: this client does not offer it")
        self._offers.withdraw(self._node, name)
        self._offered.remove(name)

    def _expect_answer(self, request: AnyRequest, prefix: str, spelled: str) -> str:
        """Give a request, which the client is to answer, its id."""
        id_ = f"{prefix}:{spelled}:{next(self._numbers)}"
        self._requested[id_] = request
        request.when_ended(lambda _end: self._requested.pop(id_))
        return id_

    def _waiting(self, operation: Operation) -> AnyRequest:
        request = self._requested.get(operation.id)
        if request is None:
            raise OperationError(operation.op, "id", "no request of this id waits for an answer")
        return request

    def fail(self, id_: OperationId, problem: str) -> None:
        """End the request of this id, if there is one, whose answer cannot be read."""
        request = self._requested.get(id_)
        if request is not None:
            request.fail(f"{request.title} gave a {request.answered.lower()} that cannot be read: {problem}")

    def _limit(self, count: int, requests: str) -> str | None:
        """Return the limit at which no further request of this client is taken on; None below it."""
        if count >= self._limits.max_calls_in_flight:
            return f"{count} {requests} of this client wait, which is the limit"
        if self._values_in_flight >= MAX_VALUES_IN_FLIGHT:
            values = f"{self._values_in_flight} values wait, the limit is {MAX_VALUES_IN_FLIGHT}"
            return f"{requests} of this client with {values}"
        return None


class ClientServices(_Requests[Call]):
    """Services that one client offers, and its calls of others' services."""

    def __init__(self, context: ClientContext) -> None:
        self._services = context.graph.services
        super().__init__(context, "service", self._services)
        self._calls_in_flight = 0
        self._planning_calls = 0

    def advertise(self, operation: ops.AdvertiseService) -> None:
        def start(call: Call) -> None:
            id_ = self._expect_answer(call, "service_request", operation.service)
            fields = {"op": "call_service", "id": id_, "service": operation.service, "args": call.request}
            if not self._client.send_request(fields, f"{call.type_name}_Request"):
                call.fail(f"{call.title}: its provider does not read its calls quickly enough")

        timeout_s, services = self._limits.call_timeout_s, self._services
        self._advertise(
            operation,
            operation.service,
            lambda name: services.offer_calls(self._node, name, operation.type, start, timeout_s, limits=None),
        )

    def unadvertise(self, operation: ops.UnadvertiseService) -> None:
        self._withdraw(operation, operation.service)

    def respond(self, operation: ops.ServiceResponse, message: ReceivedMessage) -> None:
        call = self._waiting(operation)
        # rosbridge_library passes on any values that are an object, whatever `result` says (service_response.py).
        if operation.result or isinstance(operation.values, dict):
            call.succeed(message)
        else:
            call.fail(f"{call.title} failed" if operation.values is None else operation.values)

    def reject_call(self, service: str, id_: OperationId, problem: str) -> None:
        """Answer a call that is not made; ``service`` is as the client spells it."""
        self._answer(service, id_, Response(ok=False, values=problem))

    def _answer(self, service: str, id_: OperationId, response: Response, type_name: str | None = None) -> None:
        fields = {"op": "service_response", "service": service, "values": response.values, "result": response.ok}
        self._client.send_message(with_id(fields, id_), "values", f"{type_name}_Response" if response.ok else "")

    def call(self, operation: ops.CallService, message: ReceivedMessage) -> None:
        """Call a service, or raise PostponedError while its request is completed in the background."""
        name, id_ = name_and_id(operation)
        type_name, plans = self._services.names.type_of(name), self._services.rules.get(name, WORKING).plans

        def answer(response: Response) -> None:
            if response.reason:
                self._client.status.report("error", operation, f"service {operation.service}: {response.reason}")
            self._answer(operation.service, id_, response, type_name)

        if (problem := self._problem(plans=plans)) is not None:
            self.reject_call(operation.service, id_, problem)
            return
        spelling = self._client.session.dialect
        call = self._services.call(self._node, name, message, answer, operation.timeout, spelling)
        if call is None or call.ended:
            return
        self._calls_in_flight += 1
        self._planning_calls += plans
        self._values_in_flight += message.values

        def forget(_response: Response) -> None:
            self._calls_in_flight -= 1
            self._planning_calls -= plans
            self._values_in_flight -= message.values

        call.when_ended(forget)

    def call_unanswered(self, operation: ops.CallService) -> None:
        """Call a service whose response the client has already."""
        name, _ = name_and_id(operation)
        self._services.call(self._node, name, operation.args, lambda _response: None, operation.timeout)

    def _problem(self, *, plans: bool) -> str | None:
        """Return the limit at which one more call is not made; None below all limits."""
        identity = self._node.identity
        limit = MAX_PLANNING_CALLS[Role.VIEW if identity is None else identity.role]
        if plans and self._planning_calls >= limit:
            return f"{self._planning_calls} calls of this client that plan wait, the limit of its role is {limit}"
        return self._limit(self._calls_in_flight, "calls")


def name_and_id(operation: ops.CallService) -> tuple[str, OperationId]:
    """Return the qualified name of a called service, and the id of the call."""
    # `/svc#7` is how rosbridge's first clients gave the id.
    service, _, id_in_name = operation.service.partition("#")
    return qualify(service), operation.id if operation.id is not None else id_in_name or None


class ClientActions(_Requests[ActionGoal]):
    """Actions that one client offers, and the goals that it sends to others' actions."""

    def __init__(self, context: ClientContext) -> None:
        self._actions = context.graph.actions
        super().__init__(context, "action", self._actions)
        # Goals that the client has sent: action and the client's id.
        self._sent: dict[ActionGoal, tuple[str, OperationId]] = {}

    def advertise(self, operation: ops.AdvertiseAction) -> None:
        action = operation.action

        def start(goal: ActionGoal) -> None:
            id_ = self._expect_answer(goal, "action_goal", action)
            fields = {"op": "send_action_goal", "id": id_, "action": action, "action_type": operation.type}
            if not self._client.send_request(
                fields | {"args": goal.request, "feedback": True}, f"{goal.type_name}_Goal"
            ):
                goal.fail(f"{goal.title}: its provider does not read its goals quickly enough", GoalStatus.UNKNOWN)
                return
            goal.when_canceled(lambda: self._client.send({"op": "cancel_action_goal", "id": id_, "action": action}))

        actions, node = self._actions, self._node
        self._advertise(operation, action, lambda name: actions.offer(node, name, operation.type, start))

    def unadvertise(self, operation: ops.UnadvertiseAction) -> None:
        self._withdraw(operation, operation.action)

    def report_feedback(self, operation: ops.ActionFeedback, message: ReceivedMessage) -> None:
        self._waiting(operation).feedback(message)

    def finish(self, operation: ops.ActionResult, message: ReceivedMessage) -> None:
        goal = self._waiting(operation)
        if operation.result:
            status = GoalStatus(operation.status) if operation.status in _PASSED_STATUSES else GoalStatus.ABORTED
            goal.finish(status, message)
        else:
            goal.fail(f"{goal.title} failed" if operation.values is None else operation.values, operation.status)

    def send_goal(self, operation: ops.SendActionGoal, message: ReceivedMessage) -> None:
        name = qualify(operation.action)
        type_name = self._actions.names.type_of(name)

        def on_result(result: Result) -> None:
            self._answer(operation.action, operation.id, result, type_name)

        def on_feedback(feedback: dict[str, Any]) -> None:
            fields = {"op": "action_feedback", "action": operation.action, "values": feedback}
            self._client.send_feedback(with_id(fields, operation.id), f"{type_name}_Feedback")

        if (problem := self._limit(len(self._sent), "goals")) is not None:
            self.reject_goal(operation.action, operation.id, problem)
            return
        listener = on_feedback if operation.feedback else None
        goal = self._actions.send_goal(self._node, name, operation.action_type, message, on_result, listener)
        if goal is not None and not goal.ended:
            goal.sender_id = operation.id
            self._sent[goal] = name, operation.id
            self._values_in_flight += message.values

            def forget(_result: Result) -> None:
                del self._sent[goal]
                self._values_in_flight -= message.values

            goal.when_ended(forget)

    def reject_goal(self, action: str, id_: OperationId, problem: str) -> None:
        """Answer a goal that is not sent; ``action`` is as the client spells it."""
        self._answer(action, id_, Result(ok=False, status=GoalStatus.UNKNOWN, values=problem))

    def _answer(self, action: str, id_: OperationId, result: Result, type_name: str | None = None) -> None:
        fields = {"op": "action_result", "action": action, "values": result.values}
        fields |= {"status": int(result.status), "result": result.ok}
        self._client.send_message(with_id(fields, id_), "values", f"{type_name}_Result" if result.ok else "")

    def cancel(self, operation: ops.CancelActionGoal) -> None:
        """Cancel the goal of this id; an unknown goal has most likely just ended.

        A client that connects for each request, as ros-mcp does, cancels goals of its former connections. In
        rosbridge_library (capabilities/send_action_goal.py) all clients share one table of goals.
        """
        wanted = name, id_ = qualify(operation.action), operation.id
        own = [goal for goal, sent in self._sent.items() if sent == wanted]
        for goal in own:
            goal.cancel()
        if not own and id_ is not None:
            self._actions.cancel(name, lambda goal: goal.sender_left and goal.sender_id == id_)

"""Services of one client: those that it offers, and its calls of others' services."""

from __future__ import annotations

import itertools

from protocol.errors import NothingToDoError, OperationError
from protocol.operations import AdvertiseService, CallService, Mark, ServiceResponse, UnadvertiseService, qualify
from protocol.session import with_id
from server.gateway.client_context import MAX_VALUES_IN_FLIGHT, VALUES_LIMIT, ClientContext
from server.graph.message_types import PostponedError, ReceivedMessage
from server.graph.permissions import WORKING, Role
from server.graph.services import Call, Response

# Calls of services that plan which wait for their responses, by the client's role: a planner takes them one by one,
# each for up to seconds.
MAX_PLANNING_CALLS = {Role.VIEW: 16, Role.PROPOSE: 16, Role.OPERATE: 64, Role.ADMIN: 64}


class ClientServices:
    """Services that one client offers, and its calls of others' services."""

    def __init__(self, context: ClientContext) -> None:
        self._client = context
        self._node = context.node
        self._services = context.graph.services
        self._limits = context.session.limits
        self._offered: set[str] = set()
        # Calls that the client is to answer, by the ids that it got; no id is ever given twice, so that no late
        # response is taken for another call's.
        self._requested: dict[Mark, Call] = {}
        self._numbers = itertools.count(1)
        self._calls_in_flight = 0
        self._planning_calls = 0
        self._values_in_flight = 0

    # As a provider.

    def advertise(self, operation: AdvertiseService) -> None:
        """Offer a service."""
        name, limit = qualify(operation.service), self._limits.max_offers
        if name not in self._offered and len(self._offered) >= limit:
            raise OperationError(operation.op, None, f"this client has {len(self._offered)}, the limit is {limit}")
        self._client.translator.detect_dialect(operation.type, "srv")
        former = self._services.provider(name)
        self._services.offer_calls(
            self._node,
            name,
            operation.type,
            lambda call: self._request(operation.service, call),
            self._limits.call_timeout_s,
            limits=None,
        )
        self._offered.add(name)
        if former not in (None, self._node):
            self._client.status.tell(
                "warning", operation, f"service {operation.service}: takes the place of another client's"
            )

    def unadvertise(self, operation: UnadvertiseService) -> None:
        """Withdraw a service."""
        name = qualify(operation.service)
        if name not in self._offered:
            raise NothingToDoError(operation.op, None, f"service {operation.service}: this client does not offer it")
        self._services.withdraw(self._node, name)
        self._offered.remove(name)

    def _request(self, spelled_service: str, call: Call) -> None:
        id_ = f"service_request:{spelled_service}:{next(self._numbers)}"
        self._requested[id_] = call
        call.when_ended(lambda _response: self._requested.pop(id_))
        fields = {"op": "call_service", "id": id_, "service": spelled_service, "args": call.request}
        if not self._client.send_request(fields, f"{call.type_name}_Request"):
            call.fail(f"Service {call.service}: its provider does not read its calls quickly enough")

    def respond(self, operation: ServiceResponse, message: ReceivedMessage) -> None:
        """Answer a call that the client got."""
        call = self._requested.get(operation.id)
        if call is None:
            raise OperationError(operation.op, "id", "no call of this id waits for a response")
        # rosbridge_library passes on any values that are an object, whatever `result` says (service_response.py).
        if operation.result or isinstance(operation.values, dict):
            call.succeed(self._client.translator.from_client(message))
        else:
            call.fail(f"Service {call.service} failed" if operation.values is None else operation.values)

    def fail(self, id_: Mark, problem: str) -> None:
        """End the call of this id, if there is one, whose response cannot be read."""
        call = self._requested.get(id_)
        if call is not None:
            call.fail(f"Service {call.service} gave a response that cannot be read: {problem}")

    # As a caller.

    def reject(self, operation: CallService, problem: str) -> None:
        """Answer a call that the client may not make."""
        _, id_ = _name_and_id(operation)
        self.reject_call(operation.service, id_, problem)

    def reject_call(self, service: str, id_: Mark, problem: str) -> None:
        """Answer a call that is not made; ``service`` is as the client spells it."""
        fields = {"op": "service_response", "service": service, "values": problem, "result": False}
        self._client.send(with_id(fields, id_))

    def call(self, operation: CallService, message: ReceivedMessage) -> None:
        """Call a service, or raise PostponedError while its request is to be completed in the background."""
        name, id_ = _name_and_id(operation)
        self._client.translator.detect_dialect(operation.type, "srv")
        type_name, plans = self._services.type_of(name), self._services.rules.get(name, WORKING).plans

        def answer(response: Response) -> None:
            fields = {
                "op": "service_response",
                "service": operation.service,
                "values": response.values,
                "result": response.ok,
            }
            self._client.send_message(with_id(fields, id_), "values", f"{type_name}_Response" if response.ok else "")

        values, ended = 0, False

        def end(response: Response) -> None:
            nonlocal ended
            ended = True
            self._calls_in_flight -= 1
            self._planning_calls -= plans
            self._values_in_flight -= values
            if response.reason:
                self._client.status.tell("error", operation, f"service {operation.service}: {response.reason}")
            answer(response)

        if self._calls_in_flight >= self._limits.max_calls_in_flight:
            answer(Response(ok=False, values=f"{self._calls_in_flight} calls of this client wait, which is the limit"))
            return
        if self._values_in_flight >= MAX_VALUES_IN_FLIGHT:
            problem = f"calls of this client with {self._values_in_flight} values wait, {VALUES_LIMIT}"
            answer(Response(ok=False, values=problem))
            return
        if plans and self._planning_calls >= (limit := self._max_planning_calls()):
            problem = f"{self._planning_calls} calls of this client that plan wait, the limit of its role is {limit}"
            answer(Response(ok=False, values=problem))
            return
        self._calls_in_flight += 1
        self._planning_calls += plans
        arguments, spelling = self._client.translator.from_client(message), self._client.translator.dialect
        try:
            self._services.call(self._node, name, arguments, end, operation.timeout, spelling)
        except PostponedError:
            self._calls_in_flight -= 1
            self._planning_calls -= plans
            raise
        if not ended:
            values = message.values
            self._values_in_flight += values

    def call_unanswered(self, operation: CallService) -> None:
        """Call a service whose response the client has already."""
        name, _ = _name_and_id(operation)
        self._services.call(self._node, name, operation.args, lambda _response: None, operation.timeout)

    def _max_planning_calls(self) -> int:
        identity = self._node.identity
        return MAX_PLANNING_CALLS[Role.VIEW if identity is None else identity.role]


def _name_and_id(operation: CallService) -> tuple[str, Mark]:
    # `/svc#7` is how rosbridge's first clients gave the id.
    service, _, id_in_name = operation.service.partition("#")
    return qualify(service), operation.id if operation.id is not None else id_in_name or None

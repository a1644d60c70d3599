"""The services of one client: those that it offers, and its calls of others'."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from typing import Any

from protocol.errors import NothingToDoError, OperationError
from protocol.limits import Limits
from protocol.names import qualify
from protocol.operations import AdvertiseService, CallService, Operation, ServiceResponse, UnadvertiseService
from protocol.session import with_id
from server.gateway.client_status import Tell
from server.gateway.spelling import Spelling
from server.graph.node import Node
from server.graph.services import Call, Response, Services


class ClientServices:
    """Carries a client's operations on services out.

    Args:
        node: the client.
        services: where services are offered and called.
        spelling: how the client spells messages.
        limits: what it may cost.
        send: sends the client an operation, which is never dropped.
        ask: sends the client a call, if there is room for it, and says whether there was.
        tell: tells the client something about one of its operations.
    """

    def __init__(
        self,
        node: Node,
        services: Services,
        spelling: Spelling,
        limits: Limits,
        send: Callable[[dict[str, Any]], None],
        ask: Callable[[dict[str, Any]], bool],
        tell: Tell,
    ) -> None:
        self._node = node
        self._services = services
        self._spelling = spelling
        self._limits = limits
        self._send = send
        self._ask_client = ask
        self._tell = tell
        self._offered: set[str] = set()
        # Calls that the client is to answer, by the ids that it got; no id is ever given twice, so that no late
        # response is taken for another call's.
        self._asked: dict[str | int | None, Call] = {}
        self._numbers = itertools.count(1)
        self._calls_in_flight = 0

    @property
    def handlers(self) -> Mapping[type[Operation], Callable[..., None]]:
        """What carries which operation out."""
        return {
            CallService: self._call,
            AdvertiseService: self._advertise,
            UnadvertiseService: self._unadvertise,
            ServiceResponse: self._respond,
        }

    # As a provider.

    def _advertise(self, operation: AdvertiseService) -> None:
        name, limit = qualify(operation.service), self._limits.max_offers
        if name not in self._offered and len(self._offered) >= limit:
            raise OperationError(operation.op, None, f"this client has {len(self._offered)}, the limit is {limit}")
        self._spelling.learn(operation.type, "srv")
        former = self._services.provider(name)
        self._services.offer_calls(
            self._node,
            name,
            operation.type,
            lambda call: self._ask(operation.service, call),
            self._limits.call_timeout_s,
        )
        self._offered.add(name)
        if former not in (None, self._node):
            self._tell("warning", operation, f"service {operation.service}: takes the place of another client's")

    def _unadvertise(self, operation: UnadvertiseService) -> None:
        name = qualify(operation.service)
        if name not in self._offered:
            raise NothingToDoError(operation.op, None, f"service {operation.service}: this client does not offer it")
        self._services.withdraw(self._node, name)
        self._offered.remove(name)

    def _ask(self, spelled_service: str, call: Call) -> None:
        mark = f"service_request:{spelled_service}:{next(self._numbers)}"
        self._asked[mark] = call
        call.when_ended(lambda _response: self._asked.pop(mark))
        arguments = self._spelling.to_client(f"{call.type_name}_Request", call.request)
        if not self._ask_client({"op": "call_service", "id": mark, "service": spelled_service, "args": arguments}):
            call.fail(f"Service {call.service}: its provider does not read its calls quickly enough")

    def _respond(self, operation: ServiceResponse) -> None:
        call = self._asked.get(operation.id)
        if call is None:
            raise OperationError(operation.op, "id", "no call of this id waits for a response")
        if operation.result:
            values = {} if operation.values is None else operation.values
            call.succeed(self._spelling.from_client(f"{call.type_name}_Response", values))
        else:
            call.fail(f"Service {call.service} failed" if operation.values is None else operation.values)

    def fail(self, mark: str | int | None, problem: str) -> None:
        """End the call of this id, if there is one, whose response cannot be read."""
        call = self._asked.get(mark)
        if call is not None:
            call.fail(f"Service {call.service} gave a response that cannot be read: {problem}")

    # As a caller.

    def turn_away(self, operation: CallService, problem: str) -> None:
        """Answer a call that the client may not make."""
        _, mark = _name_and_mark(operation)
        fields = {"op": "service_response", "service": operation.service, "values": problem, "result": False}
        self._send(with_id(fields, mark))

    def _call(self, operation: CallService) -> None:
        name, mark = _name_and_mark(operation)
        self._spelling.learn(operation.type, "srv")
        type_name = self._services.type_of(name)

        def answer(response: Response) -> None:
            values = (
                self._spelling.to_client(f"{type_name}_Response", response.values) if response.ok else response.values
            )
            fields = {"op": "service_response", "service": operation.service, "values": values, "result": response.ok}
            self._send(with_id(fields, mark))

        def end(response: Response) -> None:
            self._calls_in_flight -= 1
            answer(response)

        if self._calls_in_flight >= self._limits.max_calls_in_flight:
            answer(Response(ok=False, values=f"{self._calls_in_flight} calls of this client wait, which is the limit"))
            return
        self._calls_in_flight += 1
        arguments = self._spelling.from_client(f"{type_name}_Request", operation.args)
        self._services.call(self._node, name, arguments, end, operation.timeout, self._spelling.dialect)


def _name_and_mark(operation: CallService) -> tuple[str, str | int | None]:
    # `/svc#7` is how rosbridge's first clients gave the id.
    service, _, mark_in_name = operation.service.partition("#")
    return qualify(service), operation.id if operation.id is not None else mark_in_name or None

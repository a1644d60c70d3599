"""Services of this server that other machines may call, with the services of its actions."""

from __future__ import annotations

import asyncio
import threading
import time
from base64 import b64decode
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from protocol.codecs import cdr
from protocol.errors import MessageError
from protocol.operations import SendActionGoal
from robot.stop_epochs import STOP_EPOCHS
from server.access.authorization import Authorizer, rule_of_service
from server.arrival import arrived_in
from server.graph.action_topics import ENDED_KEPT_S
from server.graph.actions import GoalStatus, Result
from server.graph.message_types import ReceivedMessage
from server.graph.services import Response
from server.zenoh.network import ACTION_PARTS, MAX_SHARED, Declared, Network, SharedNames
from server.zenoh.rmw import GID_BYTES, Attachment, Endpoint, Entity, EntityKind
from server.zenoh.session import call_in_loop

if TYPE_CHECKING:
    import zenoh

# Ending of the service's name -> ending of its type.
GOAL_SERVICES = {"send_goal": "_SendGoal", "get_result": "_GetResult"}

# Goals of all other machines whose results are kept; far more than an arm carries out.
MAX_GOALS = 1_000

Respond: TypeAlias = Callable[[Response], None]


class OfferedGoals:
    """Goals that other machines have sent, until their results have been kept long enough."""

    def __init__(self, network: Network, authorizer: Authorizer) -> None:
        self._network = network
        self._authorizer = authorizer
        self._results: dict[str, asyncio.Future[Result]] = {}

    def send(self, action: str, octets: bytes, epoch: int, respond: Respond) -> None:
        """Serve ``send_goal``, a request as CDR that arrived in a stop epoch."""
        network, type_name = self._network, self._network.graph.actions.names.type_of(action)
        if type_name is None:
            respond(_no_action(action))
            return

        def take(request: dict[str, Any] | MessageError) -> None:
            if isinstance(request, MessageError):
                refusal: str | None = str(request)
            else:
                with arrived_in(epoch):
                    refusal = self._start(action, type_name, request["goal_id"]["uuid"], request["goal"])
            if refusal is not None:
                network.warn(f"a goal of another machine to {action} is rejected: {refusal}")
            stamp = network.graph.message_types.now().as_message()
            respond(Response(ok=True, values={"accepted": refusal is None, "stamp": stamp}))

        network.decode_member(f"{type_name}_SendGoal_Request", "goal", octets, take)

    def _start(self, action: str, type_name: str, goal_id: str, goal: ReceivedMessage) -> str | None:
        network = self._network
        if len(self._results) >= MAX_GOALS:
            return f"{MAX_GOALS} goals of other machines are known already"
        if goal_id in self._results:
            return "another goal has its id"
        refusal = self._authorizer.refusal(SendActionGoal(action=action, action_type=type_name, args=goal.value))
        if refusal is not None:
            return refusal
        result: asyncio.Future[Result] = network.loop.create_future()
        network.graph.actions.send_goal(
            network.node, action, type_name, goal, result.set_result, goal_id=b64decode(goal_id)
        )
        if result.done() and result.result().status == GoalStatus.UNKNOWN:
            return str(result.result().values)
        self._results[goal_id] = result
        result.add_done_callback(lambda _: network.loop.call_later(ENDED_KEPT_S, self._results.pop, goal_id, None))
        return None

    def get_result(self, action: str, octets: bytes, respond: Respond) -> None:
        """Serve ``get_result``: respond when the goal has ended; at once, with an unknown status, for no known goal."""
        network, type_name = self._network, self._network.graph.actions.names.type_of(action)
        if type_name is None:
            respond(_no_action(action))
            return

        def answer(result: Result) -> None:
            values = result.values if result.ok else network.graph.message_types.complete(f"{type_name}_Result", {})
            respond(Response(ok=True, values={"status": int(result.status), "result": values}))

        def take(request: dict[str, Any] | MessageError) -> None:
            known = None if isinstance(request, MessageError) else self._results.get(request["goal_id"].value["uuid"])
            if known is None:
                answer(Result(ok=False, status=GoalStatus.UNKNOWN, values=""))
            else:
                known.add_done_callback(lambda done: answer(done.result()))

        network.decode_member(f"{type_name}_GetResult_Request", "goal_id", octets, take)


def _no_action(action: str) -> Response:
    return Response(ok=False, values=f"Action {action} does not exist")


# Calls of all other machines in progress; at worst each is a plan or a motion, which takes its time.
MAX_INCOMING_CALLS = 64

# Further calls that stop an arm or cancel a goal: calls that wait for a motion must not keep them out.
MAX_INCOMING_STOPS = 64


class IncomingCall(NamedTuple):
    """Call of a service of this server."""

    service: OfferedService
    query: zenoh.Query
    octets: bytes
    sender: Attachment | None
    epoch: int


class OfferedService:
    """Service of this server that other machines may call."""

    def __init__(
        self, network: Network, name: str, endpoint: Endpoint, receive: Callable[[IncomingCall], None]
    ) -> None:
        self.name = name
        self.endpoint = endpoint
        stops = rule_of_service(name, network.graph).stops
        self.max_calls = MAX_INCOMING_CALLS + stops * MAX_INCOMING_STOPS
        self._network = network
        self._receive = receive
        self._key = endpoint.key(network.domain_id)
        self._token = network.tokens.entity(EntityKind.SERVICE, endpoint)
        self._declaration = network.declare(self._declare)

    def close(self) -> None:
        self._declaration.undeclare()

    def reply(self, call: IncomingCall, response: Response) -> None:
        """Send the response, or the sentence of a failed call; in the session's thread."""
        try:
            if not response.ok:
                call.query.reply_err(str(response.values).encode())
                return
            octets = cdr.serialize(self._network.registry, f"{self.endpoint.type_name}_Response", response.values)
            # rmw_zenoh matches response and call by the attachment of the request.
            sender = call.sender or Attachment(0, 0, bytes(GID_BYTES))
            attachment = sender._replace(source_timestamp_ns=time.time_ns()).encode()
            call.query.reply(self._key, octets, attachment=attachment)
        finally:
            # Ends the query: no further reply follows.
            call.query.drop()

    def _declare(self, session: zenoh.Session) -> Iterator[Declared]:
        import zenoh

        handler = zenoh.handlers.Callback(self._on_query, indirect=False)
        yield session.declare_queryable(self._key, handler, complete=True)
        yield session.liveliness().declare_token(self._token)

    def _on_query(self, query: zenoh.Query) -> None:
        # Tools query all keys that match a pattern to list them, which must not call anything.
        if query.payload is None or str(query.key_expr) != self._key:
            query.drop()
            return
        size_bytes = len(query.payload)
        # A request that is too large is not even copied; empty, it is answered as unreadable.
        octets = bytes(query.payload) if size_bytes <= self._network.max_message_bytes else b""
        sender = None if query.attachment is None else Attachment.decode(bytes(query.attachment))
        self._receive(IncomingCall(self, query, octets, sender, STOP_EPOCHS.present))


class OfferedServices:
    """All services of this server that other machines may call."""

    def __init__(self, network: Network, names: SharedNames, authorizer: Authorizer) -> None:
        self._network = network
        self._names = names
        self._authorizer = authorizer
        self._services: dict[str, OfferedService] = {}
        self._goals = OfferedGoals(network, authorizer)
        self._lock = threading.Lock()
        self._in_progress = 0

    def refresh(self, entities: tuple[Entity, ...]) -> None:
        """Offer the services that exist now, and no others; warn of clients that have another version of a type."""
        wanted = self._wanted()
        for entity in entities:
            if entity.kind is EntityKind.CLIENT and entity.endpoint not in wanted.values():
                self._network.agrees(entity.endpoint, "srv")
        for name, service in list(self._services.items()):
            if wanted.get(name) != service.endpoint:
                self._services.pop(name).close()
        for name, endpoint in wanted.items():
            if name not in self._services and len(self._services) < MAX_SHARED:
                self._services[name] = OfferedService(self._network, name, endpoint, self._receive)

    def _wanted(self) -> dict[str, Endpoint]:
        network, graph, found = self._network, self._network.graph, {}
        services = graph.services.names.types() | {
            f"{action}{ACTION_PARTS}{part}": f"{type_name}{ending}"
            for action, type_name in graph.actions.names.types().items()
            for part, ending in GOAL_SERVICES.items()
            if network.registry.knows(type_name, "action")
        }
        for name, type_name in services.items():
            action = name.partition(ACTION_PARTS)[0]
            provider = graph.actions.provider(action) or graph.services.provider(name)
            if self._names.matches(name) and provider is not network.node:
                endpoint = network.endpoint(network.to_network(name), type_name, "srv")
                if endpoint is not None:
                    found[name] = endpoint
        return found

    def _receive(self, call: IncomingCall) -> None:
        with self._lock:
            is_accepted = self._in_progress < call.service.max_calls
            self._in_progress += is_accepted
        if is_accepted:
            call_in_loop(self._network.loop, self._call, call)
        else:
            full = f"Service {call.service.name}: {call.service.max_calls} calls are on their way already"
            self._network.thread.submit_call(lambda _session: call.service.reply(call, Response(ok=False, values=full)))

    def _call(self, call: IncomingCall) -> None:
        network, name = self._network, call.service.name
        action, _, part = name.partition(ACTION_PARTS)

        def respond(response: Response) -> None:
            with self._lock:
                self._in_progress -= 1
            network.thread.submit_call(lambda _session: call.service.reply(call, response))

        if part == "send_goal":
            self._goals.send(action, call.octets, call.epoch, respond)
            return
        if part == "get_result":
            self._goals.get_result(action, call.octets, respond)
            return
        refusal = self._authorizer.calling(name, None)
        if refusal is not None:
            network.warn(refusal)
            respond(Response(ok=False, values=refusal))
            return

        def take(request: ReceivedMessage | MessageError) -> None:
            if isinstance(request, MessageError):
                respond(Response(ok=False, values=f"Service {name}: {request}"))
            else:
                with arrived_in(call.epoch):
                    network.graph.services.call(network.node, name, request, respond)

        network.decode(f"{call.service.endpoint.type_name}_Request", call.octets, take)

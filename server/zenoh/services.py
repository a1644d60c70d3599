"""Services and actions across machines: other machines' that clients may call here, and this server's for them."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import threading
import time
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import zenoh

from planners.problem import MoveItErrorCode
from protocol.codecs import cdr
from protocol.errors import MessageError
from protocol.operations import SendActionGoal
from protocol.registry import Registry
from protocol.type_descriptions import message_hash, service_hash
from robot.stop_epochs import STOP_EPOCHS
from server.access.authorization import Authorizer, rule_of_service
from server.arrival import arrived_in
from server.errors import NoAnswerError, ServiceError
from server.graph.actions import ACTION_PARTS, ENDED_KEPT_S, MAX_GOAL_S, ActionGoal, GoalStatus, Result
from server.graph.message_types import ReceivedMessage
from server.graph.providers import CompleteResponse
from server.graph.services import LOCAL_TIMEOUT_S, Response, answer
from server.moveit.messages import error_code
from server.timers import call_in_loop
from server.zenoh.network import Declared, Network, SharedEndpoints, SharedNames
from server.zenoh.rmw import GID_BYTES, Attachment, Endpoint, Entity, EntityKind, gid_of
from server.zenoh.session import ReceiveQueue

# Calls of one service of another machine in progress; the others would wait there.
MAX_OUTGOING_CALLS = 64

# Service by which an action is known, and the ending of its type.
SEND_GOAL, SEND_GOAL_TYPE = f"{ACTION_PARTS}send_goal", "_SendGoal"

# Final statuses of goals (action_msgs/GoalStatus).
FINAL = frozenset((GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED))


class RemoteService:
    """Service of another machine, as its client on the network; ``title`` names it, or its action, in sentences."""

    def __init__(self, network: Network, title: str, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._network = network
        self._title = title
        token = network.tokens.entity(EntityKind.CLIENT, endpoint)
        self._gid = gid_of(token)
        self._sent = 0
        self._in_progress = 0
        self._declaration = network.declare(token)

    def close(self) -> None:
        self._declaration.undeclare()

    async def call(self, request: Mapping[str, Any], timeout_s: float = LOCAL_TIMEOUT_S) -> bytes:
        """Call the service; return the response as CDR, or raise NoAnswerError with the reason."""
        if self._in_progress >= MAX_OUTGOING_CALLS:
            raise NoAnswerError(f"{self._title}: {MAX_OUTGOING_CALLS} calls are on their way already")
        network, limit = self._network, self._network.max_message_bytes
        self._sent += 1
        attachment = Attachment(self._sent, time.time_ns(), self._gid).encode()
        answered: asyncio.Future[bytes] = network.loop.create_future()

        def answer(response: bytes | str) -> None:
            if answered.done():
                return
            if isinstance(response, bytes):
                answered.set_result(response)
            else:
                answered.set_exception(NoAnswerError(response))

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None and len(reply.ok.payload) > limit:
                call_in_loop(network.loop, answer, f"{self._title} gave a response of more than {limit} bytes")
            elif reply.ok is not None:
                call_in_loop(network.loop, answer, bytes(reply.ok.payload))
            elif reply.err is not None:
                call_in_loop(network.loop, answer, bytes(reply.err.payload).decode(errors="replace"))

        def end() -> None:
            self._in_progress -= 1
            answer(f"{self._title} has not answered")

        def get(session: zenoh.Session) -> None:
            octets = cdr.serialize(network.registry, f"{self.endpoint.type_name}_Request", request)
            session.get(
                self.endpoint.key(network.domain_id),
                zenoh.handlers.Callback(on_reply, lambda: call_in_loop(network.loop, end), indirect=False),
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout_s,
                congestion_control=zenoh.CongestionControl.DROP,
                payload=octets,
                attachment=attachment,
            )

        if not network.thread.submit_call(get):
            raise NoAnswerError(f"{self._title}: the network stands still")
        self._in_progress += 1
        return await answered


class CalledService:
    """Service of another machine, offered to clients of this server, or GraphError if another service has its name."""

    def __init__(self, network: Network, name: str, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._network = network
        self._name = name
        network.graph.services.offer_calls(
            network.node, name, endpoint.type_name, lambda call: answer(call, self._serve), limits=None
        )
        self._remote = RemoteService(network, f"Service {name}", endpoint)

    def close(self) -> None:
        """Withdraw the service; calls in progress fail."""
        self._network.graph.services.withdraw(self._network.node, self._name)
        self._remote.close()

    async def _serve(self, request: dict[str, Any]) -> CompleteResponse:
        type_name = self.endpoint.type_name
        octets = await self._remote.call(request)
        try:
            response = await self._network.decode(f"{type_name}_Response", octets)
            return CompleteResponse(response.completed(f"{type_name}_Response") or {})
        except MessageError as error:
            raise NoAnswerError(
                f"Service {self._name} gave a response that does not fit {type_name}: {error}"
            ) from error


class CalledAction:
    """Action of another machine, by its service ``send_goal``, offered to clients (rcl_action, action_client.c).

    Raises GraphError if another action has its name.
    """

    def __init__(self, network: Network, name: str, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._network = network
        self._name = name
        self._type_name = type_name = endpoint.type_name.removesuffix(SEND_GOAL_TYPE)
        self._goals: dict[bytes, ActionGoal] = {}
        self._received = ReceiveQueue[bytes](network.loop, lambda octets: network.start(self._report(octets)))
        network.graph.actions.offer(network.node, name, type_name, lambda goal: network.start(self._pursue(goal)))
        parts, title = f"{endpoint.name.removesuffix(SEND_GOAL)}{ACTION_PARTS}", f"Action {name}"
        self._send_goal, self._get_result, self._cancel_goal = (
            RemoteService(network, title, Endpoint(f"{parts}{part}", service, service_hash(network.registry, service)))
            for part, service in (
                ("send_goal", endpoint.type_name),
                ("get_result", f"{type_name}_GetResult"),
                ("cancel_goal", "action_msgs/srv/CancelGoal"),
            )
        )
        feedback = f"{type_name}_FeedbackMessage"
        self._feedback = Endpoint(f"{parts}feedback", feedback, message_hash(network.registry, feedback))
        token = network.tokens.entity(EntityKind.SUBSCRIPTION, self._feedback)
        self._declaration = network.declare(token, self._declare)

    def close(self) -> None:
        """Withdraw the action; goals in progress fail."""
        self._network.graph.actions.withdraw(self._network.node, self._name)
        for service in (self._send_goal, self._get_result, self._cancel_goal):
            service.close()
        self._declaration.undeclare()

    def _declare(self, session: zenoh.Session) -> Declared:
        handler = zenoh.handlers.Callback(self._on_feedback, indirect=False)
        key = self._feedback.key(self._network.domain_id)
        return session.declare_subscriber(key, handler, allowed_origin=zenoh.Locality.REMOTE)

    def _on_feedback(self, sample: zenoh.Sample) -> None:
        is_own_key = str(sample.key_expr) == self._feedback.key(self._network.domain_id)
        if is_own_key and len(sample.payload) <= self._network.max_message_bytes:
            self._received.put(bytes(sample.payload), len(sample.payload))

    async def _report(self, octets: bytes) -> None:
        try:
            message = await self._network.decode_member(self._feedback.type_name, "feedback", octets)
            goal = self._goals.get(b64decode(message["goal_id"]["uuid"]))
            if goal is not None:
                goal.feedback(message["feedback"])
        except MessageError as error:
            self._network.warn(f"feedback of {self._name} is left out: {error}")

    async def _pursue(self, goal: ActionGoal) -> None:
        network, type_name, goal_id = self._network, self._type_name, {"uuid": b64encode(goal.goal_id).decode()}
        self._goals[goal.goal_id] = goal
        goal.when_ended(lambda _result: self._goals.pop(goal.goal_id))
        try:
            octets = await self._send_goal.call({"goal_id": goal_id, "goal": goal.request})
            if not cdr.deserialize(network.registry, f"{type_name}_SendGoal_Response", octets)["accepted"]:
                goal.fail(f"Action {self._name}: its provider has rejected the goal", GoalStatus.UNKNOWN)
                return
            # Not before: the provider does not know the goal yet.
            goal.when_canceled(lambda: network.start(self._cancel(goal_id)))
            octets = await self._get_result.call({"goal_id": goal_id}, MAX_GOAL_S)
            response = await network.decode_member(f"{type_name}_GetResult_Response", "result", octets)
            if response["status"] in FINAL:
                goal.finish(GoalStatus(response["status"]), response["result"])
            else:
                goal.fail(f"Action {self._name}: its provider does not know the goal any more")
        except ServiceError as error:
            goal.fail(str(error))
        except MessageError as error:
            goal.fail(f"Action {self._name} gave a response that does not fit {type_name}: {error}")

    async def _cancel(self, goal_id: Mapping[str, str]) -> None:
        info = {"goal_id": goal_id, "stamp": {"sec": 0, "nanosec": 0}}
        try:
            await self._cancel_goal.call({"goal_info": info})
        except ServiceError as error:
            self._network.warn(str(error))


class CalledServices:
    """All services and actions of other machines that clients of this server may call."""

    def __init__(self, network: Network, names: SharedNames) -> None:
        self._network = network
        self._names = names
        # An action by its service send_goal.
        self._services = SharedEndpoints(network, self._make)

    def refresh(self, entities: tuple[Entity, ...]) -> None:
        """Let clients call the services that exist now, and no others."""
        announced = self._endpoints(entities)
        self._services.follow({name: each for name, each in announced.items() if not self._is_taken(name)})

    def _make(self, name: str, endpoint: Endpoint) -> CalledService | CalledAction:
        made, _, part = name.partition(ACTION_PARTS)
        return (CalledAction if part else CalledService)(self._network, made, endpoint)

    def _endpoints(self, entities: Iterable[Entity]) -> dict[str, Endpoint]:
        network, found = self._network, dict[str, Endpoint]()
        for entity in entities:
            endpoint, name = entity.endpoint, network.to_local(entity.endpoint.name)
            # The other services of an action go with it.
            is_whole = ACTION_PARTS not in name or endpoint.type_name.endswith(SEND_GOAL_TYPE)
            is_called = entity.kind is EntityKind.SERVICE and is_whole and self._names.matches(name)
            if is_called and network.agrees(endpoint, "srv"):
                found.setdefault(name, endpoint)
        return found

    def _is_taken(self, name: str) -> bool:
        """Return True if this server or a client offers a service or action of this name, and keeps it."""
        made, _, part = name.partition(ACTION_PARTS)
        offers = self._network.graph.actions if part else self._network.graph.services
        is_taken = offers.provider(made) not in (None, self._network.node)
        if is_taken:
            kind = "an action" if part else "a service"
            self._network.warn(f"{made} of another machine cannot be called, {kind} of that name is offered here")
        return is_taken


# Ending of the service's name -> ending of its type.
GOAL_SERVICES = {"send_goal": "_SendGoal", "get_result": "_GetResult"}

# Goals of all other machines whose results are kept; far more than an arm carries out.
MAX_GOALS = 1_000


class OfferedGoals:
    """Goals that other machines have sent, until their results have been kept long enough."""

    def __init__(self, network: Network, authorizer: Authorizer) -> None:
        self._network = network
        self._authorizer = authorizer
        self._results: dict[str, asyncio.Future[Result]] = {}

    async def send(self, action: str, octets: bytes) -> dict[str, Any]:
        """Serve ``send_goal``, a request as CDR; raises ServiceError."""
        network, type_name = self._network, self._type_of(action)
        try:
            request = await network.decode_member(f"{type_name}_SendGoal_Request", "goal", octets)
            refusal = self._start(action, type_name, request["goal_id"]["uuid"], request["goal"])
        except MessageError as error:
            refusal = str(error)
        if refusal is not None:
            network.warn(f"a goal of another machine to {action} is rejected: {refusal}")
        return {"accepted": refusal is None, "stamp": network.graph.message_types.now().as_message()}

    def _type_of(self, action: str) -> str:
        type_name = self._network.graph.actions.names.type_of(action)
        if type_name is None:
            raise ServiceError(f"Action {action} does not exist")
        return type_name

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

    async def result(self, action: str, octets: bytes) -> dict[str, Any]:
        """Serve ``get_result`` when the goal has ended; at once, with an unknown status, for no known goal."""
        network, type_name = self._network, self._type_of(action)
        result, known = Result(ok=False, status=GoalStatus.UNKNOWN, values=""), None
        with contextlib.suppress(MessageError):
            request = cdr.deserialize(network.registry, f"{type_name}_GetResult_Request", octets)
            known = self._results.get(request["goal_id"]["uuid"])
        if known is not None:
            # The goal goes on when the network is left.
            result = await asyncio.shield(known)
        values = result.values if result.ok else network.graph.message_types.complete(f"{type_name}_Result", {})
        return {"status": int(result.status), "result": values}


# MoveIt's code of a result.
ERROR_CODES = "moveit_msgs/msg/MoveItErrorCodes"


def failure_fields(registry: Registry, type_name: str, reason: str) -> dict[str, Any]:
    """Return the fields by which a response of a type, or a part of it, reports a failure; empty if it has none."""
    if type_name == ERROR_CODES:
        return error_code(MoveItErrorCode.FAILURE, reason)
    fields = {field.name: field.base for field in registry.message(type_name).fields if field.array is None}
    if fields.get("success") == "bool":
        return {"success": False, **({"message": reason} if "message" in fields else {})}
    # Of GetMotionPlan the code is in a part.
    parts = {name: base for name, base in fields.items() if base == ERROR_CODES or base.endswith("Response")}
    found = {name: failure_fields(registry, base, reason) for name, base in parts.items()}
    return {name: part for name, part in found.items() if part}


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
        self, network: Network, receive: Callable[[IncomingCall], None], name: str, endpoint: Endpoint
    ) -> None:
        self.name = name
        self.endpoint = endpoint
        stops = rule_of_service(name, network.graph).stops
        self.max_calls = MAX_INCOMING_CALLS + stops * MAX_INCOMING_STOPS
        self._network = network
        self._receive = receive
        self._key = endpoint.key(network.domain_id)
        self._declaration = network.declare(network.tokens.entity(EntityKind.SERVICE, endpoint), self._declare)

    def close(self) -> None:
        self._declaration.undeclare()

    def reply(self, call: IncomingCall, response: Response) -> None:
        """Send the response, or the sentence of a failed call; in the session's thread."""
        try:
            type_name, values = f"{self.endpoint.type_name}_Response", response.values
            if not response.ok:
                call.query.reply_err(str(response.values).encode())
                # rmw_zenoh logs an error's sentence and goes on waiting for a response (rmw_client_data.cpp).
                fields = failure_fields(self._network.registry, type_name, str(response.values))
                if not fields:
                    return
                values = self._network.graph.message_types.complete(type_name, fields)
            octets = cdr.serialize(self._network.registry, type_name, values)
            # rmw_zenoh matches response and call by the attachment of the request.
            sender = call.sender or Attachment(0, 0, bytes(GID_BYTES))
            attachment = sender._replace(source_timestamp_ns=time.time_ns()).encode()
            call.query.reply(self._key, octets, attachment=attachment)
        finally:
            # Ends the query: no further reply follows.
            call.query.drop()

    def _declare(self, session: zenoh.Session) -> Declared:
        handler = zenoh.handlers.Callback(self._on_query, indirect=False)
        return session.declare_queryable(self._key, handler, complete=True)

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
        self._services = SharedEndpoints(network, functools.partial(OfferedService, network, self._receive))
        self._goals = OfferedGoals(network, authorizer)
        self._lock = threading.Lock()
        self._in_progress = 0

    def refresh(self, entities: tuple[Entity, ...]) -> None:
        """Offer the services that exist now, and no others; warn of clients that have another version of a type."""
        wanted = self._wanted()
        for entity in entities:
            if entity.kind is EntityKind.CLIENT and entity.endpoint not in wanted.values():
                self._network.agrees(entity.endpoint, "srv")
        self._services.follow(wanted)

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
        with arrived_in(call.epoch):
            self._network.start(self._answer(call))

    async def _answer(self, call: IncomingCall) -> None:
        try:
            response = await self._serve(call.service, call.octets)
        except (ServiceError, MessageError) as error:
            response = Response(ok=False, values=str(error))
        finally:
            with self._lock:
                self._in_progress -= 1
        self._network.thread.submit_call(lambda _session: call.service.reply(call, response))

    async def _serve(self, service: OfferedService, octets: bytes) -> Response:
        network, name = self._network, service.name
        action, _, part = name.partition(ACTION_PARTS)
        if part in GOAL_SERVICES:
            serve = self._goals.send if part == "send_goal" else self._goals.result
            return Response(ok=True, values=await serve(action, octets))
        refusal = self._authorizer.calling(name, None)
        if refusal is not None:
            network.warn(refusal)
            raise ServiceError(refusal)
        try:
            request = await network.decode(f"{service.endpoint.type_name}_Request", octets)
        except MessageError as error:
            raise ServiceError(f"Service {name}: {error}") from error
        answered: asyncio.Future[Response] = network.loop.create_future()
        network.graph.services.call(network.node, name, request, answered.set_result)
        # The call goes on when the network is left.
        return await asyncio.shield(answered)

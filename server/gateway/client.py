"""Client of the graph, without any socket: carries the operations of one client out and queues what it gets.

Its topics, services and actions are a class each, with what the client provides and what it uses of others'.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Sequence
from typing import Any

from protocol.errors import NothingToDoError, OperationError, ProtocolError
from protocol.operations import (
    ActionFeedback,
    ActionResult,
    Advertise,
    AdvertiseAction,
    AdvertiseService,
    Auth,
    CallService,
    CancelActionGoal,
    Operation,
    Publish,
    SendActionGoal,
    ServiceResponse,
    SetLevel,
    Status,
    Subscribe,
    Unadvertise,
    UnadvertiseAction,
    UnadvertiseService,
    Unsubscribe,
    qualify,
)
from protocol.publication import PublishedMessage
from protocol.session import Packed, Refusal, with_id
from server.access.authorization import is_driving, is_stop, rule_of_service
from server.access.permissions import Role
from server.errors import GraphError
from server.gateway.client_auth import AuthContext, ClientAuth
from server.gateway.client_context import ClientContext
from server.gateway.inbox import Inbox, Reader, Scheduling
from server.graph.actions import Goal, GoalStatus, Result
from server.graph.message_types import PostponedError, ReceivedMessage
from server.graph.services import Call, Response
from server.graph.topics import Subscriber

log = logging.getLogger("armbridge.gateway")

# rosbridge_server's lifespan of messages that are published without latch (rosbridge_library, internal/publishers.py):
# clients publish right after they have advertised, when nobody has had the time to subscribe.
LIFESPAN_S = 1.0

NO_LATCH = "field latch: has no effect, it needs the role operate"

# Values in the lists of messages of a client's calls that wait, and as many of its goals: 75 MB. The last one may go
# beyond.
MAX_VALUES_IN_FLIGHT = 500_000
_VALUES_LIMIT = f"the limit is {MAX_VALUES_IN_FLIGHT}"

# Calls of services that plan which wait for their responses, by the client's role: a planner takes them one by one,
# each for up to seconds.
MAX_PLANNING_CALLS = {Role.VIEW: 16, Role.OPERATE: 64, Role.ADMIN: 64}


class ClientTopics:
    """Topics of one client.

    Args:
        context: the parts of the client.
    """

    def __init__(self, context: ClientContext) -> None:
        self._client = context
        self._node = context.node
        self._session = context.session
        self._graph = context.graph
        self._subscriber = Subscriber(self._deliver)

    def advertise(self, operation: Advertise) -> None:
        """Advertise a topic."""
        topic = qualify(operation.topic)
        self._client.translator.detect_dialect(operation.type, "msg")
        self._graph.advertise(self._node, topic, operation.type, latch=self._latches(operation))
        try:
            self._session.publications.add(operation)
        except OperationError:
            if topic not in self._session.publications:
                self._graph.unadvertise(self._node, topic)
            raise
        if operation.latch and not self._latches(operation):
            self._client.status.tell("warning", operation, NO_LATCH)

    def unadvertise(self, operation: Unadvertise) -> None:
        """Withdraw an advertisement."""
        topic = qualify(operation.topic)
        # A client that publishes without having advertised is a publisher too, under no id.
        implicit = topic not in self._session.publications and self._node in self._graph.publishers(topic)
        if implicit or self._session.publications.remove(operation.topic, operation.id):
            self._graph.unadvertise(self._node, topic)

    def publish(self, operation: Publish, message: ReceivedMessage) -> None:
        """Publish a message."""
        received = self._client.translator.from_client(message)
        topic = qualify(operation.topic)
        latch = self._latches(operation)
        lost = self._graph.publish(self._node, topic, received, latch=latch, lifespan_s=LIFESPAN_S)
        if operation.latch and not latch:
            lost = NO_LATCH
        if lost is not None:
            self._client.status.tell("warning", operation, lost)

    def _latches(self, operation: Advertise | Publish) -> bool:
        """Return True for an operation that latches, which has no effect for a client that may only look."""
        return operation.latch and not self._node.only_looks

    def reject(self, operation: Publish, problem: str) -> None:
        """Have the topic's owner answer a message that the client may not publish."""
        received = self._client.translator.from_client(ReceivedMessage(operation.msg, 0))
        topic = qualify(operation.topic)
        try:
            self._graph.turn_away(self._node, topic, received, problem)
        except PostponedError:
            # Of what is so large nothing is answered but that it is refused.
            self._graph.turn_away(self._node, topic, None, problem)

    def subscribe(self, operation: Subscribe) -> None:
        """Subscribe to a topic; messages that were published before the subscription follow at once."""
        topic = qualify(operation.topic)
        self._client.translator.detect_dialect(operation.type, "msg")
        earlier = self._graph.subscribe(self._node, topic, operation.type, self._subscriber)
        try:
            first = self._session.subscriptions.add(operation)
        except OperationError:
            if topic not in self._session.subscriptions:
                self._graph.unsubscribe(self._node, topic)
            raise
        if first:
            self._deliver_earlier(topic, earlier)

    def unsubscribe(self, operation: Unsubscribe) -> None:
        """End a subscription."""
        if self._session.subscriptions.remove(operation.topic, operation.id):
            self._graph.unsubscribe(self._node, qualify(operation.topic))

    def _deliver_earlier(self, topic: str, earlier: Sequence[PublishedMessage]) -> None:
        subscription = self._session.subscriptions.get(topic)
        # Under a throttle that drops, one of them gets through: it shall be the newest.
        newest_only = subscription is not None and subscription.skips
        for published in earlier[-1:] if newest_only else earlier:
            self._deliver(published, wake=False)
        # Not before all are there: of what waits for a throttle, only the last ones are to be sent.
        self._client.wake()

    def _deliver(self, published: PublishedMessage, *, wake: bool = True) -> None:
        try:
            queued = self._session.deliver(published, self._client.clock(), self._client.send_at_once)
        except ProtocolError as error:
            self._client.status.refuse_error("subscribe", error)
        else:
            if queued and wake:
                self._client.wake()


class ClientServices:
    """Services that one client offers, and its calls of others' services.

    Args:
        context: the parts of the client.
    """

    def __init__(self, context: ClientContext) -> None:
        self._client = context
        self._node = context.node
        self._services = context.graph.services
        self._limits = context.session.limits
        self._offered: set[str] = set()
        # Calls that the client is to answer, by the ids that it got; no id is ever given twice, so that no late
        # response is taken for another call's.
        self._requested: dict[str | int | None, Call] = {}
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
        if operation.result:
            call.succeed(self._client.translator.from_client(message))
        else:
            call.fail(f"Service {call.service} failed" if operation.values is None else operation.values)

    def fail(self, id_: str | int | None, problem: str) -> None:
        """End the call of this id, if there is one, whose response cannot be read."""
        call = self._requested.get(id_)
        if call is not None:
            call.fail(f"Service {call.service} gave a response that cannot be read: {problem}")

    # As a caller.

    def reject(self, operation: CallService, problem: str) -> None:
        """Answer a call that the client may not make."""
        _, id_ = _name_and_id(operation)
        fields = {"op": "service_response", "service": operation.service, "values": problem, "result": False}
        self._client.send(with_id(fields, id_))

    def call(self, operation: CallService, message: ReceivedMessage) -> None:
        """Call a service.

        Raises:
            PostponedError: the request is to be completed in the background first.
        """
        name, id_ = _name_and_id(operation)
        self._client.translator.detect_dialect(operation.type, "srv")
        type_name, plans = self._services.type_of(name), rule_of_service(name).plans

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
            problem = f"calls of this client with {self._values_in_flight} values wait, {_VALUES_LIMIT}"
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

    def _max_planning_calls(self) -> int:
        identity = self._node.identity
        return MAX_PLANNING_CALLS[Role.VIEW if identity is None else identity.role]


def _name_and_id(operation: CallService) -> tuple[str, str | int | None]:
    # `/svc#7` is how rosbridge's first clients gave the id.
    service, _, id_in_name = operation.service.partition("#")
    return qualify(service), operation.id if operation.id is not None else id_in_name or None


# rosbridge_library (capabilities/advertise_action.py) takes every other status for an aborted goal.
_PASSED_STATUSES = (GoalStatus.SUCCEEDED, GoalStatus.CANCELED)


class ClientActions:
    """Actions that one client offers, and the goals that it sends to others' actions.

    Args:
        context: the parts of the client.
    """

    def __init__(self, context: ClientContext) -> None:
        self._client = context
        self._node = context.node
        self._actions = context.graph.actions
        self._limits = context.session.limits
        self._offered: set[str] = set()
        # Goals that the client is to reach, by the ids that it got, none of which is ever given twice.
        self._requested: dict[str | int | None, Goal] = {}
        self._numbers = itertools.count(1)
        # Goals that the client has sent: action and the client's id.
        self._sent: dict[Goal, tuple[str, str | int | None]] = {}
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

    def fail(self, id_: str | int | None, problem: str) -> None:
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
            problem = f"goals of this client with {self._values_in_flight} values are on their way, {_VALUES_LIMIT}"
            on_result(Result(ok=False, status=GoalStatus.UNKNOWN, values=problem))
            return
        arguments = self._client.translator.from_client(message)
        listener = on_feedback if operation.feedback else None
        goal = self._actions.send_goal(self._node, name, operation.action_type, arguments, on_result, listener)
        if goal is not None and not goal.ended:
            self._sent[goal] = name, operation.id
            self._values_in_flight += message.values
            goal.when_ended(lambda _result: self._forget(goal, message.values))

    def _forget(self, goal: Goal, values: int) -> None:
        del self._sent[goal]
        self._values_in_flight -= values

    def reject(self, operation: SendActionGoal, problem: str) -> None:
        """Answer a goal that the client may not send."""
        fields = {"op": "action_result", "action": operation.action, "values": problem, "result": False}
        self._client.send(with_id({**fields, "status": int(GoalStatus.UNKNOWN)}, operation.id))

    def cancel(self, operation: CancelActionGoal) -> None:
        """Cancel the goal of this id; one that is unknown has most likely just ended."""
        wanted = qualify(operation.action), operation.id
        for goal in [goal for goal, sent in self._sent.items() if sent == wanted]:
            goal.cancel()


class Client:
    """Client of rosbridge.

    Args:
        context: the parts that its topics, services, actions and authentication share.
        auth: authentication as its connection provides it.
        scheduling: turns and threads, which all clients share.
        reader: the client's socket.

    Attributes:
        node: the client in the graph.
        session: state of the protocol.
        status: its status messages.
        inbox: what waits to be carried out.
        received_messages: frames received.
    """

    def __init__(self, context: ClientContext, auth: AuthContext, scheduling: Scheduling, reader: Reader) -> None:
        self.node = context.node
        self.session = context.session
        self.status = context.status
        self.received_messages = 0
        self._context = context
        self._graph = context.graph
        self._authorizer = auth.access.authorizer(context.node, context.graph)
        self._topics = ClientTopics(context)
        self._services = ClientServices(context)
        self._actions = ClientActions(context)
        self._auth = ClientAuth(context, auth, self._authorizer)
        self.inbox = Inbox(self, context.session, context.graph.message_types, scheduling, reader, context.clock)

    def receive_frame(self, frame: str | bytes) -> None:
        """Take a frame, to be carried out in the client's turn; nothing in it can raise."""
        self.received_messages += 1
        self.inbox.receive_frame(frame)

    def leave(self) -> None:
        """Take the client out of the graph."""
        self.inbox.close()
        # The calls and goals that end now would each be answered.
        self._context.left = True
        self._authorizer.leave()
        self._graph.remove(self.node)
        if self.session.dropped:
            log.warning("%s: %d messages were dropped because it read too slowly", self.node, self.session.dropped)

    # As the inbox's handler.

    @property
    def identified(self) -> bool:
        """False while nothing but the op ``auth`` is read of the client."""
        return self.node.identity is not None

    def admit_frame(self, frame: str | bytes) -> bool:
        """Check a frame before it is read; return False when it is not to be read."""
        return self.identified or self._auth.check_first_frame(frame)

    def admit_first(self, items: Sequence[Operation | Refusal | Packed]) -> bool:
        """Check the operations of a frame of a client that is not identified; return False for none of them."""
        return self._auth.check_first_operation(items)

    def is_stop(self, operation: Operation) -> bool:
        """Return True for an operation that stops the arm."""
        return is_stop(operation)

    def is_driving(self, operation: Operation) -> bool:
        """Return True for an operation that may move the arm."""
        return is_driving(operation)

    def carry_out(self, item: Operation | Refusal, size_bytes: int, message: ReceivedMessage | None) -> None:
        """Carry an operation out, or tell of a refusal; as `OperationHandler.carry_out`."""
        if isinstance(item, Refusal):
            self._refuse(item)
        else:
            self._carry_out(item, message or _message_of(item, size_bytes))
        if self.node.identity is None:
            self.inbox.close()

    def reject(self, operation: Operation, reason: str) -> None:
        """Tell of an operation that is not carried out; an operation with an answer gets it."""
        self.status.reject(operation, reason)
        match operation:
            case Publish():
                self._topics.reject(operation, reason)
            case CallService():
                self._services.reject(operation, reason)
            case SendActionGoal():
                self._actions.reject(operation, reason)
            case _:
                pass

    def _carry_out(self, operation: Operation, message: ReceivedMessage) -> None:
        dialect = self.session.dialect
        try:
            refusal = self._authorizer.refusal(operation)
            if refusal is not None:
                self.reject(operation, refusal)
                return
            self._serve(operation, message)
        except (ProtocolError, GraphError) as error:
            self.status.refuse_error(operation.op, error, operation.id)
        except PostponedError:
            raise
        except Exception:  # a bug in serving one operation must not take the client with it
            log.exception("%s: %s failed", self.node, operation.op)
        else:
            self.status.acknowledge(operation)
        if self.session.dialect != dialect:
            self.status.tell(
                "info", operation, "its type exists only in ROS 1, whose spelling this client gets from now on"
            )

    def _serve(self, operation: Operation, message: ReceivedMessage) -> None:
        # The most frequent first.
        match operation:
            case Publish():
                self._topics.publish(operation, message)
            case CallService():
                self._services.call(operation, message)
            case ServiceResponse():
                self._services.respond(operation, message)
            case ActionFeedback():
                self._actions.report_feedback(operation, message)
            case ActionResult():
                self._actions.finish(operation, message)
            case SendActionGoal():
                self._actions.send_goal(operation, message)
            case CancelActionGoal():
                self._actions.cancel(operation)
            case Subscribe():
                self._topics.subscribe(operation)
            case Unsubscribe():
                self._topics.unsubscribe(operation)
            case Advertise():
                self._topics.advertise(operation)
            case Unadvertise():
                self._topics.unadvertise(operation)
            case AdvertiseService():
                self._services.advertise(operation)
            case UnadvertiseService():
                self._services.unadvertise(operation)
            case AdvertiseAction():
                self._actions.advertise(operation)
            case UnadvertiseAction():
                self._actions.unadvertise(operation)
            case SetLevel():
                self.status.set_level(operation)
            case Status():
                self.status.log_status(operation)
            case Auth():
                self._auth.authenticate(operation)
            case _:
                raise AssertionError(f"the session hands {operation.op} to nobody")

    def _refuse(self, refusal: Refusal) -> None:
        """Tell of an operation that cannot be read; the caller or goal that waits for it fails."""
        self.status.refuse(refusal)
        if refusal.op == "service_response":
            self._services.fail(refusal.id, refusal.text)
        elif refusal.op == "action_result":
            self._actions.fail(refusal.id, refusal.text)


def _message_of(operation: Operation, size_bytes: int) -> ReceivedMessage:
    """Return the message in an operation; an empty one for operations without."""
    match operation:
        case Publish():
            return ReceivedMessage(operation.msg, size_bytes)
        case CallService() | SendActionGoal():
            return ReceivedMessage(operation.args, size_bytes)
        case ServiceResponse() | ActionResult() | ActionFeedback():
            return ReceivedMessage({} if operation.values is None else operation.values, size_bytes)
        case _:
            return _NO_MESSAGE


_NO_MESSAGE = ReceivedMessage({}, 0)

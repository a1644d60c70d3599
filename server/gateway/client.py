"""Client of the graph: carries the operations of one client out and queues what it gets, without any socket."""

from __future__ import annotations

import logging
from collections.abc import Callable

from protocol.dialect import Dialect
from protocol.errors import ProtocolError
from protocol.limits import Limits
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
)
from protocol.publication import Parcel
from protocol.session import Refusal, Session
from server.access.authorization import unlimited
from server.access.permissions import ANYONE, Identity
from server.errors import GraphError
from server.gateway.client_actions import ClientActions
from server.gateway.client_auth import AuthContext, ClientAuth
from server.gateway.client_context import ClientContext, ClientStatus
from server.gateway.client_services import ClientServices
from server.gateway.client_topics import ClientTopics
from server.gateway.translator import MessageTranslator
from server.graph.node import Node
from server.graph.topics import Graph

log = logging.getLogger("armbridge.gateway")


class Client:
    """Client of rosbridge.

    Args:
        name: its name in logs.
        graph: the graph that it takes part in.
        limits: limits of the client.
        clock: monotonic time [s].
        wake: called when there is something to send.
        dialect: dialect of its messages, until it shows another.
        send_at_once: sends a message if the socket takes it without waiting; returns True when it is sent.
        identity: its identity; None for a client that has yet to authenticate.
        auth: authentication as its connection provides it; None for a server without tokens and limits.

    Attributes:
        node: the client in the graph.
        session: state of the protocol.
        status: its status messages.
        received_messages: frames received.
    """

    def __init__(
        self,
        name: str,
        graph: Graph,
        limits: Limits,
        clock: Callable[[], float],
        wake: Callable[[], None],
        dialect: Dialect = "ros2",
        send_at_once: Callable[[Parcel], bool] = lambda _parcel: False,
        identity: Identity | None = ANYONE,
        auth: AuthContext | None = None,
    ) -> None:
        auth = auth or AuthContext(unlimited())
        self.node = Node(name, remote=True, identity=identity)
        self.session = Session(limits, dialect)
        self.status = ClientStatus(self.node, self.session, wake)
        self.received_messages = 0
        self._graph = graph
        self._clock = clock
        self._authorizer = auth.access.authorizer(self.node)
        translator = MessageTranslator(self.session, graph.interfaces.registry)
        context = ClientContext(
            self.node, graph, self.session, limits, translator, self.status, clock, wake, send_at_once
        )
        self._topics = ClientTopics(context)
        self._services = ClientServices(context)
        self._actions = ClientActions(context)
        self._auth = ClientAuth(context, auth, self._authorizer)

    def receive_frame(self, frame: str | bytes) -> None:
        """Carry out the operations in a frame; nothing in it can raise."""
        self.received_messages += 1
        # Until a client has authenticated, nothing else is read of it.
        if self.node.identity is None and not self._auth.check_first_frame(frame):
            return
        items = self.session.receive_frame(frame, self._clock())
        if self.node.identity is None and not self._auth.check_first_operation(items):
            return
        for item in items:
            if isinstance(item, Refusal):
                self._refuse(item)
            else:
                self._receive_operation(item)
            if self.node.identity is None:
                return

    def leave(self) -> None:
        """Take the client out of the graph."""
        self._authorizer.leave()
        self._graph.remove(self.node)
        if self.session.dropped:
            log.warning("%s: %d messages were dropped because it read too slowly", self.node, self.session.dropped)

    def _receive_operation(self, operation: Operation) -> None:
        dialect = self.session.dialect
        try:
            refusal = self._authorizer.refusal(operation)
            if refusal is not None:
                self._reject(operation, refusal)
                return
            self._carry_out(operation)
        except (ProtocolError, GraphError) as error:
            self.status.refuse_error(operation.op, error, operation.id)
        except Exception:  # a bug in serving one operation must not take the client with it
            log.exception("%s: %s failed", self.node, operation.op)
        else:
            self.status.acknowledge(operation)
        if self.session.dialect != dialect:
            self.status.tell(
                "info", operation, "its type exists only in ROS 1, whose spelling this client gets from now on"
            )

    def _carry_out(self, operation: Operation) -> None:
        # The most frequent first.
        match operation:
            case Publish():
                self._topics.publish(operation)
            case CallService():
                self._services.call(operation)
            case ServiceResponse():
                self._services.respond(operation)
            case ActionFeedback():
                self._actions.report_feedback(operation)
            case ActionResult():
                self._actions.finish(operation)
            case SendActionGoal():
                self._actions.send_goal(operation)
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

    def _reject(self, operation: Operation, reason: str) -> None:
        """Tell of an operation that the client may not do; an operation with an answer gets it."""
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

"""Client of the graph, without any socket: carries the operations of one client out and queues what it gets."""

import contextlib
import logging
from collections.abc import Mapping, Sequence
from typing import Any

from protocol import operations as ops
from protocol.errors import OperationError, ProtocolError
from protocol.operations import Operation, Request
from protocol.registry import Kind
from protocol.session import Packed, Refusal
from server.access.authorization import Authorizer, is_cancel, is_stop
from server.arrival import arrived_in, epoch_after
from server.errors import GraphError
from server.gateway.client_context import ClientContext
from server.gateway.client_requests import ClientActions, ClientServices, name_and_id
from server.gateway.client_topics import ClientTopics
from server.gateway.inbox import Inbox, Waiting
from server.graph.message_types import PostponedError, ReceivedMessage
from server.graph.permissions import Identity, display_name

log = logging.getLogger("armbridge.gateway")

# An auth with all its fields at their greatest; a client that has not authenticated may cost no more.
MAX_FIRST_BYTES = 4096

_NOT_FIRST = "the first message must be auth, with a token of this server"


class Client:
    """Client of rosbridge; a wrong token ends its connection, and counts under its IP address."""

    def __init__(self, context: ClientContext) -> None:
        self.node = context.node
        self.session = context.session
        self.status = context.status
        self.wake = context.wake
        self.received_messages = 0
        self._context = context
        self._graph = context.graph
        self._authorizer = Authorizer(context.node, context.gateway.access, context.graph)
        self.topics = ClientTopics(context, self._authorizer)
        self.services = ClientServices(context)
        self.actions = ClientActions(context)
        self.inbox = Inbox(self, context)
        self._shown: Identity | None = None  # identity of the last token

    def receive_frame(self, frame: str | bytes, epoch: int | None = None) -> None:
        """Take a frame, to be carried out in the client's turn; nothing in it can raise."""
        self.received_messages += 1
        self.inbox.receive_frame(frame, epoch)

    def leave(self) -> None:
        self.inbox.close()
        # The calls and goals that end now would each be answered.
        self._context.left = True
        self._authorizer.leave()
        self._graph.remove(self.node)
        if self.session.dropped:
            log.warning("%s: %d messages were dropped because it read too slowly", self.node, self.session.dropped)
        self._context.gateway.access.one_time_tokens.release(self._shown)
        # They lead back here: without them all of the client is freed at once, without the garbage collector.
        del self._context.connection, self._context.status, self.topics.subscriber, self.inbox.client

    # For the inbox.

    @property
    def identified(self) -> bool:
        """False while nothing but the op ``auth`` is read of the client."""
        return self.node.identity is not None

    def read(self, frame: str | bytes) -> Sequence[Operation | Refusal | Packed]:
        """Read a frame; until a client has an identity, nothing but an ``auth`` of the least size is read."""
        if self.identified:
            return self.session.receive_frame(frame, self._context.clock())
        items = self.session.receive_frame(frame, self._context.clock()) if len(frame) <= MAX_FIRST_BYTES else ()
        first = items[0] if items else None
        if isinstance(first, ops.Auth):
            return items
        # Without the text that came: it may be a bare token.
        self._disconnect(first.text if isinstance(first, Refusal) and first.op == "auth" else _NOT_FIRST)
        return ()

    def publish_strictly(self, frame: str) -> bool:
        """Publish the message of a frame the strict way; False for a frame to be read the general way."""
        try:
            return self.session.reads_by_itself(frame) and self.topics.publish_strictly(frame)
        except (ProtocolError, GraphError) as error:
            self.status.refuse_error("publish", error)
        except Exception:  # a bug in serving one operation must not take the client with it
            log.exception("%s: publish failed", self.node)
        return True

    def repeat(self, operation: Operation) -> None:
        """Cancel again, without an answer."""
        if self._authorizer.refusal(operation) is not None:
            return
        # The client got the errors the first time.
        with contextlib.suppress(ProtocolError, GraphError, PostponedError):
            match operation:
                case ops.CancelActionGoal():
                    self.actions.cancel(operation)
                case ops.CallService():
                    self.services.call_unanswered(operation)
                case ops.Publish():
                    self.topics.publish(operation, ReceivedMessage(operation.msg, 0, self.session.dialect, light=True))
                case _:
                    pass

    def carry_out(self, item: Operation | Refusal, waiting: Waiting) -> None:
        if isinstance(item, Refusal):
            self._refuse(item)
        elif isinstance(item, Request) and item.after_stop is not None:
            self._carry_out_after_stop(item, waiting)
        else:
            self._carry_out(item, waiting)
        if self.node.identity is None:
            self.inbox.close()

    def reject(self, operation: Operation, reason: str) -> None:
        """Report an operation that is not carried out; an operation with an answer gets it."""
        self.status.reject(operation, reason)
        match operation:
            case ops.Publish():
                self.topics.reject(operation, reason)
            case ops.CallService():
                self.services.reject_call(operation.service, name_and_id(operation)[1], reason)
            case ops.SendActionGoal():
                self.actions.reject_goal(operation.action, operation.id, reason)
            case _:
                pass

    def _carry_out_after_stop(self, request: Request, waiting: Waiting) -> None:
        """Carry out a request whose client names the last stop that it knew of; stops and cancels need none."""
        try:
            ends = is_stop(request, self._graph) or is_cancel(request, self._graph)
            epoch = waiting.epoch if ends else epoch_after(request.after_stop, waiting.epoch)
        except OperationError as error:
            self.reject(request, str(error))
        else:
            with arrived_in(epoch):
                self._carry_out(request, waiting)

    def _carry_out(self, operation: Operation, waiting: Waiting) -> None:
        dialect = self.session.dialect
        try:
            refusal = self._authorizer.refusal(operation)
            if refusal is not None:
                self.reject(operation, refusal)
                return
            self._detect_dialect(operation)
            self._serve(operation, waiting)
        except (ProtocolError, GraphError) as error:
            self.status.refuse_error(operation.op, error, operation.id)
        except PostponedError:
            raise
        except Exception:  # a bug in serving one operation must not take the client with it
            log.exception("%s: %s failed", self.node, operation.op)
        else:
            self.status.acknowledge(operation)
        if self.session.dialect != dialect:
            self.status.report(
                "info", operation, "its type exists only in ROS 1, whose spelling this client gets from now on"
            )

    def _detect_dialect(self, operation: Operation) -> None:
        """Set the dialect to ROS 1 when the client names a type that exists only there."""
        if type(operation) not in _TYPE_FIELDS:
            return
        field, kind = _TYPE_FIELDS[type(operation)]
        name = getattr(operation, field)
        # Clients of both generations call rosapi's types so.
        if not isinstance(name, str) or name.startswith("rosapi/"):
            return
        if self._graph.message_types.registry.exists_only_in_ros1(name, kind):
            self.session.dialect = "ros1"

    def _serve(self, operation: Operation, waiting: Waiting) -> None:
        """Serve an operation; fragments and pictures are unpacked before."""

        def received(message: Any) -> ReceivedMessage:
            size_bytes, dialect = waiting.size_bytes, self.session.dialect
            return waiting.message or ReceivedMessage(message, size_bytes, dialect, light=waiting.light)

        match operation:
            case ops.Publish():
                self.topics.publish(operation, received(operation.msg))
            case ops.CallService():
                self.services.call(operation, received(operation.args))
            case ops.ServiceResponse():
                self.services.respond(operation, received({} if operation.values is None else operation.values))
            case ops.SendActionGoal():
                self.actions.send_goal(operation, received(operation.args))
            case ops.ActionFeedback():
                self.actions.report_feedback(operation, received(operation.values))
            case ops.ActionResult():
                self.actions.finish(operation, received({} if operation.values is None else operation.values))
            case ops.CancelActionGoal():
                self.actions.cancel(operation)
            case ops.Subscribe():
                self.topics.subscribe(operation)
            case ops.Unsubscribe():
                self.topics.unsubscribe(operation)
            case ops.Advertise():
                self.topics.advertise(operation)
            case ops.Unadvertise():
                self.topics.unadvertise(operation)
            case ops.AdvertiseService():
                self.services.advertise(operation)
            case ops.UnadvertiseService():
                self.services.unadvertise(operation)
            case ops.AdvertiseAction():
                self.actions.advertise(operation)
            case ops.UnadvertiseAction():
                self.actions.unadvertise(operation)
            case ops.SetLevel():
                self.status.set_level(operation)
            case ops.Status():
                self.status.log_status(operation)
            case ops.Auth():
                self._authenticate(operation)

    def _authenticate(self, operation: ops.Auth) -> None:
        """Give the client the identity of the token that it shows, or disconnect it."""
        context, node, report = self._context, self.node, self.status.report
        access, throttle, connection = context.gateway.access, context.gateway.throttle, context.connection
        if not access.tokens.any:
            report("info", operation, "this server has no tokens; nothing changes")
            return
        wait = throttle.refusal(connection.address)
        if wait is not None:
            self._disconnect(wait)
            return
        identity = access.identify(operation)
        if isinstance(identity, str):
            throttle.record_failure(connection.address, operation.token)
            self._disconnect(f"auth: {identity}")
            return
        access.one_time_tokens.release(self._shown)
        self._shown = identity
        former, is_new = node.name, identity != node.identity
        self._authorizer.authenticate(identity)
        node.name = display_name(identity, node.address)
        connection.limit_messages()
        role = identity.role.name.lower()
        # The same token may come again and again.
        if is_new:
            log.info("%s is %s, with the role %s", former, node.name, role)
        report("info", operation, f"this client is {identity.name}, with the role {role}")

    def _disconnect(self, reason: str) -> None:
        self.node.identity = None
        self._authorizer.leave()
        log.warning("%s: %s; closing", self.node, reason)
        self._context.connection.disconnect(reason)

    def _refuse(self, refusal: Refusal) -> None:
        """Report an operation that cannot be read; clients that wait for it, or for its answer, get a failure."""
        self.status.refuse(refusal)
        match refusal.op:
            case "call_service":
                self.services.reject_call(refusal.called, refusal.id, refusal.text)
            case "send_action_goal":
                self.actions.reject_goal(refusal.called, refusal.id, refusal.text)
            case "service_response":
                self.services.fail(refusal.id, refusal.text)
            case "action_result":
                self.actions.fail(refusal.id, refusal.text)


# Field of an operation with its type, and what that is a type of.
_TYPE_FIELDS: Mapping[type[Operation], tuple[str, Kind]] = {
    ops.Subscribe: ("type", "msg"),
    ops.Advertise: ("type", "msg"),
    ops.CallService: ("type", "srv"),
    ops.AdvertiseService: ("type", "srv"),
    ops.SendActionGoal: ("action_type", "action"),
    ops.AdvertiseAction: ("type", "action"),
}

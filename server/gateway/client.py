"""Client of the graph, without any socket: carries the operations of one client out and queues what it gets."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Sequence

from protocol.errors import ProtocolError
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
from protocol.session import Packed, Refusal
from server.errors import GraphError
from server.gateway.client_actions import ClientActions
from server.gateway.client_auth import AuthContext, ClientAuth
from server.gateway.client_context import ClientContext
from server.gateway.client_services import ClientServices
from server.gateway.client_topics import ClientTopics, StrictPublication
from server.gateway.inbox import Inbox, Scheduling
from server.gateway.transport import Transport
from server.graph.message_types import PostponedError, ReceivedMessage

log = logging.getLogger("armbridge.gateway")


class Client:
    """Client of rosbridge.

    Args:
        context: the parts that its topics, services, actions and authentication share.
    """

    def __init__(self, context: ClientContext, auth: AuthContext, scheduling: Scheduling, transport: Transport) -> None:
        self.node = context.node
        self.session = context.session
        self.status = context.status
        self.received_messages = 0
        self._context = context
        self._graph = context.graph
        self._authorizer = auth.access.authorizer(context.node, context.graph)
        self._topics = ClientTopics(context, self._authorizer)
        self._services = ClientServices(context)
        self._actions = ClientActions(context)
        self._auth = ClientAuth(context, auth, self._authorizer)
        self.inbox = Inbox(self, context.session, context.graph.message_types, scheduling, transport, context.clock)

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
        self._release()

    def _release(self) -> None:
        """Let go of what leads back here, so that all of the client is freed at once, without the garbage collector."""
        self._context.release()
        self._auth.release()
        self._topics.release()
        self.inbox.release()

    # As the inbox's handler.

    @property
    def identified(self) -> bool:
        """False while nothing but the op ``auth`` is read of the client."""
        return self.node.identity is not None

    def admit_frame(self, frame: str | bytes) -> bool:
        """Check a frame before it is read; return False when it is not to be read."""
        return self.identified or self._auth.check_first_frame(frame)

    def admit_first(self, items: Sequence[Operation | Refusal | Packed]) -> bool:
        """Check the operations of an unidentified client's frame; return False when they are refused."""
        return self._auth.check_first_operation(items)

    def read_strictly(self, frame: str) -> StrictPublication | None:
        """Read a frame by itself."""
        publication = self._topics.read_strictly(frame)
        return publication if publication is not None and self.session.reads_by_itself(frame) else None

    def publish_strictly(self, publication: StrictPublication) -> bool:
        """Publish a message, or return False."""
        try:
            return self._topics.publish_strictly(publication)
        except (ProtocolError, GraphError) as error:
            self.status.refuse_error("publish", error)
        except Exception:  # a bug in serving one operation must not take the client with it
            log.exception("%s: publish failed", self.node)
        return True

    def is_urgent(self, operation: Operation) -> bool:
        """Return True for an operation that stops the arm or cancels a goal."""
        return self._authorizer.is_urgent(operation)

    def is_repeated(self, operation: Operation) -> bool:
        """Return True for a cancel: its goal may wait behind other operations of this client."""
        return self._authorizer.is_cancel(operation)

    def repeat(self, operation: Operation) -> None:
        """Cancel again, without an answer."""
        if self._authorizer.refusal(operation) is not None:
            return
        # The client got the errors the first time.
        with contextlib.suppress(ProtocolError, GraphError, PostponedError):
            match operation:
                case CancelActionGoal():
                    self._actions.cancel(operation)
                case CallService():
                    self._services.call_unanswered(operation)
                case Publish():
                    self._topics.publish(operation, _message_of(operation, 0, light=True))
                case _:
                    pass

    def carry_out(
        self, item: Operation | Refusal, size_bytes: int, message: ReceivedMessage | None, *, light: bool = False
    ) -> None:
        """Carry an operation out, or tell of a refusal."""
        if isinstance(item, Refusal):
            self._refuse(item)
        else:
            self._carry_out(item, message or _message_of(item, size_bytes, light=light))
        if self.node.identity is None:
            self.inbox.close()

    def reject(self, operation: Operation, reason: str) -> None:
        """Report an operation that is not carried out; an operation with an answer gets it."""
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
                raise AssertionError(f"no handler for op {operation.op}")

    def _refuse(self, refusal: Refusal) -> None:
        """Report an operation that cannot be read; clients that wait for it, or for its answer, get a failure."""
        self.status.refuse(refusal)
        match refusal.op:
            case "call_service":
                self._services.reject_call(refusal.called, refusal.id, refusal.text)
            case "send_action_goal":
                self._actions.reject_goal(refusal.called, refusal.id, refusal.text)
            case "service_response":
                self._services.fail(refusal.id, refusal.text)
            case "action_result":
                self._actions.fail(refusal.id, refusal.text)


def _message_of(operation: Operation, size_bytes: int, *, light: bool) -> ReceivedMessage:
    """Return the message in an operation; an empty one for operations without."""
    match operation:
        case Publish():
            return ReceivedMessage(operation.msg, size_bytes, light=light)
        case CallService() | SendActionGoal():
            return ReceivedMessage(operation.args, size_bytes, light=light)
        case ServiceResponse() | ActionResult() | ActionFeedback():
            return ReceivedMessage({} if operation.values is None else operation.values, size_bytes, light=light)
        case _:
            return _NO_MESSAGE


_NO_MESSAGE = ReceivedMessage({}, 0)

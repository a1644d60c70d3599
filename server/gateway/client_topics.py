"""Topics of one client: its publications, and its subscriptions with what is delivered to them."""

from __future__ import annotations

from collections.abc import Sequence

from protocol.errors import OperationError, ProtocolError
from protocol.operations import Advertise, Publish, Subscribe, Unadvertise, Unsubscribe, qualify
from protocol.publication import PublishedMessage
from server.gateway.client_context import ClientContext
from server.graph.message_types import PostponedError, ReceivedMessage
from server.graph.topics import Subscriber

# rosbridge_server's lifespan of messages that are published without latch (rosbridge_library, internal/publishers.py):
# clients publish right after they have advertised, when nobody has had the time to subscribe.
LIFESPAN_S = 1.0

NO_LATCH = "field latch: has no effect, it needs the role operate"


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

    def release(self) -> None:
        """Let go of the subscriber, which the graph has forgotten."""
        del self._subscriber

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
        queued = [self._queue(published) for published in (earlier[-1:] if newest_only else earlier)]
        # Not before all are there: of what waits for a throttle, only the last ones are to be sent.
        if any(queued):
            self._client.wake()

    def _deliver(self, published: PublishedMessage) -> None:
        if self._queue(published):
            self._client.wake()

    def _queue(self, published: PublishedMessage) -> bool:
        """Send a message if the socket takes it at once; return True when it is queued instead."""
        try:
            return self._session.deliver(published, self._client.clock(), self._client.send_at_once)
        except ProtocolError as error:
            self._client.status.refuse_error("subscribe", error)
            return False

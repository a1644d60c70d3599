"""Topics of one client: its publications and its subscriptions."""

from __future__ import annotations

from collections.abc import Sequence

from protocol.errors import OperationError, ProtocolError
from protocol.names import qualify
from protocol.operations import Advertise, Publish, Subscribe, Unadvertise, Unsubscribe
from protocol.publication import Publication
from server.gateway.client_context import ClientContext
from server.graph.topics import Subscriber

# rosbridge_server's lifespan of messages that are published without latch (rosbridge_library, internal/publishers.py):
# clients publish right after they have advertised, when nobody has had the time to subscribe.
LIFESPAN_S = 1.0


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
        self._graph.advertise(self._node, topic, operation.type, latch=operation.latch)
        try:
            self._session.publications.add(operation)
        except OperationError:
            if topic not in self._session.publications:
                self._graph.unadvertise(self._node, topic)
            raise

    def unadvertise(self, operation: Unadvertise) -> None:
        """Withdraw an advertisement."""
        topic = qualify(operation.topic)
        # A client that publishes without having advertised is a publisher too, under no id.
        implicit = topic not in self._session.publications and self._node in self._graph.publishers(topic)
        if implicit or self._session.publications.remove(operation.topic, operation.id):
            self._graph.unadvertise(self._node, topic)

    def publish(self, operation: Publish) -> None:
        """Publish a message."""
        topic = qualify(operation.topic)
        message = self._message(topic, operation)
        self._graph.publish(self._node, topic, message, latch=operation.latch, lifespan_s=LIFESPAN_S)

    def reject(self, operation: Publish, problem: str) -> None:
        """Have the topic's owner answer a message that the client may not publish."""
        topic = qualify(operation.topic)
        self._graph.turn_away(self._node, topic, self._message(topic, operation), problem)

    def _message(self, topic: str, operation: Publish) -> object:
        if self._session.dialect == "ros1":
            return self._client.translator.from_client(self._graph.topic_type(topic), operation.msg)
        return operation.msg

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

    def _deliver_earlier(self, topic: str, earlier: Sequence[Publication]) -> None:
        subscription = self._session.subscriptions.get(topic)
        # Under a throttle that drops, one of them gets through: it shall be the newest.
        newest_only = subscription is not None and subscription.skips
        for publication in earlier[-1:] if newest_only else earlier:
            self._deliver(publication, wake=False)
        # Not before all are there: of what waits for a throttle, only the last ones are to be sent.
        self._client.wake()

    def _deliver(self, publication: Publication, *, wake: bool = True) -> None:
        try:
            queued = self._session.deliver(publication, self._client.clock(), self._client.send_at_once)
        except ProtocolError as error:
            self._client.status.refuse_error("subscribe", error)
        else:
            if queued and wake:
                self._client.wake()

"""Topics of one client: its publications, and its subscriptions with their deliveries."""

import re

from protocol.errors import OperationError, ProtocolError
from protocol.operations import Advertise, Publish, Subscribe, Unadvertise, Unsubscribe, qualify
from protocol.publication import PublishedMessage
from server.access.authorization import Authorizer
from server.gateway.client_context import ClientContext
from server.graph.message_types import PostponedError, ReceivedMessage
from server.graph.topics import Subscriber

# rosbridge_server's lifespan of messages that are published without latch (rosbridge_library, internal/publishers.py):
# clients publish right after they have advertised, when nobody has had the time to subscribe.
LIFESPAN_S = 1.0

NO_LATCH = "field latch: has no effect, it needs the role operate"


# Topics of a client whose messages are read the strict way; messages of further topics are read the general way.
MAX_STRICT_TOPICS = 1000

# The topic's place in a publish operation, which is checked when the frame is read.
_TOPIC = re.compile(r'"topic"\s*:\s*"([^"\\]+)"')
_TOPIC_WITHIN = 1024


def _is_like_stop(topic: str) -> bool:
    return topic.lower().rstrip("/").endswith("stop")


class ClientTopics:
    """Topics of one client."""

    def __init__(self, context: ClientContext, authorizer: Authorizer) -> None:
        self._client = context
        self._authorizer = authorizer
        # Topics on which the client has published, by its own spelling of each.
        self._strict_topics: dict[str, str] = {}
        self._node = context.node
        self._session = context.session
        self._graph = context.graph
        self.subscriber = Subscriber(self._deliver)

    def advertise(self, operation: Advertise) -> None:
        topic = qualify(operation.topic)
        self._graph.advertise(self._node, topic, operation.type, latch=self._latches(operation))
        try:
            self._session.publications.add(operation)
        except OperationError:
            if topic not in self._session.publications:
                self._graph.unadvertise(self._node, topic)
            raise
        if operation.latch and not self._latches(operation):
            self._client.status.report("warning", operation, NO_LATCH)
        self._hint_at_misspelt(operation, topic)

    def _hint_at_misspelt(self, operation: Advertise | Subscribe, topic: str) -> None:
        if not self._client.status.gets_hints:
            return
        users = {*self._graph.publishers(topic), *self._graph.subscribers(topic)}
        if users == {self._node} and (hint := self._graph.topic_hint(topic)):
            self._client.status.hint(operation, f"topic {topic}: nobody else uses it{hint}")

    def unadvertise(self, operation: Unadvertise) -> None:
        topic = qualify(operation.topic)
        # A client that publishes without having advertised is a publisher too, under no id.
        implicit = topic not in self._session.publications and self._node in self._graph.publishers(topic)
        if implicit or self._session.publications.remove(operation.topic, operation.id):
            self._graph.unadvertise(self._node, topic)

    def publish(self, operation: Publish, message: ReceivedMessage) -> None:
        topic = qualify(operation.topic)
        self._answer_misspelt_stop(operation, topic)
        latch = self._latches(operation)
        lost = self._graph.publish(self._node, topic, message, latch=latch, lifespan_s=LIFESPAN_S)
        lost = NO_LATCH if operation.latch and not latch else lost or self._graph.remarks.get(topic)
        if lost is not None:
            self._client.status.report("warning", operation, lost)
        # Of a topic named like a stop each message is looked at: its reader may leave.
        if not operation.latch and not _is_like_stop(topic):
            reader = self._graph.strict_reader(self._node, topic)
            if reader is not None and len(self._strict_topics) < MAX_STRICT_TOPICS:
                self._strict_topics[operation.topic] = topic

    def _answer_misspelt_stop(self, operation: Publish, topic: str) -> None:
        if _is_like_stop(topic) and not self._graph.subscribers(topic):
            text = f"publish: topic {topic}: nobody reads it, so nothing was stopped; /stop stops the arm"
            self._client.status.refuse_misspelt_stop(text, operation.id)

    def publish_strictly(self, frame: str) -> bool:
        """Publish a message where the client has published before; False for a frame to be read the general way."""
        if not self._strict_topics:
            return False
        found = _TOPIC.search(frame, 0, _TOPIC_WITHIN)
        spelled = "" if found is None else found[1]
        topic = self._strict_topics.get(spelled)
        if topic is None:
            return False
        reader = self._graph.strict_reader(self._node, topic) if spelled in self._authorizer.settled else None
        message = None if reader is None else reader.read(frame, spelled)
        if message is None:
            del self._strict_topics[spelled]
            return False
        self._graph.relay(self._node, topic, message, LIFESPAN_S)
        return True

    def _latches(self, operation: Advertise | Publish) -> bool:
        """Return True for an operation that latches, which has no effect for a client that may only look."""
        return operation.latch and not self._node.is_viewer

    def reject(self, operation: Publish, problem: str) -> None:
        """Have the topic's owner answer a message that the client may not publish."""
        received = ReceivedMessage(operation.msg, 0, self._session.dialect)
        topic = qualify(operation.topic)
        self._answer_misspelt_stop(operation, topic)
        try:
            self._graph.reject_unauthorized(self._node, topic, received, problem)
        except PostponedError:
            # A message of this size is refused without its values.
            self._graph.reject_unauthorized(self._node, topic, None, problem)

    def subscribe(self, operation: Subscribe) -> None:
        """Subscribe to a topic; messages that were published before the subscription follow at once.

        A further subscription of the same client gets the latched message again, as from rosbridge
        (rosbridge_library/internal/subscribers.py, MultiSubscriber.subscribe).
        """
        topic = qualify(operation.topic)
        earlier = self._graph.subscribe(self._node, topic, operation.type, self.subscriber)
        try:
            first = self._session.subscriptions.add(operation)
        except OperationError:
            if topic not in self._session.subscriptions:
                self._graph.unsubscribe(self._node, topic)
            raise
        if first:
            subscription = self._session.subscriptions.get(topic)
            # A throttle lets the newest message through, or the last ones where they wait for it.
            if self._session.newest_only or (subscription is not None and subscription.skips):
                earlier = earlier[-1:]
            elif subscription is not None and subscription.paced:
                earlier = earlier[-subscription.queue_length :]
            queued = [self._queue(published) for published in earlier]
            if any(queued):
                self._client.wake()
            self._hint_at_misspelt(operation, topic)
        elif (latched := self._graph.latched(topic)) is not None:
            self._deliver(latched)

    def unsubscribe(self, operation: Unsubscribe) -> None:
        if self._session.subscriptions.remove(operation.topic, operation.id):
            self._graph.unsubscribe(self._node, qualify(operation.topic))

    def _deliver(self, published: PublishedMessage) -> None:
        if self._queue(published):
            self._client.wake()

    def _queue(self, published: PublishedMessage) -> bool:
        try:
            return self._session.deliver(published, self._client.clock())
        except ProtocolError as error:
            self._client.status.refuse_error("subscribe", error)
            return False

"""The topics of one client: what it publishes, and what it has subscribed to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from protocol.errors import OperationError, ProtocolError
from protocol.names import qualify
from protocol.operations import Advertise, Operation, Publish, Subscribe, Unadvertise, Unsubscribe
from protocol.publication import Parcel, Publication
from protocol.session import Session
from server.gateway.spelling import Spelling
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber

# rosbridge_server's lifespan of what is published without latch (rosbridge_library, internal/publishers.py): clients
# publish right after they have advertised, when nobody has had the time to subscribe.
LIFESPAN_S = 1.0


class ClientTopics:
    """Carries a client's operations on topics out.

    Args:
        node: the client.
        session: its protocol state.
        graph: where the topics are.
        spelling: how the client spells messages.
        clock: monotonic time [s].
        wake: called when there is something to send.
        refuse: told of a message that cannot be encoded as the client wants it.
        send_at_once: sends a message if the socket takes it without waiting, and says whether it has.
    """

    def __init__(
        self,
        node: Node,
        session: Session,
        graph: Graph,
        spelling: Spelling,
        clock: Callable[[], float],
        wake: Callable[[], None],
        refuse: Callable[[str, ProtocolError], None],
        send_at_once: Callable[[Parcel], bool],
    ) -> None:
        self._node = node
        self._session = session
        self._graph = graph
        self._spelling = spelling
        self._clock = clock
        self._wake = wake
        self._refuse = refuse
        self._send_at_once = send_at_once
        self._subscriber = Subscriber(self._deliver)

    @property
    def handlers(self) -> Mapping[type[Operation], Callable[..., None]]:
        """What carries which operation out."""
        return {
            Advertise: self._advertise,
            Unadvertise: self._unadvertise,
            Publish: self._publish,
            Subscribe: self._subscribe,
            Unsubscribe: self._unsubscribe,
        }

    def _advertise(self, operation: Advertise) -> None:
        topic = qualify(operation.topic)
        self._spelling.learn(operation.type, "msg")
        self._graph.advertise(self._node, topic, operation.type, latch=operation.latch)
        try:
            self._session.publications.add(operation)
        except OperationError:
            if topic not in self._session.publications:
                self._graph.unadvertise(self._node, topic)
            raise

    def _unadvertise(self, operation: Unadvertise) -> None:
        topic = qualify(operation.topic)
        # Who publishes without having advertised is a publisher too, under no id.
        implicit = topic not in self._session.publications and self._node in self._graph.publishers(topic)
        if implicit or self._session.publications.remove(operation.topic, operation.id):
            self._graph.unadvertise(self._node, topic)

    def _publish(self, operation: Publish) -> None:
        topic = qualify(operation.topic)
        message = self._message(topic, operation)
        self._graph.publish(self._node, topic, message, latch=operation.latch, lifespan_s=LIFESPAN_S)

    def turn_away(self, operation: Publish, problem: str) -> None:
        """Have a message answered that the client may not publish."""
        topic = qualify(operation.topic)
        self._graph.turn_away(self._node, topic, self._message(topic, operation), problem)

    def _message(self, topic: str, operation: Publish) -> object:
        if self._session.dialect == "ros1":
            return self._spelling.from_client(self._graph.topic_type(topic), operation.msg)
        return operation.msg

    def _subscribe(self, operation: Subscribe) -> None:
        topic = qualify(operation.topic)
        self._spelling.learn(operation.type, "msg")
        earlier = self._graph.subscribe(self._node, topic, operation.type, self._subscriber)
        try:
            first = self._session.subscriptions.add(operation)
        except OperationError:
            if topic not in self._session.subscriptions:
                self._graph.unsubscribe(self._node, topic)
            raise
        if first:
            self._deliver_earlier(topic, earlier)

    def _unsubscribe(self, operation: Unsubscribe) -> None:
        if self._session.subscriptions.remove(operation.topic, operation.id):
            self._graph.unsubscribe(self._node, qualify(operation.topic))

    def _deliver_earlier(self, topic: str, earlier: Sequence[Publication]) -> None:
        subscription = self._session.subscriptions.get(topic)
        # Under a throttle that drops, one of them gets through: it shall be the newest.
        newest_only = subscription is not None and subscription.skips
        for publication in earlier[-1:] if newest_only else earlier:
            self._deliver(publication, wake=False)
        # Not before all are there: of what waits for a throttle, only the last ones are to be sent.
        self._wake()

    def _deliver(self, publication: Publication, *, wake: bool = True) -> None:
        try:
            queued = self._session.deliver(publication, self._clock(), self._send_at_once)
        except ProtocolError as error:
            self._refuse("subscribe", error)
        else:
            if queued and wake:
                self._wake()

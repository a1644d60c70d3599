"""One client as a node of the graph: carries its operations out, queues what it gets; without any socket."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

from protocol.errors import OperationError, ProtocolError
from protocol.limits import Limits
from protocol.names import qualify
from protocol.operations import Advertise, Operation, Publish, Subscribe, Unadvertise, Unsubscribe
from protocol.publication import Publication
from protocol.session import Refusal, Session
from server.errors import GraphError
from server.graph import Graph, Node, Subscriber

log = logging.getLogger("armbridge.gateway")


class Client:
    """A rosbridge client.

    Args:
        name: how logs call it.
        graph: what it takes part in.
        limits: what it may cost.
        clock: monotonic time [s].
        wake: called when there is something to send.
    """

    def __init__(
        self, name: str, graph: Graph, limits: Limits, clock: Callable[[], float], wake: Callable[[], None]
    ) -> None:
        self.node = Node(name)
        self.session = Session(limits)
        self._graph = graph
        self._clock = clock
        self._wake = wake
        self._subscriber = Subscriber(self._deliver)
        self._handlers: Mapping[type[Operation], Callable[..., None]] = {
            Advertise: self._advertise,
            Unadvertise: self._unadvertise,
            Publish: self._publish,
            Subscribe: self._subscribe,
            Unsubscribe: self._unsubscribe,
        }

    def receive_frame(self, frame: str | bytes) -> None:
        """Carry out what a frame asks for; nothing in it can raise."""
        for item in self.session.receive_frame(frame):
            if isinstance(item, Refusal):
                self._refuse(item)
            else:
                self._carry_out(item)

    def leave(self) -> None:
        """Take the client out of the graph."""
        self._graph.remove(self.node)
        if self.session.dropped:
            log.warning("%s: %d messages were dropped because it read too slowly", self.node, self.session.dropped)

    def _carry_out(self, operation: Operation) -> None:
        try:
            self._handlers[type(operation)](operation)
        except OperationError as error:
            self._refuse(Refusal(operation.op, operation.id, str(error)))
        except (ProtocolError, GraphError) as error:
            self._refuse(Refusal(operation.op, operation.id, f"{operation.op}: {error}"))
        except Exception:  # a bug in serving one operation must not take the client with it
            log.exception("%s: %s failed", self.node, operation.op)

    def _refuse(self, refusal: Refusal) -> None:
        log.warning("%s: refused: %s", self.node, refusal.text)

    def _advertise(self, operation: Advertise) -> None:
        topic = qualify(operation.topic)
        self._graph.advertise(self.node, topic, operation.type, latch=operation.latch)
        try:
            self.session.publications.add(operation)
        except OperationError:
            if topic not in self.session.publications:
                self._graph.unadvertise(self.node, topic)
            raise

    def _unadvertise(self, operation: Unadvertise) -> None:
        if self.session.publications.remove(operation.topic, operation.id):
            self._graph.unadvertise(self.node, qualify(operation.topic))

    def _publish(self, operation: Publish) -> None:
        self._graph.publish(self.node, qualify(operation.topic), operation.msg)

    def _subscribe(self, operation: Subscribe) -> None:
        topic = qualify(operation.topic)
        latched = self._graph.subscribe(self.node, topic, operation.type, self._subscriber)
        try:
            first = self.session.subscriptions.add(operation)
        except OperationError:
            if topic not in self.session.subscriptions:
                self._graph.unsubscribe(self.node, topic)
            raise
        if first and latched is not None:
            self._deliver(latched)

    def _unsubscribe(self, operation: Unsubscribe) -> None:
        if self.session.subscriptions.remove(operation.topic, operation.id):
            self._graph.unsubscribe(self.node, qualify(operation.topic))

    def _deliver(self, publication: Publication) -> None:
        self.session.deliver(publication, self._clock())
        self._wake()

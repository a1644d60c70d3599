"""Topics shared with other machines: published by this server, and subscribed to by it."""

from __future__ import annotations

import contextlib
import functools
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, TypeAlias

import zenoh
import zenoh.ext

from protocol.codecs import cdr
from protocol.errors import MessageError
from protocol.publication import PublishedMessage
from robot.stop_epochs import STOP_EPOCHS
from server.access.authorization import Authorizer, rule_of_topic
from server.arrival import arrived_in
from server.errors import GraphError
from server.graph.actions import ACTION_PARTS
from server.graph.message_types import BYTES_AT_ONCE, ReceivedMessage
from server.graph.topics import Subscriber
from server.zenoh.network import Declared, Network, SharedEndpoints, SharedNames
from server.zenoh.rmw import Attachment, Endpoint, Entity, EntityKind, gid_of, is_name
from server.zenoh.session import ReceiveQueue

Publisher: TypeAlias = zenoh.Publisher | zenoh.ext.AdvancedPublisher

# Messages of a topic that wait for the network, the newest; as many as ROS keeps by default.
MAX_WAITING = 10


class SharedTopic(NamedTuple):
    """Topic to publish on the network, or to subscribe to there."""

    endpoint: Endpoint
    latched: bool = False


class OutgoingTopic:
    """Topic of this server that is published on the network."""

    def __init__(self, network: Network, name: str, topic: SharedTopic) -> None:
        self._network = network
        self._name = name
        self._topic = topic
        token = network.tokens.entity(EntityKind.PUBLISHER, topic.endpoint, latched=topic.latched)
        self._gid = gid_of(token)
        self._waiting: deque[PublishedMessage] = deque(maxlen=MAX_WAITING)
        self._submitted = False
        self._sent = 0
        # Set in the session's thread, which alone uses it.
        self._publisher: Publisher | None = None
        self._declaration = network.declare(token, self._declare)
        subscriber = Subscriber(self._queue)
        for published in network.graph.subscribe(network.node, name, topic.endpoint.type_name, subscriber):
            self._queue(published)

    def close(self) -> None:
        self._network.graph.unsubscribe(self._network.node, self._name)
        self._declaration.undeclare()

    def _queue(self, published: PublishedMessage) -> None:
        # Messages from the network are there already.
        if published.publisher is self._network.node:
            return
        self._network.dropped += len(self._waiting) == MAX_WAITING
        self._waiting.append(published)
        if not self._submitted:
            # First, since the job may have been done when the call returns.
            self._submitted = True
            if not self._network.thread.submit(self._send):
                self._submitted = False

    def _declare(self, session: zenoh.Session) -> Declared:
        key = self._topic.endpoint.key(self._network.domain_id)
        if self._topic.latched:
            cache = zenoh.ext.CacheConfig(1)
            self._publisher = zenoh.ext.declare_advanced_publisher(session, key, cache=cache, publisher_detection=True)
        else:
            self._publisher = session.declare_publisher(key)
        return self._publisher

    def _send(self, _session: zenoh.Session) -> None:
        # First, so that later messages are submitted again.
        self._submitted = False
        for _ in range(len(self._waiting)):
            published = self._waiting.popleft()
            octets = cdr.serialize(self._network.registry, published.type_name, published.msg)
            self._sent += 1
            attachment = Attachment(self._sent, time.time_ns(), self._gid).encode()
            if self._publisher is not None:
                self._publisher.put(octets, attachment=attachment)


class OutgoingTopics:
    """All topics of this server that are published on the network."""

    def __init__(self, network: Network, names: SharedNames) -> None:
        self._network = network
        self._names = names
        self._topics = SharedEndpoints(network, functools.partial(OutgoingTopic, network))

    def refresh(self, foreign: frozenset[str]) -> None:
        """Publish the topics that exist now, and no others."""
        self._topics.follow(self._wanted(foreign))

    def _wanted(self, foreign: frozenset[str]) -> dict[str, SharedTopic]:
        graph, found = self._network.graph, dict[str, SharedTopic]()
        kept: list[str] = []
        for name, type_name in graph.topic_names.types().items():
            if not set(graph.publishers(name)) - {self._network.node}:
                continue
            if not self._names.matches(name):
                kept.append(name)
            else:
                # A client may publish to another server's topic, by its name there.
                is_foreign = name in foreign and not self._network.is_own_publication(name)
                network_name = name if is_foreign else self._network.to_network(name)
                endpoint = self._network.endpoint(network_name, type_name, "msg")
                if endpoint is not None:
                    found[name] = SharedTopic(endpoint, graph.is_latched(name))
        # In the log, and to each client that publishes there.
        reason = "of a client does not go to other machines; zenoh.publish does not list it"
        kept = [name for name in kept if self._is_of_clients(name)]
        graph.remark({name: f"topic {name} {reason}" for name in kept})
        for name in kept:
            self._network.warn(f"{name} {reason}")
        return found

    def _is_of_clients(self, name: str) -> bool:
        """Return True for a topic that this server itself neither publishes nor subscribes to."""
        is_own = self._network.is_own_publication(name) or self._network.is_own_subscription(name)
        return is_name(name) and ACTION_PARTS not in name and not is_own


class IncomingTopic:
    """Topic of other machines that this server subscribes to; GraphError if another topic has its name."""

    def __init__(
        self, network: Network, received: ReceiveQueue[IncomingMessage], name: str, source: SharedTopic
    ) -> None:
        self.name = name
        self.source = source
        self.waiting: deque[IncomingMessage] = deque(maxlen=MAX_WAITING)
        self.decoding = False
        self._network = network
        self._received = received
        rule = rule_of_topic(name, network.graph)
        # A flood of goals must neither delay nor drop a stop.
        self._ahead_as = name if rule.at_once and rule.at_once_data is None else ""
        self._key = source.endpoint.key(network.domain_id)
        network.graph.advertise(network.node, name, source.endpoint.type_name, latch=source.latched)
        token = network.tokens.entity(EntityKind.SUBSCRIPTION, source.endpoint, latched=source.latched)
        self._declaration = network.declare(token, self._declare)

    def close(self) -> None:
        self._network.graph.unadvertise(self._network.node, self.name)
        self._declaration.undeclare()

    def _declare(self, session: zenoh.Session) -> Declared:
        handler, remote = zenoh.handlers.Callback(self._on_sample, indirect=False), zenoh.Locality.REMOTE
        if not self.source.latched:
            return session.declare_subscriber(self._key, handler, allowed_origin=remote)
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
        return zenoh.ext.declare_advanced_subscriber(
            session, self._key, handler, allowed_origin=remote, history=history
        )

    def _on_sample(self, sample: zenoh.Sample) -> None:
        # A message for every key that matches a pattern is ignored: it would be a goal here, and a stop there.
        if str(sample.key_expr) != self._key:
            return
        limit = self._network.max_message_bytes
        if len(sample.payload) > limit:
            reason = f"more than {limit} bytes (server.limits.max_message_bytes)"
            self._network.warn(f"a message on {self.source.endpoint.name} is left out, it has {reason}")
            return
        octets = bytes(sample.payload)
        message = IncomingMessage(self, octets, STOP_EPOCHS.present)
        self._received.put(message, len(octets), ahead_as=self._ahead_as)


class IncomingMessage(NamedTuple):
    """Message of another machine as CDR."""

    topic: IncomingTopic
    octets: bytes
    epoch: int


class IncomingTopics:
    """All topics of other machines that this server subscribes to."""

    def __init__(self, network: Network, names: SharedNames, authorizer: Authorizer) -> None:
        self._network = network
        self._names = names
        self._authorizer = authorizer
        self.received = ReceiveQueue[IncomingMessage](network.loop, self._publish)
        self._topics = SharedEndpoints(network, functools.partial(IncomingTopic, network, self.received))

    def refresh(self, entities: tuple[Entity, ...]) -> None:
        """Subscribe to the topics that exist now, and to no others."""
        self._topics.follow(self._wanted(self._sources(entities)))

    def _wanted(self, sources: Mapping[str, SharedTopic]) -> dict[str, SharedTopic]:
        network, found = self._network, dict[str, SharedTopic]()
        for name, type_name in network.graph.topic_names.types().items():
            if self._names.matches(name) and network.is_own_subscription(name) and not network.is_own_publication(name):
                own = network.endpoint(network.to_network(name), type_name, "msg")
                if own is not None:
                    # Not latched: a latched goal is an old one; it must not move the arm of a server that starts.
                    found[name] = SharedTopic(own)
        for name, source in sources.items():
            if name not in found and not self._is_taken(name, source.endpoint.name):
                found[name] = source
        return found

    def _sources(self, entities: Iterable[Entity]) -> dict[str, SharedTopic]:
        found = dict[str, SharedTopic]()
        for entity in entities:
            endpoint, name = entity.endpoint, self._network.to_local(entity.endpoint.name)
            if entity.kind is not EntityKind.PUBLISHER or not self._names.matches(name):
                continue
            known = found.get(name)
            if known is not None and known.endpoint == endpoint:
                found[name] = known._replace(latched=known.latched or entity.latched)
            elif known is None and self._network.agrees(endpoint, "msg"):
                found[name] = SharedTopic(endpoint, entity.latched)
        return found

    def _is_taken(self, name: str, network_name: str) -> bool:
        """Return True if this server publishes a topic of this name itself; other machines do not speak for it."""
        is_taken = self._network.is_own_publication(name)
        if is_taken:
            self._network.warn(
                f"{network_name} of another machine does not come in, this server has a topic of that name; "
                "set zenoh.namespace on one of them"
            )
        return is_taken

    def _publish(self, received: IncomingMessage) -> None:
        topic = received.topic
        if not self._topics.is_shared(topic.name, topic):
            return
        if topic.decoding:
            self._network.dropped += len(topic.waiting) == MAX_WAITING
            topic.waiting.append(received)
            return
        if len(received.octets) > BYTES_AT_ONCE:
            topic.decoding = True
            self._network.start(self._publish_large(received))
            return
        with self._left_out_on_error(topic.name):
            self._deliver(received, self._network.read(topic.source.endpoint.type_name, received.octets))

    async def _publish_large(self, received: IncomingMessage) -> None:
        topic = received.topic
        with self._left_out_on_error(topic.name):
            self._deliver(received, await self._network.decode(topic.source.endpoint.type_name, received.octets))
        topic.decoding = False
        while topic.waiting and not topic.decoding:
            self._publish(topic.waiting.popleft())

    @contextlib.contextmanager
    def _left_out_on_error(self, name: str) -> Iterator[None]:
        try:
            yield
        except (MessageError, GraphError, MemoryError) as error:
            self._network.warn(f"a message on {name} is left out: {str(error) or 'out of memory'}")

    def _deliver(self, received: IncomingMessage, message: ReceivedMessage) -> None:
        network, topic = self._network, received.topic
        if not self._topics.is_shared(topic.name, topic):
            return
        with arrived_in(received.epoch):
            if not self._is_rejected(topic.name, message):
                lost = network.graph.publish(network.node, topic.name, message, latch=topic.source.latched)
                if lost is not None:
                    network.warn(lost)

    def _is_rejected(self, name: str, message: ReceivedMessage) -> bool:
        """Reject a message to the server that other machines have no permission for; return True if it was rejected."""
        if not self._network.is_own_subscription(name):
            return False
        refusal = self._authorizer.publishing(name, message.value if isinstance(message.value, dict) else {})
        if refusal is None:
            return False
        self._network.graph.reject_unauthorized(self._network.node, name, message, refusal)
        self._network.warn(refusal)
        return True

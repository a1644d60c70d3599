"""Topics that come in: what others publish, and what they send to parts of this server, such as goals."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from protocol.codecs import cdr
from protocol.errors import MessageError
from server.access.authorization import Authorizer
from server.errors import GraphError
from server.zenoh.inbox import Inbox
from server.zenoh.keys import Endpoint, Entity, Kind
from server.zenoh.names import Patterns
from server.zenoh.network import MAX_SHARED, Network, undeclare

if TYPE_CHECKING:
    import zenoh
    import zenoh.ext

    Subscription: TypeAlias = zenoh.Subscriber[None] | zenoh.ext.AdvancedSubscriber[None]


class Source(NamedTuple):
    """A topic at the others, whether it is latched there, and whether somebody has been seen to publish it."""

    endpoint: Endpoint
    latched: bool
    announced: bool


class IncomingTopic:
    """One topic on its way in.

    Args:
        network: where from.
        name: as this server calls it.
        source: as the others have it.
        inbox: takes its messages.
    """

    def __init__(self, network: Network, name: str, source: Source, inbox: Inbox[tuple[IncomingTopic, bytes]]) -> None:
        self.name = name
        self.source = source
        self._network = network
        self._inbox = inbox
        self._key = source.endpoint.key(network.domain_id)
        self._token_key = network.tokens.entity(Kind.SUBSCRIPTION, source.endpoint, latched=source.latched)
        self._subscription: Subscription | None = None
        self._token: zenoh.LivelinessToken | None = None

    def open(self) -> None:
        """Begin to listen."""
        if self.source.announced:
            graph, type_name = self._network.graph, self.source.endpoint.type_name
            graph.advertise(self._network.node, self.name, type_name, latch=self.source.latched)
        self._network.thread.do(self._declare)

    def close(self) -> None:
        """Listen no more."""
        self._network.graph.unadvertise(self._network.node, self.name)
        self._network.thread.do(self._undeclare)

    def _declare(self, session: zenoh.Session) -> None:
        import zenoh.ext

        handler, remote = zenoh.handlers.Callback(self._on_sample, indirect=False), zenoh.Locality.REMOTE
        if self.source.latched:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            self._subscription = zenoh.ext.declare_advanced_subscriber(
                session, self._key, handler, allowed_origin=remote, history=history
            )
        else:
            self._subscription = session.declare_subscriber(self._key, handler, allowed_origin=remote)
        self._token = session.liveliness().declare_token(self._token_key)

    def _undeclare(self, _session: zenoh.Session) -> None:
        undeclare(self._token, self._subscription)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        # A message for every key that fits a pattern is for none: it would be a goal here, and a stop there.
        if str(sample.key_expr) != self._key:
            return
        most_bytes = self._network.max_message_bytes
        if len(sample.payload) > most_bytes:
            limit = f"more than {most_bytes} bytes (server.limits.max_message_bytes)"
            self._network.told.warn(f"a message on {self.source.endpoint.name} is left out, it has {limit}")
            return
        octets = bytes(sample.payload)
        self._inbox.put((self, octets), len(octets))


class IncomingTopics:
    """All topics that come in.

    Args:
        network: where from.
        patterns: which ones, as this server calls them.
        authorizer: what others may send to parts of this server.
        loop: the event loop.
    """

    def __init__(
        self, network: Network, patterns: Patterns, authorizer: Authorizer, loop: asyncio.AbstractEventLoop
    ) -> None:
        self._network = network
        self._patterns = patterns
        self._authorizer = authorizer
        self._inbox = Inbox[tuple[IncomingTopic, bytes]](loop, self._publish)
        self._topics: dict[str, IncomingTopic] = {}
        self._entities: tuple[Entity, ...] = ()
        self._announced: dict[str, Source] = {}

    @property
    def dropped(self) -> int:
        """How many messages came faster than the server takes them."""
        return self._inbox.dropped

    def refresh(self, entities: tuple[Entity, ...]) -> None:
        """Listen to what is there now, and to nothing else.

        Args:
            entities: all others; the same object for as long as nothing changes.
        """
        if entities is not self._entities:
            self._entities, self._announced = entities, self._sources(entities)
        wanted = self._wanted()
        for name, topic in list(self._topics.items()):
            if wanted.get(name) != topic.source:
                self._topics.pop(name).close()
        for name, source in wanted.items():
            if name not in self._topics and len(self._topics) < MAX_SHARED:
                self._open(IncomingTopic(self._network, name, source, self._inbox))

    def _open(self, topic: IncomingTopic) -> None:
        try:
            topic.open()
        except GraphError as error:
            self._network.told.warn(f"{topic.source.endpoint.name} does not come in: {error}")
        else:
            self._topics[topic.name] = topic

    def _wanted(self) -> dict[str, Source]:
        network, found = self._network, dict[str, Source]()
        for name, type_name in network.graph.topic_types().items():
            if self._patterns.fit(name) and network.is_own_subscription(name) and not network.is_own_publication(name):
                own = network.endpoint(network.namespace.outside(name), type_name, "msg")
                if own is not None:
                    announced = self._announced.get(name)
                    # A goal that somebody has latched is an old one; it must not move the arm of a server that starts.
                    found[name] = Source(own, False, announced is not None and announced.endpoint == own)
        for name, source in self._announced.items():
            if name not in found and not self._is_taken(name, source.endpoint.name):
                found[name] = source
        return found

    def _sources(self, entities: Iterable[Entity]) -> dict[str, Source]:
        """What others publish and this server may take, by the name that it has here."""
        found = dict[str, Source]()
        for entity in entities:
            endpoint, name = entity.endpoint, self._network.namespace.inside(entity.endpoint.name)
            if entity.kind is not Kind.PUBLISHER or not self._patterns.fit(name):
                continue
            before = found.get(name)
            if before is not None and before.endpoint == endpoint:
                found[name] = before._replace(latched=before.latched or entity.latched)
            elif before is None and self._network.agrees(endpoint, "msg"):
                found[name] = Source(endpoint, entity.latched, announced=True)
        return found

    def _is_taken(self, name: str, outside: str) -> bool:
        """Whether this server publishes a topic of this name itself, for which others do not speak."""
        is_taken = self._network.is_own_publication(name)
        if is_taken:
            self._network.told.warn(
                f"{outside} of another machine does not come in, this server has a topic of that name; "
                "set zenoh.namespace on one of them"
            )
        return is_taken

    def _publish(self, item: tuple[IncomingTopic, bytes]) -> None:
        topic, octets = item
        if self._topics.get(topic.name) is not topic:
            return
        network, type_name = self._network, topic.source.endpoint.type_name
        try:
            message = cdr.deserialize(network.graph.interfaces.registry, type_name, octets)
            if not self._is_turned_away(topic.name, message):
                network.graph.publish(network.node, topic.name, message, latch=topic.source.latched)
        except (MessageError, GraphError) as error:
            network.told.warn(f"a message on {topic.name} is left out: {error}")

    def _is_turned_away(self, name: str, message: Mapping[str, Any]) -> bool:
        """Whether a message asks a part of this server for what others may not ask for; it is answered then."""
        if not self._network.is_own_subscription(name):
            return False
        refusal = self._authorizer.publishing(name, message)
        if refusal is None:
            return False
        self._network.graph.turn_away(self._network.node, name, message, refusal)
        self._network.told.warn(refusal)
        return True

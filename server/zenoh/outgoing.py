"""Topics that go out: every message of the graph that others may see, as rmw_zenoh would send it."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, TypeAlias

from protocol.codecs import cdr
from protocol.publication import Publication
from server.graph.topics import Subscriber
from server.zenoh.attachment import Attachment, gid_of
from server.zenoh.keys import Endpoint, Kind
from server.zenoh.names import Patterns
from server.zenoh.network import MAX_SHARED, Network, undeclare

if TYPE_CHECKING:
    import zenoh
    import zenoh.ext

    Publisher: TypeAlias = zenoh.Publisher | zenoh.ext.AdvancedPublisher

# Of a topic that comes faster than the network takes it, the newest; as many as ROS keeps by default.
MAX_WAITING = 10


class OutgoingTopic:
    """One topic on its way out.

    Args:
        network: where to.
        name: as this server calls it.
        endpoint: as the others call it.
        latched: whether who comes later gets the last message.
    """

    def __init__(self, network: Network, name: str, endpoint: Endpoint, *, latched: bool) -> None:
        self.latched = latched
        self.endpoint = endpoint
        self.dropped = 0
        self._network = network
        self._name = name
        self._token_key = network.tokens.entity(Kind.PUBLISHER, endpoint, latched=latched)
        self._gid = gid_of(self._token_key)
        self._waiting: deque[Publication] = deque(maxlen=MAX_WAITING)
        self._queued = False
        self._sent = 0
        self._publisher: Publisher | None = None
        self._token: zenoh.LivelinessToken | None = None

    def open(self) -> None:
        """Announce the topic, and hear it."""
        self._network.thread.do(self._declare)
        graph, node = self._network.graph, self._network.node
        for publication in graph.subscribe(node, self._name, self.endpoint.type_name, Subscriber(self._take)):
            self._take(publication)

    def close(self) -> None:
        """Hear it no more, and take the announcement back."""
        self._network.graph.unsubscribe(self._network.node, self._name)
        self._network.thread.do(self._undeclare)

    def _take(self, publication: Publication) -> None:
        # What has come from the network is there already.
        if publication.publisher is self._network.node:
            return
        self.dropped += len(self._waiting) == MAX_WAITING
        self._waiting.append(publication)
        if not self._queued:
            self._queued = self._network.thread.do(self._send)

    def _declare(self, session: zenoh.Session) -> None:
        import zenoh.ext

        key = self.endpoint.key(self._network.domain_id)
        if self.latched:
            cache = zenoh.ext.CacheConfig(1)
            self._publisher = zenoh.ext.declare_advanced_publisher(session, key, cache=cache, publisher_detection=True)
        else:
            self._publisher = session.declare_publisher(key)
        self._token = session.liveliness().declare_token(self._token_key)

    def _undeclare(self, _session: zenoh.Session) -> None:
        undeclare(self._token, self._publisher)
        self._token = self._publisher = None

    def _send(self, _session: zenoh.Session) -> None:
        # First, so that what comes from now on is queued anew.
        self._queued = False
        registry = self._network.graph.interfaces.registry
        for _ in range(len(self._waiting)):
            publication = self._waiting.popleft()
            octets = cdr.serialize(registry, publication.type_name, publication.msg)
            self._sent += 1
            attachment = Attachment(self._sent, time.time_ns(), self._gid).written()
            if self._publisher is not None:
                self._publisher.put(octets, attachment=attachment)


class OutgoingTopics:
    """All topics that go out.

    Args:
        network: where to.
        patterns: which ones.
    """

    def __init__(self, network: Network, patterns: Patterns) -> None:
        self._network = network
        self._patterns = patterns
        self._topics: dict[str, OutgoingTopic] = {}
        self._dropped_before = 0

    @property
    def dropped(self) -> int:
        """How many messages the network was too slow for."""
        return self._dropped_before + sum(topic.dropped for topic in self._topics.values())

    def refresh(self, foreign: frozenset[str]) -> None:
        """Share what is there now, and nothing else.

        Args:
            foreign: names of others that are in no namespace of this server.
        """
        wanted = self._wanted(foreign)
        for name, topic in list(self._topics.items()):
            if wanted.get(name) != (topic.endpoint, topic.latched):
                self._dropped_before += topic.dropped
                self._topics.pop(name).close()
        for name, (endpoint, latched) in wanted.items():
            if name not in self._topics and len(self._topics) < MAX_SHARED:
                self._topics[name] = OutgoingTopic(self._network, name, endpoint, latched=latched)
                self._topics[name].open()

    def _wanted(self, foreign: frozenset[str]) -> dict[str, tuple[Endpoint, bool]]:
        graph, found = self._network.graph, {}
        for name, type_name in graph.topic_types().items():
            if self._patterns.fit(name) and set(graph.publishers(name)) - {self._network.node}:
                endpoint = self._endpoint(name, type_name, foreign)
                if endpoint is not None:
                    found[name] = endpoint, graph.is_latched(name)
        return found

    def _endpoint(self, name: str, type_name: str, foreign: frozenset[str]) -> Endpoint | None:
        # A client may send to another server what that one is called for there.
        is_foreign = name in foreign and not self._network.is_own_publication(name)
        outside = name if is_foreign else self._network.namespace.outside(name)
        return self._network.endpoint(outside, type_name, "msg")

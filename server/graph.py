"""Topics in one process: a local part and a remote client use them alike.

Every message on a topic is complete and valid against the topic's type. The first to name a type for a topic
decides it, for as long as anyone publishes or subscribes there, and a little longer.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from protocol.errors import InterfaceError, MessageError
from protocol.messages import Stamp, complete
from protocol.publication import Publication
from protocol.registry import Registry
from server.errors import GraphError

log = logging.getLogger("armbridge.graph")

# Far more than any robot has; keeps a client that invents topics from growing the server.
MAX_TOPICS = 10_000

# rosbridge_server's unregister_timeout: some clients open a new socket between advertise and publish.
TYPE_OUTLIVES_USE_S = 10.0


class Node:
    """Anyone who publishes or subscribes: a connection, or a part of the server.

    Args:
        name: how logs call it.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def __repr__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Subscriber:
    """What a node wants of a topic.

    Attributes:
        deliver: called with every message, at once and in order.
        refused: called with the error when somebody publishes what the topic's type does not allow.
    """

    deliver: Callable[[Publication], None]
    refused: Callable[[MessageError], None] | None = None


@dataclass
class Topic:
    """One topic and who takes part in it."""

    name: str
    type_name: str
    last_used_s: float
    publishers: set[Node] = field(default_factory=set)
    subscribers: dict[Node, Subscriber] = field(default_factory=dict)
    latching: set[Node] = field(default_factory=set)
    latched: Publication | None = None

    @property
    def used(self) -> bool:
        """Whether anyone takes part."""
        return bool(self.publishers or self.subscribers)


class Graph:
    """All topics.

    Args:
        registry: message types.
        clock: monotonic time [s].
        wall_clock: seconds since the epoch, for stamps.
    """

    def __init__(
        self,
        registry: Registry,
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:
        self._registry = registry
        self._clock = clock
        self._wall_clock = wall_clock
        self._topics: dict[str, Topic] = {}

    def topic_types(self) -> dict[str, str]:
        """Canonical type of every topic in use."""
        return {name: topic.type_name for name, topic in self._topics.items() if topic.used}

    def advertise(self, node: Node, name: str, type_name: str, *, latch: bool = False) -> None:
        """Register ``node`` as publisher.

        Raises:
            GraphError: the type is unknown, or the topic has another one.
        """
        topic = self._topic(name, type_name)
        topic.publishers.add(node)
        if latch:
            topic.latching.add(node)

    def unadvertise(self, node: Node, name: str) -> None:
        """Forget ``node`` as publisher; nothing happens when it is none."""
        topic = self._topics.get(name)
        if topic is not None and node in topic.publishers:
            topic.publishers.remove(node)
            topic.latching.discard(node)
            self._left(topic)

    def subscribe(self, node: Node, name: str, type_name: str | None, subscriber: Subscriber) -> Publication | None:
        """Deliver the topic's messages to ``node``, one subscriber a node.

        Returns:
            The topic's latched message, if it has one.

        Raises:
            GraphError: the type is unknown, differs from the topic's, or is not given for an unknown topic.
        """
        topic = self._topic(name, type_name)
        topic.subscribers[node] = subscriber
        return topic.latched

    def unsubscribe(self, node: Node, name: str) -> None:
        """End the delivery to ``node``; nothing happens when there is none."""
        topic = self._topics.get(name)
        if topic is not None and node in topic.subscribers:
            del topic.subscribers[node]
            self._left(topic)

    def remove(self, node: Node) -> None:
        """Forget a node that has left, on every topic."""
        for name in list(self._topics):
            self.unadvertise(node, name)
            self.unsubscribe(node, name)

    def publish(self, node: Node, name: str, message: Mapping[str, Any] | None) -> None:
        """Complete a message, and deliver it to every subscriber; ``node`` becomes a publisher if it is none.

        Raises:
            GraphError: nobody has said what type the topic has.
            MessageError: the message does not fit the type; the topic's local subscribers are told as well.
        """
        topic = self._topic(name, None)
        try:
            completed = complete(self._registry, topic.type_name, {} if message is None else message, self._now())
        except MessageError as error:
            for subscriber in list(topic.subscribers.values()):
                if subscriber.refused is not None:
                    subscriber.refused(error)
            raise
        topic.publishers.add(node)
        publication = Publication(topic.name, topic.type_name, completed)
        if node in topic.latching:
            topic.latched = publication
        for subscriber in list(topic.subscribers.values()):
            subscriber.deliver(publication)

    def _now(self) -> Stamp:
        return Stamp.from_seconds(self._wall_clock())

    def _topic(self, name: str, type_name: str | None) -> Topic:
        """The topic, made when it is new and ``type_name`` says what it carries."""
        topic = self._topics.get(name)
        if topic is None or self._outlived(topic):
            if type_name is None:
                raise GraphError(name, "has no type yet: advertise it first, or name the type")
            self._make_room(name)
            topic = self._topics[name] = Topic(name, self._canonical(name, type_name), self._clock())
        elif type_name is not None and self._canonical(name, type_name) != topic.type_name:
            raise GraphError(name, f"is already established with type {topic.type_name}, not {type_name}")
        return topic

    def _canonical(self, name: str, type_name: str) -> str:
        try:
            return self._registry.message(type_name).name
        except InterfaceError as error:
            raise GraphError(name, str(error)) from error

    def _make_room(self, name: str) -> None:
        """See that one more topic fits; those that nobody uses any more are only kept while there is room."""
        if len(self._topics) >= MAX_TOPICS:
            self._topics = {key: topic for key, topic in self._topics.items() if topic.used}
        if len(self._topics) >= MAX_TOPICS:
            raise GraphError(name, f"cannot be added: there are {MAX_TOPICS} topics already")

    def _outlived(self, topic: Topic) -> bool:
        return not topic.used and self._clock() - topic.last_used_s > TYPE_OUTLIVES_USE_S

    def _left(self, topic: Topic) -> None:
        """Note that someone has just left the topic."""
        topic.last_used_s = self._clock()
        if not topic.used:
            topic.latched = None

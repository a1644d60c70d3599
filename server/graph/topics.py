"""Topics of the graph, latched messages included; services and actions stand beside them.

Local parts and remote clients use a topic alike. Every message is complete and valid against the topic's type. The
first to name a type for a topic decides it, for as long as anyone publishes or subscribes there, and a little longer.

rosbridge_server publishes with transient-local durability: with ``latch`` the last message is kept for as long as its
publisher lives, without it every message for a second (rosbridge_library, internal/publishers.py).
"""

from __future__ import annotations

import logging
import math
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

from protocol.errors import InterfaceError, MessageError
from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from protocol.registry import Registry
from server.errors import GraphError
from server.graph.actions import Actions
from server.graph.list_limits import CheckLists
from server.graph.message_types import MessageTypes, ReceivedMessage
from server.graph.node import Node
from server.graph.services import Services
from server.timers import CallLater, call_later

# Maps and meshes are latched, and have megabytes; every one beyond this is told to the log and not kept.
MAX_LATCHED_BYTES = 67_108_864

# The last messages of many topics, or a picture; the oldest goes first.
MAX_RECENT_BYTES = 4_194_304

# As many of one topic as rosbridge_server's subscribers take (QoS depth 10).
MAX_RECENT_PER_TOPIC = 10


class _Kept(NamedTuple):
    """A message, its size, and the time until which it is kept [s]."""

    published: PublishedMessage
    size_bytes: int
    until_s: float


class LatchedMessages:
    """Latched and recent messages of all topics, for those who subscribe later."""

    def __init__(self) -> None:
        self._latched: dict[str, _Kept] = {}
        self._latched_bytes = 0
        # By topic, oldest first; the topics in order of their newest message, so that those in front have the oldest.
        self._recent: OrderedDict[str, deque[_Kept]] = OrderedDict()
        self._recent_bytes = 0

    def latch(self, published: PublishedMessage) -> bool:
        """Keep a message instead of the one latched before it.

        Returns:
            False when all that is latched would be too large; then the topic has no latched message.
        """
        self.unlatch(published.topic)
        size_bytes = published.size_bytes
        if self._latched_bytes + size_bytes > MAX_LATCHED_BYTES:
            return False
        self._latched[published.topic] = _Kept(published, size_bytes, math.inf)
        self._latched_bytes += size_bytes
        return True

    def unlatch(self, topic: str) -> None:
        """Give the latched message up, if there is one."""
        kept = self._latched.pop(topic, None)
        if kept is not None:
            self._latched_bytes -= kept.size_bytes

    def unlatch_at(self, topic: str, until_s: float) -> None:
        """Keep the latched message, if there is one, until then and no longer [s]."""
        kept = self._latched.get(topic)
        if kept is not None:
            self._latched[topic] = kept._replace(until_s=until_s)

    def keep(self, published: PublishedMessage, now: float, lifespan_s: float) -> None:
        """Keep a message for a while.

        Args:
            published: the message.
            now: present time [s], monotonic.
            lifespan_s: for how long [s]; the same for all.
        """
        topic, size_bytes = published.topic, published.size_bytes
        recent = self._recent.setdefault(topic, deque())
        recent.append(_Kept(published, size_bytes, now + lifespan_s))
        self._recent.move_to_end(topic)
        self._recent_bytes += size_bytes
        if len(recent) > MAX_RECENT_PER_TOPIC:
            self._recent_bytes -= recent.popleft().size_bytes
        self._give_up_old(now)

    def of(self, topic: str, now: float) -> list[PublishedMessage]:
        """Return what a new subscriber to the topic gets, oldest first.

        Args:
            topic: fully qualified name.
            now: present time [s], monotonic.
        """
        latched = self._latched.get(topic)
        recent = self._recent.get(topic, ())
        kept_now = recent if latched is None else [latched, *recent]
        return [kept.published for kept in kept_now if kept.until_s >= now]

    def forget(self, topic: str) -> None:
        """Give up all that is kept of a topic."""
        self.unlatch(topic)
        self._recent_bytes -= sum(kept.size_bytes for kept in self._recent.pop(topic, ()))

    def _give_up_old(self, now: float) -> None:
        """Drop what is too old; over the limit, the oldest message of the topic that has been quiet for longest."""
        while self._recent:
            topic, recent = next(iter(self._recent.items()))
            if recent[0].until_s >= now and self._recent_bytes <= MAX_RECENT_BYTES:
                return
            self._recent_bytes -= recent.popleft().size_bytes
            if not recent:
                del self._recent[topic]


log = logging.getLogger("armbridge.graph")

# Far more than any robot has; keeps a client that invents topics from growing the server.
MAX_TOPICS = 10_000

# Some clients open a new socket between advertise and publish.
UNREGISTER_TIMEOUT_S = 10.0


# Called with every message of every topic, before its subscribers, and whether it is latched.
Watcher: TypeAlias = Callable[[PublishedMessage, bool], None]


@dataclass(frozen=True)
class Subscriber:
    """Subscription of a node to a topic.

    Attributes:
        deliver: called with every message, at once and in order.
        refused: called with the error when somebody publishes what the topic's type does not allow.
        turned_away: called with a message, empty when it cannot be read, whose sender may not publish it, with the
            sender, and with a sentence that says why.
        check_lists: checks the lists of a message before it is completed, whoever publishes it; None for any.
    """

    deliver: Callable[[PublishedMessage], None]
    refused: Callable[[MessageError], None] | None = None
    turned_away: Callable[[Mapping[str, Any], Node, str], None] | None = None
    check_lists: CheckLists | None = None


@dataclass
class Topic:
    """One topic with its publishers and subscribers."""

    name: str
    type_name: str
    last_used_s: float
    publishers: set[Node] = field(default_factory=set)
    subscribers: dict[Node, Subscriber] = field(default_factory=dict)
    latching: set[Node] = field(default_factory=set)

    @property
    def used(self) -> bool:
        """True while anyone publishes or subscribes."""
        return bool(self.publishers or self.subscribers)

    def keeps(self, node: Node) -> bool:
        """Tell whether the node's messages are latched; a client's do not replace those of the server itself."""
        return node in self.latching and (not node.remote or all(each.remote for each in self.latching))


class Graph:
    """All topics, services and actions.

    Args:
        registry: types.
        clock: monotonic time [s].
        wall_clock: seconds since the epoch, for stamps.
        call_later: does something after a delay.
        relay_unknown_types: take types that the registry does not know, and relay what is said in them unseen.
        unregister_timeout_s: for how long a topic that nobody uses keeps its type, and what is latched there [s].

    Attributes:
        interfaces: types and messages.
        services: who offers and calls what.
        actions: who offers which, and the goals on their way.
    """

    def __init__(
        self,
        registry: Registry,
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
        call_later: CallLater = call_later,
        *,
        relay_unknown_types: bool = False,
        unregister_timeout_s: float = UNREGISTER_TIMEOUT_S,
    ) -> None:
        self.message_types = MessageTypes(registry, wall_clock, relay_unknown_types=relay_unknown_types)
        self.services = Services(self.message_types, call_later)
        self.actions = Actions(self.message_types, self.services, call_later)
        self._clock = clock
        self._unregister_timeout_s = unregister_timeout_s
        self._topics: dict[str, Topic] = {}
        self._latched_messages = LatchedMessages()
        self._watchers: tuple[Watcher, ...] = ()

    def watch(self, watcher: Watcher) -> None:
        """Call ``watcher`` with every message from now on; nobody sees it in the graph."""
        self._watchers = (*self._watchers, watcher)

    def unwatch(self, watcher: Watcher) -> None:
        """Call ``watcher`` no more."""
        self._watchers = tuple(each for each in self._watchers if each != watcher)

    def topic_types(self) -> dict[str, str]:
        """Return the canonical type of every topic in use."""
        return {name: topic.type_name for name, topic in self._topics.items() if topic.used}

    def topic_type(self, name: str) -> str | None:
        """Return the canonical type of a topic, given by its fully qualified name; None when it is not known."""
        topic = self._topics.get(name)
        return None if topic is None or self._outlived(topic) else topic.type_name

    def publishers(self, name: str) -> list[Node]:
        """Return the publishers of a topic, given by its fully qualified name."""
        topic = self._topics.get(name)
        return [] if topic is None else list(topic.publishers)

    def subscribers(self, name: str) -> list[Node]:
        """Return the subscribers of a topic, given by its fully qualified name."""
        topic = self._topics.get(name)
        return [] if topic is None else list(topic.subscribers)

    def is_latched(self, name: str) -> bool:
        """Tell whether a topic, given by its fully qualified name, is latched."""
        topic = self._topics.get(name)
        return topic is not None and bool(topic.latching)

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
            last_latching = topic.latching == {node}
            topic.latching.discard(node)
            if last_latching:
                # As the type, what is latched outlives a socket that is only closed to be opened anew.
                self._latched_messages.unlatch_at(name, self._clock() + self._unregister_timeout_s)
            self._left(topic)

    def subscribe(self, node: Node, name: str, type_name: str | None, subscriber: Subscriber) -> list[PublishedMessage]:
        """Deliver the topic's messages to ``node``, one subscriber a node.

        Returns:
            What was published before and is still to be delivered, oldest first.

        Raises:
            GraphError: the type is unknown, differs from the topic's, or is not given for an unknown topic.
        """
        topic = self._topic(name, type_name)
        topic.subscribers[node] = subscriber
        return self._latched_messages.of(name, self._clock())

    def unsubscribe(self, node: Node, name: str) -> None:
        """End the delivery to ``node``; nothing happens when there is none."""
        topic = self._topics.get(name)
        if topic is not None and node in topic.subscribers:
            del topic.subscribers[node]
            self._left(topic)

    def remove(self, node: Node) -> None:
        """Forget a node that has left, everywhere."""
        self.actions.remove(node)
        self.services.remove(node)
        for name in list(self._topics):
            self.unadvertise(node, name)
            self.unsubscribe(node, name)

    def publish(
        self,
        node: Node,
        name: str,
        message: object,
        *,
        latch: bool = False,
        lifespan_s: float = 0.0,
        as_it_is: bool = False,
    ) -> None:
        """Complete a message, and deliver it to every subscriber; ``node`` becomes a publisher if it is none.

        Args:
            node: who publishes.
            name: fully qualified name of the topic.
            message: the message.
            latch: keep it for who subscribes later, as for a topic advertised so.
            lifespan_s: otherwise, for how long it reaches who subscribes later [s].
            as_it_is: the message is complete and valid already, as a large one of the server's own; nobody may change
                it any more.

        Raises:
            GraphError: nobody has said what type the topic has.
            MessageError: the message does not fit the type; the topic's local subscribers are told as well.
        """
        topic = self._topic(name, None)
        received = self.message_types.now()
        try:
            completed: Any = message if as_it_is else self._completed(topic, message, received)
        except MessageError as error:
            for subscriber in list(topic.subscribers.values()):
                if subscriber.refused is not None:
                    subscriber.refused(error)
            raise
        topic.publishers.add(node)
        if latch:
            topic.latching.add(node)
        cost_bytes = message.cost_bytes if isinstance(message, ReceivedMessage) else None
        published = PublishedMessage(
            topic.name, topic.type_name, completed, self.message_types.registry, received, node, cost_bytes
        )
        for watch in self._watchers:
            watch(published, topic.keeps(node))
        for subscriber in list(topic.subscribers.values()):
            subscriber.deliver(published)
        # Afterwards, when it is known how large the message is.
        self._retain(published, topic.keeps(node), lifespan_s)

    def turn_away(self, node: Node, name: str, message: object, reason: str) -> None:
        """Have a message answered that is not let through, where its topic promises an answer.

        Args:
            node: who has sent it.
            name: fully qualified name of the topic.
            message: as for :meth:`publish`.
            reason: a sentence.
        """
        topic = self._topics.get(name)
        listeners = (
            () if topic is None else tuple(filter(None, (each.turned_away for each in topic.subscribers.values())))
        )
        if topic is None or not listeners:
            return
        try:
            completed: Mapping[str, Any] = self._completed(topic, message, self.message_types.now())
        except MessageError:
            completed = {}
        for turned_away in listeners:
            turned_away(completed, node, reason)

    def _completed(self, topic: Topic, message: object, received: Stamp) -> dict[str, Any]:
        for subscriber in topic.subscribers.values():
            if subscriber.check_lists is not None:
                subscriber.check_lists(message)
        return self.message_types.complete(topic.type_name, message, received)

    def tell(self, node: Node, name: str, message: object) -> None:
        """Deliver a message to one subscriber alone; nothing happens when it is none.

        Args:
            node: who is told.
            name: fully qualified name of a topic that is advertised.
            message: as for :meth:`publish`.

        Raises:
            GraphError: nobody has said what type the topic has.
            MessageError: the message does not fit the type.
        """
        topic, received = self._topic(name, None), self.message_types.now()
        subscriber = topic.subscribers.get(node)
        if subscriber is not None:
            completed = self.message_types.complete(topic.type_name, message, received)
            subscriber.deliver(
                PublishedMessage(topic.name, topic.type_name, completed, self.message_types.registry, received)
            )

    def latch(self, name: str, message: object, *, as_it_is: bool = False) -> None:
        """Keep a message for who subscribes later, and deliver it to nobody now.

        For topics that tell those who listen of changes alone; otherwise latch what is published.

        Args:
            name: fully qualified name of a topic that is advertised.
            message: what a new subscriber is to get first.
            as_it_is: as for :meth:`publish`.

        Raises:
            GraphError: nobody has said what type the topic has.
            MessageError: the message does not fit the type.
        """
        topic, received = self._topic(name, None), self.message_types.now()
        completed: Any = message if as_it_is else self.message_types.complete(topic.type_name, message, received)
        published = PublishedMessage(topic.name, topic.type_name, completed, self.message_types.registry, received)
        self._retain(published, latch=True, lifespan_s=0.0)

    def _retain(self, published: PublishedMessage, latch: bool, lifespan_s: float) -> None:
        if latch and not self._latched_messages.latch(published):
            log.warning("topic %s: too large to be latched beside what is latched already", published.topic)
        elif not latch and lifespan_s > 0:
            self._latched_messages.keep(published, self._clock(), lifespan_s)

    def _topic(self, name: str, type_name: str | None) -> Topic:
        """The topic, made when it is new and ``type_name`` says what it carries."""
        topic = self._topics.get(name)
        if topic is None or self._outlived(topic):
            if type_name is None:
                raise GraphError("topic", name, "has no type yet: advertise it first, or name the type")
            self._make_room(name)
            self._latched_messages.forget(name)
            topic = self._topics[name] = Topic(name, self._canonical(name, type_name), self._clock())
        elif type_name is not None and self._canonical(name, type_name) != topic.type_name:
            raise GraphError("topic", name, f"is already established with type {topic.type_name}, not {type_name}")
        return topic

    def _canonical(self, name: str, type_name: str) -> str:
        try:
            return self.message_types.canonical(type_name, "msg")
        except InterfaceError as error:
            raise GraphError("topic", name, str(error)) from error

    def _make_room(self, name: str) -> None:
        """See that one more topic fits; those that nobody uses any more are only kept while there is room."""
        if len(self._topics) >= MAX_TOPICS:
            self._topics = {key: topic for key, topic in self._topics.items() if topic.used}
        if len(self._topics) >= MAX_TOPICS:
            raise GraphError("topic", name, f"cannot be added: there are {MAX_TOPICS} topics already")

    def _outlived(self, topic: Topic) -> bool:
        return not topic.used and self._clock() - topic.last_used_s > self._unregister_timeout_s

    def _left(self, topic: Topic) -> None:
        """Note that someone has just left the topic."""
        topic.last_used_s = self._clock()

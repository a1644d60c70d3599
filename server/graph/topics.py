"""Topics of the graph and its local parts, latched messages included; services and actions stand beside them.

Local parts and remote clients use a topic alike. Every message is complete and valid against the topic's type. The
first to name a type for a topic decides it, for as long as anyone publishes or subscribes there, and a little longer.

rosbridge_server publishes with transient-local durability: with ``latch`` the last message is kept for as long as its
publisher lives, without it every message for a second (rosbridge_library, internal/publishers.py).
"""

from __future__ import annotations

import difflib
import logging
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from protocol.errors import InterfaceError, MessageError
from protocol.messages import ListLimits, Stamp
from protocol.publication import PublishedMessage
from protocol.registry import Registry
from protocol.strict_messages import PublicationReader, publication_reader
from robot.logs import LogLimiter
from server.errors import GraphError
from server.graph.actions import MAX_GOAL_S, ActionGoal, Actions
from server.graph.index import Index, TypedNames
from server.graph.latching import LatchedMessages
from server.graph.message_types import MessageTypes, ReceivedMessage
from server.graph.permissions import Node, Rule
from server.graph.services import DEFAULT_LIMITS, LOCAL_TIMEOUT_S, Call, ServiceFunction, Services
from server.timers import CallLater, call_later

log = logging.getLogger("armbridge.graph")

# Far more than any robot has; keeps a client that invents topics from growing the server.
MAX_TOPICS = 10_000

# Clients that may only look make topics when they subscribe to new names. They cannot fill the table, or
# others could make none.
MAX_TOPICS_FOR_VIEWERS = MAX_TOPICS // 2

# Topics that a client publishes on, also without having advertised them: the default limit of advertised ones, and as
# many again. It must not take long to forget a client that has left.
MAX_TOPICS_OF_PUBLISHER = 2_000

# Likeness of a misspelt name to one of the server's own, by difflib's measure: two letters of ten. Longer names are not
# compared, for the time grows with the square of the length.
LIKENESS = 0.8
MAX_COMPARED_CHARACTERS = 100

# A comparison takes up to a millisecond, twenty times as long as to refuse an operation: a number at once, and a number
# in a second in the long run, for all clients together.
COMPARISONS_AT_ONCE = 20
COMPARISONS_PER_S = 2.0

# Some clients open a new socket between advertise and publish.
UNREGISTER_TIMEOUT_S = 10.0

# Unused topics that one operation forgets: more than it adds, and few enough for 0.2 ms.
FORGOTTEN_AT_ONCE = 100


# Called with every message of every topic, before its subscribers, and whether it is latched.
Watcher: TypeAlias = Callable[[PublishedMessage, bool], None]


@dataclass(frozen=True)
class Subscriber:
    """Subscription of a node to a topic."""

    # Called with every message, at once and in order. It raises GraphError for a message that the server refuses: the
    # other subscribers get it, and the publisher gets the sentence.
    deliver: Callable[[PublishedMessage], None]
    # Called with the error when somebody publishes what the topic's type does not allow.
    on_invalid: Callable[[MessageError], None] | None = None
    # Called with a message, empty when it cannot be read, its sender, and the reason why that sender may not publish
    # it.
    on_unauthorized: Callable[[Mapping[str, Any], Node, str], None] | None = None
    limits: ListLimits | None = None  # limits of a part of the server, which hold for all that is published
    rule: Rule | None = None  # requirements of publishing, where a part of the server subscribes


@dataclass
class Topic:
    """One topic with its publishers and subscribers."""

    name: str
    type_name: str
    last_used_s: float
    published_count: int = 0
    publishers: set[Node] = field(default_factory=set)
    subscribers: dict[Node, Subscriber] = field(default_factory=dict)
    latching: set[Node] = field(default_factory=set)
    depth: int = 0
    limits: ListLimits | None = None  # of its subscribers; kept here, as each message of a flood asks for them

    @property
    def used(self) -> bool:
        return bool(self.publishers or self.subscribers)

    def keeps(self, node: Node) -> bool:
        """Return True if the node's messages are latched; a client's do not replace the server's."""
        return node in self.latching and (not node.remote or all(each.remote for each in self.latching))


class Graph:
    """All topics, services and actions, by their fully qualified names."""

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
        self.services = Services(self.message_types, self.hint, call_later)
        self.actions = Actions(self, clock, call_later)
        self.clock, self.call_later = clock, call_later
        self._comparisons = LogLimiter(COMPARISONS_AT_ONCE, COMPARISONS_PER_S)
        self._unregister_timeout_s = unregister_timeout_s
        self.topic_names = TypedNames()
        self._topics: dict[str, Topic] = {}
        # Topics that nobody uses, the longest unused first.
        self._unused: OrderedDict[str, Topic] = OrderedDict()
        self.publications: Index[Node, str] = Index()
        self.subscriptions: Index[Node, str] = Index()
        self._latched_messages = LatchedMessages()
        self._watchers: tuple[Watcher, ...] = ()
        self._leave_listeners: tuple[Callable[[Node], None], ...] = ()
        self.rules: dict[str, Rule] = {}  # rules of publishing on the topics that local parts subscribe to, by name
        self.remarks: Mapping[str, str] = {}  # sentences for the clients that publish on a topic, by name
        self.revision = 0  # number of changes in who publishes, latches or subscribes to which topic

    def node(self, name: str) -> LocalNode:
        """Return a new part of the server in the graph."""
        return LocalNode(self, name)

    def remark(self, remarks: Mapping[str, str]) -> None:
        """Have clients that publish on these topics, and on no others, get the sentences as warnings."""
        if remarks != self.remarks:
            self.remarks = remarks
            self.revision += 1

    def watch(self, watcher: Watcher) -> None:
        """Call ``watcher`` with every message from now on; nobody sees it in the graph."""
        self._watchers = (*self._watchers, watcher)

    def unwatch(self, watcher: Watcher) -> None:
        self._watchers = tuple(each for each in self._watchers if each != watcher)

    def topic_type(self, name: str) -> str | None:
        """Return the canonical type of a topic, given by its fully qualified name; None when it is not known."""
        topic = self._topics.get(name)
        return None if topic is None or self._outlived(topic) else topic.type_name

    def hint(self, name: str, own: Iterable[str]) -> str:
        """Return the end of a sentence about an unknown name: the server's own that is like it; empty without."""
        if len(name) > MAX_COMPARED_CHARACTERS or not self._comparisons.due("comparison", self.clock()):
            return ""
        found = difflib.get_close_matches(name, list(own), n=1, cutoff=LIKENESS)
        return f"; did you mean {found[0]}?" if found else ""

    def topic_hint(self, name: str) -> str:
        own = (
            topic
            for index in (self.publications, self.subscriptions)
            for node in index
            if not node.remote
            for topic in index.of(node)
        )
        return self.hint(name, own)

    def publishers(self, name: str) -> list[Node]:
        topic = self._topics.get(name)
        return [] if topic is None else list(topic.publishers)

    def subscribers(self, name: str) -> list[Node]:
        topic = self._topics.get(name)
        return [] if topic is None else list(topic.subscribers)

    def nodes(self) -> set[Node]:
        """Return everyone who publishes, subscribes, or offers a service or an action."""
        return {*self.publications, *self.subscriptions, *self.services.nodes(), *self.actions.nodes()}

    def is_latched(self, name: str) -> bool:
        topic = self._topics.get(name)
        return topic is not None and bool(topic.latching)

    def latched(self, name: str) -> PublishedMessage | None:
        return self._latched_messages.latched(name, self.clock())

    def advertise(self, node: Node, name: str, type_name: str, *, latch: bool = False, depth: int = 0) -> None:
        """Register ``node`` as publisher; raises GraphError for an unknown type, or another type than the topic's.

        A new subscriber gets the server's last ``depth`` messages.
        """
        topic = self._topic(name, type_name, node)
        topic.depth = max(topic.depth, depth)
        self._add_publisher(topic, node)
        if latch:
            self._add_latching(topic, node)

    def _add_latching(self, topic: Topic, node: Node) -> None:
        if node not in topic.latching:
            topic.latching.add(node)
            self.revision += 1

    def _add_publisher(self, topic: Topic, node: Node) -> None:
        if node not in topic.publishers:
            self._take_into_use(topic)
            topic.publishers.add(node)
            self.publications.add(node, topic.name)
            self.revision += 1

    def unadvertise(self, node: Node, name: str) -> None:
        """Forget ``node`` as publisher; nothing happens when it is none."""
        topic = self._topics.get(name)
        if topic is not None and node in topic.publishers:
            topic.publishers.remove(node)
            self.publications.discard(node, name)
            last_latching = topic.latching == {node}
            topic.latching.discard(node)
            if last_latching:
                # Type and latched message outlive a socket that is closed only to be opened again.
                self._latched_messages.unlatch_at(name, self.clock() + self._unregister_timeout_s)
            self._left(topic)

    def subscribe(self, node: Node, name: str, type_name: str | None, subscriber: Subscriber) -> list[PublishedMessage]:
        """Deliver the topic's messages to ``node``; return those published before that are still to be delivered.

        Raises GraphError for a type that is unknown, not the topic's, or missing for a new topic.
        """
        topic = self._topic(name, type_name, node)
        self._take_into_use(topic)
        topic.subscribers[node] = subscriber
        if subscriber.rule is not None:
            self.rules[name] = subscriber.rule
        if subscriber.limits is not None:
            topic.limits = subscriber.limits
        self.revision += 1
        self.subscriptions.add(node, name)
        return self._latched_messages.of(name, self.clock())

    def unsubscribe(self, node: Node, name: str) -> None:
        """End the delivery to ``node``; nothing happens when there is none."""
        topic = self._topics.get(name)
        if topic is not None and node in topic.subscribers:
            if topic.subscribers.pop(node).limits is not None:
                topic.limits = None
            self.subscriptions.discard(node, name)
            self._left(topic)

    def on_leave(self, listener: Callable[[Node], None]) -> None:
        """Call ``listener`` with each client that leaves from now on."""
        self._leave_listeners = (*self._leave_listeners, listener)

    def remove(self, node: Node) -> None:
        for listener in self._leave_listeners:
            listener(node)
        self.actions.remove(node)
        self.services.remove(node)
        for name in self.publications.of(node):
            self.unadvertise(node, name)
        for name in self.subscriptions.of(node):
            self.unsubscribe(node, name)

    def publish(
        self,
        node: Node,
        name: str,
        message: object,
        *,
        latch: bool = False,
        lifespan_s: float = 0.0,
        prevalidated: bool = False,
    ) -> str | None:
        """Complete a message, and deliver it to every subscriber; ``node`` becomes a publisher if it is none.

        For ``lifespan_s`` it reaches later subscribers. Nobody changes a ``prevalidated`` message any more. Returns a
        sentence about a message that could not be latched. Raises GraphError for a topic without a type, too many
        topics of a client, or a refusal; MessageError for a message that does not fit, which local subscribers get too.
        """
        topic, rule = self._topic(name), self.rules.get(name)
        stops = rule is not None and rule.at_once and rule.at_once_data is None
        if node.remote and node not in topic.publishers and not stops:
            count = self.publications.count(node)
            if count >= MAX_TOPICS_OF_PUBLISHER:
                raise GraphError("topic", name, f"this client publishes on {count} topics already, which is the limit")
        received = self.message_types.now()
        try:
            completed: Any = message if prevalidated else self._completed(topic, message, received)
        except MessageError as error:
            if not stops:
                for subscriber in list(topic.subscribers.values()):
                    if subscriber.on_invalid is not None:
                        subscriber.on_invalid(error)
                raise
            # Somebody wants the arm to stop, whatever the message says.
            completed = self._completed(topic, {}, received)
        self._add_publisher(topic, node)
        if latch:
            self._add_latching(topic, node)
        cost_bytes, light = (
            (message.cost_bytes, message.light) if isinstance(message, ReceivedMessage) else (None, False)
        )
        published = PublishedMessage(
            topic.name, topic.type_name, completed, self.message_types.registry, received, node, cost_bytes, light=light
        )
        return self._distribute(topic, published, node, lifespan_s)

    def strict_reader(self, node: Node, name: str) -> PublicationReader | None:
        """Return the reader of a node's frames for the next :meth:`relay`; None for none."""
        topic = self._topics.get(name)
        if topic is None or node not in topic.publishers or topic.latching or name in self.remarks:
            return None
        if topic.limits is not None:
            return None
        return publication_reader(self.message_types.registry, topic.type_name)

    def relay(self, node: Node, name: str, encoded: bytes, lifespan_s: float) -> None:
        """Deliver a message to every subscriber, as :meth:`publish` does; the topic and its publisher are there."""
        topic, types = self._topics[name], self.message_types
        published = PublishedMessage(name, topic.type_name, encoded, types.registry, types.now(), node)
        self._distribute(topic, published, node, lifespan_s)

    def _distribute(self, topic: Topic, published: PublishedMessage, node: Node, lifespan_s: float) -> str | None:
        topic.published_count += 1
        published.sequence_number = topic.published_count
        for watch in self._watchers:
            watch(published, topic.keeps(node))
        refusal: GraphError | None = None
        for subscriber in tuple(topic.subscribers.values()):
            try:
                subscriber.deliver(published)
            except GraphError as error:
                refusal = error
        if refusal is not None:
            raise refusal
        # Afterwards, when it is known how large the message is.
        if topic.depth and not node.remote:
            self._latched_messages.remember(published, topic.depth)
        if topic.latching and topic.keeps(node):
            return self._latch(published, node if node.remote else None)
        if lifespan_s > 0:
            self._latched_messages.keep(published, self.clock(), lifespan_s)
        return None

    def reject_unauthorized(self, node: Node, name: str, message: object, reason: str) -> None:
        """Report a message whose sender may not publish it to the subscribers that answer such messages."""
        topic = self._topics.get(name)
        listeners = (
            () if topic is None else tuple(filter(None, (each.on_unauthorized for each in topic.subscribers.values())))
        )
        if topic is None or not listeners:
            return
        try:
            completed: Mapping[str, Any] = self._completed(topic, message, self.message_types.now())
        except MessageError:
            completed = {}
        for on_unauthorized in listeners:
            on_unauthorized(completed, node, reason)

    def _completed(self, topic: Topic, message: object, received: Stamp) -> dict[str, Any]:
        return self.message_types.complete(topic.type_name, message, received, topic.limits)

    def deliver_to(self, node: Node, name: str, message: object) -> None:
        """Deliver a message to one subscriber alone; nothing happens when it is none."""
        topic, received = self._topic(name), self.message_types.now()
        subscriber = topic.subscribers.get(node)
        if subscriber is not None:
            completed = self.message_types.complete(topic.type_name, message, received)
            subscriber.deliver(
                PublishedMessage(topic.name, topic.type_name, completed, self.message_types.registry, received)
            )

    def latch(self, name: str, message: object, *, prevalidated: bool = False) -> None:
        """Keep a message for later subscribers, and deliver it to nobody now: present subscribers get changes alone."""
        topic, received = self._topic(name), self.message_types.now()
        completed: Any = message if prevalidated else self.message_types.complete(topic.type_name, message, received)
        published = PublishedMessage(topic.name, topic.type_name, completed, self.message_types.registry, received)
        self._latch(published, None)

    def _latch(self, published: PublishedMessage, client: Node | None) -> str | None:
        problem = self._latched_messages.latch(published, client)
        if problem is None:
            return None
        sentence = f"topic {published.topic}: not latched: {problem}"
        if client is None:
            log.warning("%s", sentence)
        return sentence

    def _topic(self, name: str, type_name: str | None = None, node: Node | None = None) -> Topic:
        """Return the topic, which is made for a node if it is new and ``type_name`` is given."""
        for _ in range(FORGOTTEN_AT_ONCE):
            if not self._unused or not self._outlived(oldest := next(iter(self._unused.values()))):
                break
            self._forget(oldest)
        self._latched_messages.give_up_old(self.clock())
        topic = self._topics.get(name)
        if topic is None or self._outlived(topic):
            if type_name is None:
                # A publication's own `type` does not count, a subscription's does.
                remedy = "advertise the topic with its type first"
                if node is not None:
                    remedy = "subscribe with the type, or advertise the topic first"
                raise GraphError("topic", name, f"has no type yet: {remedy}{self.topic_hint(name)}")
            canonical = self._canonical(name, type_name)
            if topic is not None:
                self._forget(topic)
            # Topics that nobody uses any more are only kept while there is room.
            in_use, of_viewer = len(self.topic_names), node is not None and node.is_viewer
            limit, whose = (MAX_TOPICS_FOR_VIEWERS, " for the role view") if of_viewer else (MAX_TOPICS, "")
            if in_use >= limit:
                full = f"cannot be added: there are {in_use} topics already, the limit{whose} is {limit}"
                raise GraphError("topic", name, full)
            if len(self._topics) >= MAX_TOPICS:
                self._forget(next(iter(self._unused.values())))
            topic = self._topics[name] = Topic(name, canonical, self.clock())
        elif type_name is not None and self._canonical(name, type_name) != topic.type_name:
            raise GraphError("topic", name, f"is already established with type {topic.type_name}, not {type_name}")
        return topic

    def _canonical(self, name: str, type_name: str) -> str:
        try:
            return self.message_types.canonical(type_name, "msg")
        except InterfaceError as error:
            raise GraphError("topic", name, str(error)) from error

    def _forget(self, topic: Topic) -> None:
        del self._topics[topic.name], self._unused[topic.name]
        self._latched_messages.forget(topic.name)

    def _outlived(self, topic: Topic) -> bool:
        return not topic.used and self.clock() - topic.last_used_s > self._unregister_timeout_s

    def _take_into_use(self, topic: Topic) -> None:
        if not topic.used:
            self._unused.pop(topic.name, None)
            self.topic_names.add(topic.name, topic.type_name)

    def _left(self, topic: Topic) -> None:
        self.revision += 1
        topic.last_used_s = self.clock()
        if not topic.used:
            self.topic_names.remove(topic.name)
            self._unused[topic.name] = topic


class LocalNode(Node):
    """Part of the server in the graph; its names stand below the prefix of one of several arms, or below none."""

    def __init__(self, graph: Graph, name: str, prefix: str = "") -> None:
        super().__init__(name)
        self._graph, self._prefix = graph, prefix
        self.message_types, self.clock, self.call_later = graph.message_types, graph.clock, graph.call_later

    def resolve(self, name: str) -> str:
        return f"{self._prefix}{name}"

    def advertise(self, topic: str, type_name: str, *, latch: bool = False, depth: int = 0) -> None:
        self._graph.advertise(self, self.resolve(topic), type_name, latch=latch, depth=depth)

    def unadvertise(self, topic: str) -> None:
        self._graph.unadvertise(self, self.resolve(topic))

    def publish(self, topic: str, message: object, *, latch: bool = False, prevalidated: bool = False) -> None:
        self._graph.publish(self, self.resolve(topic), message, latch=latch, prevalidated=prevalidated)

    def deliver_to(self, node: Node, topic: str, message: object) -> None:
        self._graph.deliver_to(node, self.resolve(topic), message)

    def subscribe(
        self,
        topic: str,
        type_name: str,
        deliver: Callable[[PublishedMessage], None],
        on_invalid: Callable[[MessageError], None] | None = None,
        on_unauthorized: Callable[[Mapping[str, Any], Node, str], None] | None = None,
        *,
        limits: ListLimits | None = None,
        rule: Rule | None = None,
    ) -> None:
        """Take the messages of a topic; arguments as for `Subscriber`."""
        below = None if rule is None else self._below(rule)
        subscriber = Subscriber(deliver, on_invalid, on_unauthorized, limits, below)
        self._graph.subscribe(self, self.resolve(topic), type_name, subscriber)

    def unsubscribe(self, topic: str) -> None:
        self._graph.unsubscribe(self, self.resolve(topic))

    def publishers(self, topic: str) -> list[Node]:
        return self._graph.publishers(self.resolve(topic))

    def subscribers(self, topic: str) -> list[Node]:
        return self._graph.subscribers(self.resolve(topic))

    def offer(
        self, name: str, type_name: str, function: ServiceFunction, limits: ListLimits = DEFAULT_LIMITS, *, rule: Rule
    ) -> None:
        self._graph.services.offer(self, self.resolve(name), type_name, function, limits, rule=self._below(rule))

    def offer_calls(
        self,
        name: str,
        type_name: str,
        start: Callable[[Call], None],
        timeout_s: float = LOCAL_TIMEOUT_S,
        limits: ListLimits = DEFAULT_LIMITS,
        *,
        rule: Rule,
    ) -> None:
        """Offer a service that answers its calls itself, within a time [s]."""
        resolved, below = self.resolve(name), self._below(rule)
        self._graph.services.offer_calls(self, resolved, type_name, start, timeout_s, limits, rule=below)

    def offer_action(
        self,
        name: str,
        type_name: str,
        start: Callable[[ActionGoal], None],
        limits: ListLimits | None = None,
        *,
        rule: Rule,
        max_goal_s: float = MAX_GOAL_S,
    ) -> None:
        resolved, below = self.resolve(name), self._below(rule)
        self._graph.actions.offer(self, resolved, type_name, start, limits, rule=below, max_goal_s=max_goal_s)

    def _below(self, rule: Rule) -> Rule:
        return replace(rule, arm=self._prefix.removeprefix("/"))


@dataclass(frozen=True)
class LocalGraph:
    """The graph below the name of one of several arms; below none for an only arm, and for all arms together."""

    graph: Graph
    namespace: str = ""

    def node(self, name: str) -> LocalNode:
        return LocalNode(self.graph, name, self.resolve(""))

    def resolve(self, name: str) -> str:
        return f"/{self.namespace}{name}" if self.namespace else name

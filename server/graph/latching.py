"""Latching: the messages of topics that are kept for those who subscribe later.

The server's own messages have room of their own, so that nothing that clients latch can shut out the planning scene.
A message whose publisher has left has an end; it goes before, when another one needs the room.
"""

import math
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from typing import NamedTuple

from protocol.publication import PublishedMessage
from server.graph.permissions import Node

# Maps and meshes are latched, and have megabytes: as much for the server as for all clients together, and at most half
# of that for one of them, so that one alone does not shut the others out.
MAX_SERVER_LATCHED_BYTES = 67_108_864
MAX_CLIENTS_LATCHED_BYTES = 67_108_864
MAX_CLIENT_LATCHED_BYTES = MAX_CLIENTS_LATCHED_BYTES // 2

# The last messages of many topics, or a picture; the oldest goes first.
MAX_RECENT_BYTES = 4_194_304

# As many of one topic as rosbridge_server's subscribers take (QoS depth 10).
MAX_RECENT_PER_TOPIC = 10


class _Kept(NamedTuple):
    published: PublishedMessage
    size_bytes: int
    until_s: float
    client: Node | None = None


class LatchedMessages:
    """Latched and recent messages of all topics, for those who subscribe later."""

    def __init__(self) -> None:
        self._latched: dict[str, _Kept] = {}
        # Topics whose latched message has an end, the earliest first.
        self._ending: OrderedDict[str, None] = OrderedDict()
        # Last messages of the server's own topics, as many of each as it has asked for.
        self._histories: dict[str, deque[PublishedMessage]] = {}
        # Size of what each client has latched, and the server, which is None here [bytes].
        self._sizes: Counter[Node | None] = Counter()
        # By topic, oldest first; the topics in order of their newest message, so that those in front have the oldest.
        self._recent: OrderedDict[str, deque[_Kept]] = OrderedDict()
        self._recent_bytes = 0

    def latch(self, published: PublishedMessage, client: Node | None = None) -> str | None:
        """Keep a message in place of the one latched before, or return the limit that it exceeds, as a sentence."""
        self.unlatch(published.topic)
        size_bytes = published.size_bytes
        problem = self._make_room(size_bytes, client)
        if problem is None:
            self._latched[published.topic] = _Kept(published, size_bytes, math.inf, client)
            self._sizes[client] += size_bytes
        return problem

    def _make_room(self, size_bytes: int, client: Node | None) -> str | None:
        """Give up messages that have an end, the earliest first, for one more; return the limit if that fails."""
        if client is None:
            return self._limit_within("the server has", size_bytes, MAX_SERVER_LATCHED_BYTES, lambda each: each is None)
        return self._limit_within(
            "this client has", size_bytes, MAX_CLIENT_LATCHED_BYTES, lambda each: each is client
        ) or self._limit_within(
            "all clients have", size_bytes, MAX_CLIENTS_LATCHED_BYTES, lambda each: each is not None
        )

    def _limit_within(
        self, holders: str, size_bytes: int, limit_bytes: int, holds: Callable[[Node | None], bool]
    ) -> str | None:
        """Keep a limit of what some hold together, with one more message; return the sentence if that fails."""
        ending = iter([topic for topic in self._ending if holds(self._latched[topic].client)])
        while (with_it := size_bytes + sum(size for each, size in self._sizes.items() if holds(each))) > limit_bytes:
            if (topic := next(ending, None)) is None:
                return f"{holders} {with_it} bytes latched with it, the limit is {limit_bytes}"
            self.unlatch(topic)
        return None

    def unlatch(self, topic: str) -> None:
        kept = self._latched.pop(topic, None)
        if kept is not None:
            self._ending.pop(topic, None)
            self._sizes[kept.client] -= kept.size_bytes
            if not self._sizes[kept.client]:
                del self._sizes[kept.client]

    def unlatch_at(self, topic: str, until_s: float) -> None:
        """Keep the latched message, if there is one, until then and no longer [s]; later ends are set later."""
        kept = self._latched.get(topic)
        if kept is not None:
            self._latched[topic] = kept._replace(until_s=until_s)
            self._ending[topic] = None
            self._ending.move_to_end(topic)

    def keep(self, published: PublishedMessage, now: float, lifespan_s: float) -> None:
        """Keep a message for a while [s], the same for all; one larger than the bound is not kept."""
        topic, size_bytes = published.topic, published.size_bytes
        if size_bytes > MAX_RECENT_BYTES:
            return
        recent = self._recent.get(topic)
        if recent is None:
            recent = self._recent[topic] = deque()
        else:
            self._recent.move_to_end(topic)
        recent.append(_Kept(published, size_bytes, now + lifespan_s))
        self._recent_bytes += size_bytes
        if len(recent) > MAX_RECENT_PER_TOPIC:
            self._recent_bytes -= recent.popleft().size_bytes
        self._give_up_recent(now)

    def remember(self, published: PublishedMessage, depth: int) -> None:
        """Keep the last ``depth`` messages of a topic of the server."""
        self._histories.setdefault(published.topic, deque(maxlen=depth)).append(published)

    def latched(self, topic: str, now: float) -> PublishedMessage | None:
        kept = self._latched.get(topic)
        return None if kept is None or kept.until_s < now else kept.published

    def of(self, topic: str, now: float) -> list[PublishedMessage]:
        """Return what a new subscriber to the topic gets, oldest first."""
        latched = self.latched(topic, now)
        recent = (kept.published for kept in self._recent.get(topic, ()) if kept.until_s >= now)
        return [*self._histories.get(topic, ()), *(() if latched is None else (latched,)), *recent]

    def forget(self, topic: str) -> None:
        self._histories.pop(topic, None)
        self.unlatch(topic)
        self._recent_bytes -= sum(kept.size_bytes for kept in self._recent.pop(topic, ()))

    def give_up_old(self, now: float) -> None:
        while self._ending and self._latched[topic := next(iter(self._ending))].until_s < now:
            self.unlatch(topic)
        self._give_up_recent(now)

    def _give_up_recent(self, now: float) -> None:
        """Drop old messages; over the limit, the oldest message of the topic that has been quiet for longest."""
        while self._recent:
            topic, recent = next(iter(self._recent.items()))
            if recent[0].until_s >= now and self._recent_bytes <= MAX_RECENT_BYTES:
                return
            self._recent_bytes -= recent.popleft().size_bytes
            if not recent:
                del self._recent[topic]

"""What a topic keeps for those who subscribe later: its latched message, and its messages of the last moment.

rosbridge_server publishes with transient-local durability: with ``latch`` the last message is kept for as long as its
publisher lives, without it every message for a second (rosbridge_library, internal/publishers.py).
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from typing import NamedTuple

from protocol.publication import Publication

# Maps and meshes are latched, and have megabytes; every one beyond this is told to the log and not kept.
MAX_LATCHED_BYTES = 67_108_864

# The last messages of many topics, or a picture; the oldest goes first.
MAX_RECENT_BYTES = 4_194_304

# As many of one topic as rosbridge_server's subscribers take (QoS depth 10).
MAX_RECENT_PER_TOPIC = 10


class _Kept(NamedTuple):
    """A publication, how large it is, and until when it is kept [s]."""

    publication: Publication
    size_bytes: int
    until_s: float


class Retained:
    """The messages that are kept, of all topics."""

    def __init__(self) -> None:
        self._latched: dict[str, _Kept] = {}
        self._latched_bytes = 0
        # By topic, oldest first; the topics in order of their newest message, so that those in front have the oldest.
        self._recent: OrderedDict[str, deque[_Kept]] = OrderedDict()
        self._recent_bytes = 0

    def latch(self, publication: Publication) -> bool:
        """Keep a message instead of the one latched before it.

        Returns:
            False when all that is latched would be too large; then the topic has no latched message.
        """
        self.unlatch(publication.topic)
        size_bytes = publication.size_bytes
        if self._latched_bytes + size_bytes > MAX_LATCHED_BYTES:
            return False
        self._latched[publication.topic] = _Kept(publication, size_bytes, math.inf)
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

    def keep(self, publication: Publication, now: float, lifespan_s: float) -> None:
        """Keep a message for a while.

        Args:
            publication: the message.
            now: present time [s], monotonic.
            lifespan_s: for how long [s]; the same for all.
        """
        topic, size_bytes = publication.topic, publication.size_bytes
        recent = self._recent.setdefault(topic, deque())
        recent.append(_Kept(publication, size_bytes, now + lifespan_s))
        self._recent.move_to_end(topic)
        self._recent_bytes += size_bytes
        if len(recent) > MAX_RECENT_PER_TOPIC:
            self._recent_bytes -= recent.popleft().size_bytes
        self._give_up_old(now)

    def of(self, topic: str, now: float) -> list[Publication]:
        """Return what a new subscriber to the topic gets, oldest first.

        Args:
            topic: fully qualified name.
            now: present time [s], monotonic.
        """
        latched = self._latched.get(topic)
        recent = self._recent.get(topic, ())
        kept_now = recent if latched is None else [latched, *recent]
        return [kept.publication for kept in kept_now if kept.until_s >= now]

    def forget(self, topic: str) -> None:
        """Give up all that is kept of a topic."""
        self.unlatch(topic)
        self._recent_bytes -= sum(kept.size_bytes for kept in self._recent.pop(topic, ()))

    def _give_up_old(self, now: float) -> None:
        """Give up what is too old, and what is too much: the oldest of the topic that has been quiet for longest."""
        while self._recent:
            topic, recent = next(iter(self._recent.items()))
            if recent[0].until_s >= now and self._recent_bytes <= MAX_RECENT_BYTES:
                return
            self._recent_bytes -= recent.popleft().size_bytes
            if not recent:
                del self._recent[topic]

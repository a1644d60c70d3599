"""Subscriptions of one client: several ids on one topic merge into one delivery, which knows when it is due.

Rules of rosbridge: the merged throttle_rate, queue_length and fragment_size are the least of all ids, the merged
compression is the first of `COMPRESSIONS` that any id asks for. With a throttle and no queue, messages that come too
early are dropped; with a queue they wait, and when it is full the oldest goes. All ids of a client, of subscriptions
and of advertisements alike, count against one limit.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Generic, TypeVar

from protocol.errors import NothingToDoError, OperationError, describe
from protocol.operations import COMPRESSIONS, Advertise, Compression, OperationId, Subscribe, qualify

T = TypeVar("T", Advertise, Subscribe)


class Registrations(Generic[T]):
    """Operations ``op`` of one client by topic and id; ``opposite`` withdraws them."""

    def __init__(self, op: str, opposite: str, limit: int) -> None:
        self._op = op
        self._opposite = opposite
        self._limit = limit
        self._count = 0
        self._entries: dict[str, dict[OperationId, T]] = {}

    def __contains__(self, topic: str) -> bool:
        return qualify(topic) in self._entries

    def entries(self, topic: str) -> Collection[T]:
        return self._entries.get(qualify(topic), {}).values()

    def add(self, operation: T) -> bool:
        """Register an accepted operation, or raise OperationError at the limit; True for the first on the topic."""
        topic = qualify(operation.topic)
        # A refused operation must leave no empty topic behind, so the topic is made only afterwards.
        if operation.id not in self._entries.get(topic, {}):
            if self._count >= self._limit:
                raise OperationError(self._op, None, f"this client has {self._count}, the limit is {self._limit}")
            self._count += 1
        ids = self._entries.setdefault(topic, {})
        first = not ids
        ids[operation.id] = operation
        return first

    def remove(self, topic: str, entry_id: OperationId) -> bool:
        """Withdraw one entry, or all on the topic without an id; True when nothing is left.

        Raises NothingToDoError when there is no such entry.
        """
        ids = self._entries.get(qualify(topic), {})
        withdrawn = list(ids) if entry_id is None else [each for each in ids if each == entry_id]
        if not withdrawn:
            place = f"topic {topic}" if entry_id is None else f"topic {topic} under id {describe(entry_id)}"
            raise NothingToDoError(self._opposite, None, f"{place}: this client has no {self._op} of it")
        for each in withdrawn:
            del ids[each]
        self._count -= len(withdrawn)
        if not ids:
            del self._entries[qualify(topic)]
        return not ids


@dataclass(eq=False, slots=True)
class Subscription:
    """One topic's delivery to one client: the topic as first spelled, the merged wishes, and the last sending [s]."""

    spelled_topic: str
    throttle_s: float = 0.0
    queue_length: int = 0
    compression: Compression = "none"
    fragment_size: int | None = None
    last_sent_s: float = -math.inf
    closed: bool = False

    @property
    def due_s(self) -> float:
        """When the next message may leave [s]; minus infinity when all that wait may leave at any time."""
        return self.last_sent_s + self.throttle_s if self.paced else -math.inf

    @property
    def paced(self) -> bool:
        """True when messages wait for the throttle to let them through one by one."""
        return self.throttle_s > 0 and self.queue_length > 0 and not self.closed

    @property
    def skips(self) -> bool:
        """True when messages that come too early for the throttle are dropped."""
        return self.throttle_s > 0 and self.queue_length == 0

    def merge(self, asked: Collection[Subscribe]) -> None:
        self.throttle_s = min(each.throttle_rate for each in asked) / 1000
        self.queue_length = min(each.queue_length for each in asked)
        self.compression = min((each.encoding for each in asked), key=COMPRESSIONS.index)
        self.fragment_size = min((each.fragment_size for each in asked if each.fragment_size is not None), default=None)

    def admit(self, now: float) -> bool:
        """Decide on a message that has just come: take it, or drop it because it comes too early."""
        if not self.skips:
            return True
        if now < self.last_sent_s + self.throttle_s:
            return False
        self.last_sent_s = now
        return True

    def sent(self, now: float) -> None:
        """Note that messages have left, for the throttle to count from."""
        if self.paced:
            self.last_sent_s = now


class Subscriptions(Registrations[Subscribe]):
    """The topics a client has subscribed to, each with its delivery."""

    def __init__(self, limit: int) -> None:
        super().__init__("subscribe", "unsubscribe", limit)
        self._merged: dict[str, Subscription] = {}

    def get(self, topic: str) -> Subscription | None:
        """Return the delivery of a topic, given by its fully qualified name, None without a subscription."""
        return self._merged.get(topic)

    def add(self, operation: Subscribe) -> bool:
        """Register a subscription as :meth:`Registrations.add`, and merge it into the topic's delivery."""
        first = super().add(operation)
        # The delivery outlives the id that opened it: its spelling and its throttle's clock belong to the topic.
        subscription = self._merged.setdefault(qualify(operation.topic), Subscription(operation.topic))
        subscription.merge(self.entries(operation.topic))
        return first

    def remove(self, topic: str, entry_id: OperationId) -> bool:
        """Withdraw subscriptions as :meth:`Registrations.remove`; with the last one their delivery is closed."""
        none_left = super().remove(topic, entry_id)
        if none_left:
            # Frames of it may still wait in the send queue, which holds the delivery, not the table.
            self._merged.pop(qualify(topic)).closed = True
        else:
            self._merged[qualify(topic)].merge(self.entries(topic))
        return none_left

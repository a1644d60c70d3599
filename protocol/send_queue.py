"""Encoded messages that wait for one client: topic data, which may be dropped, and replies, which may not.

The rule for topic data is to drop the oldest: when more waits than one client may have, when a subscription is further
behind than it may be, when the client stands still, and when the budget of the whole server is used up and this client
has read least recently. So a slow client costs a bounded amount of memory, and what it reads at last is recent; a
client that keeps up loses nothing, however large its messages are. A message is already
encoded, or a thread encodes it: one frame, or several fragments that are sent or dropped together.
"""

from __future__ import annotations

import heapq
import itertools
import operator
from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

from protocol.limits import MAX_SERVER_QUEUED_BYTES, Limits
from protocol.publication import EncodedMessage
from protocol.subscriptions import Subscription

# Answers of this size on count until the socket has taken them, for they are nobody else's; smaller ones are as little
# as the buffers of the socket.
LARGE_ANSWER_BYTES = 65_536

# Messages of topics of this size on let smaller ones of other topics, and answers, go ahead when they have waited so
# long: seconds of pictures may wait over a slow link, and joint states are not to be as old as those.
BULKY_BYTES = 65_536
BEHIND_S = 0.25


class SendBudget:
    """Bytes that wait to be sent to all clients of a server."""

    def __init__(self, limit_bytes: int = MAX_SERVER_QUEUED_BYTES) -> None:
        self.limit_bytes = limit_bytes
        self.used_bytes = 0
        # Clients with waiting messages, the least recent reader first.
        self._holders: OrderedDict[SendQueue, None] = OrderedDict()

    def charge(self, holder: SendQueue, size_bytes: int) -> None:
        """Count bytes that begin to wait; call :meth:`make_room` when they stand in the queue."""
        self.used_bytes += size_bytes
        # A client for which nothing waited has read all it got: it goes last.
        self._holders.setdefault(holder)

    def release(self, holder: SendQueue, size_bytes: int, *, empty: bool) -> None:
        self.used_bytes -= size_bytes
        if empty:
            self._holders.pop(holder, None)

    def note_reading(self, holder: SendQueue) -> None:
        if holder in self._holders:
            self._holders.move_to_end(holder)

    def make_room(self) -> bool:
        """Have topic data dropped until the limit is kept; return False when it is not, for want of topic data."""
        while self.used_bytes > self.limit_bytes:
            victim = next((each for each in self._holders if each.has_topic_data), None)
            if victim is None:
                return False
            victim.drop_oldest()
        return True

    def make_room_for_reply(self) -> None:
        """Make room for replies: without any topic data left, clients that do not read are closed."""
        while not self.make_room():
            next(iter(self._holders)).give_up()


@dataclass(eq=False, slots=True)
class _Waiting:
    sequence: int
    encoded: EncodedMessage
    # Size that is counted, an estimate until it is encoded [bytes].
    size_bytes: int
    account: Literal["replies", "requests", "topic data"]
    # Queue in which it waits, by sequence number, oldest first.
    lane: OrderedDict[int, Any]


@dataclass(eq=False, slots=True)
class _TopicData(_Waiting):
    subscription: Subscription
    queued_s: float


_SEQUENCE = operator.attrgetter("sequence")


class SendQueue:
    """The messages of one client, in order of queuing.

    Attributes:
        dropped: number of topic messages dropped because the client was slow or its queue_length was reached.
        throttled: how many of them were dropped by the client's own throttle.
        overflowed: True when replies exceed their bound, or the client does not read and the budget is used up.
    """

    def __init__(self, limits: Limits, budget: SendBudget | None = None) -> None:
        self.dropped = 0
        self.throttled = 0
        self.overflowed = False
        self._limits = limits
        self._budget = budget or SendBudget()
        self._closed = False
        self._sequence = itertools.count()
        # Requests of others wait among the replies; they have a bound of their own.
        self._replies: OrderedDict[int, _Waiting] = OrderedDict()
        # Topic data: free to leave at any time, bulky, and waiting for a throttle, which must not be gone through each
        # time that the rest is sent. A subscription's messages may wait in several lanes, its older ones in the first.
        self._free: OrderedDict[int, _TopicData] = OrderedDict()
        self._bulky: OrderedDict[int, _TopicData] = OrderedDict()
        self._paced: OrderedDict[int, _TopicData] = OrderedDict()
        self._bytes = {"replies": 0, "requests": 0, "topic data": 0}
        # True when the next that leaves of a client that is behind is bulky.
        self._bulky_first = False
        # Topic data that waits for each subscription, oldest first.
        self._waiting: dict[Subscription, deque[_TopicData]] = {}
        # Messages that hold up those behind them until they are encoded, and those whose encoding has not begun.
        self._unready: set[_Waiting] = set()
        self._to_encode: list[EncodedMessage] = []
        # Large answers and requests that have been taken out last: the socket may still have them.
        self._leaving_bytes = 0

    @property
    def empty(self) -> bool:
        return not (self._waiting or self._replies)

    @property
    def has_topic_data(self) -> bool:
        return bool(self._waiting)

    @property
    def reply_bytes(self) -> int:
        return self._bytes["replies"]

    @property
    def size_bytes(self) -> int:
        """Size of all that waits, and of large answers that the socket may still have [bytes]."""
        return sum(self._bytes.values()) + self._leaving_bytes

    def put_reply(self, encoded: EncodedMessage) -> None:
        """Queue a reply; one alone may have any size, one too many beside others sets `overflowed`."""
        if self._closed:
            return
        if self.reply_bytes and self.reply_bytes + encoded.size_bytes > self._limits.max_queued_reply_bytes:
            self.overflowed = True
            return
        self._put(_Waiting(next(self._sequence), encoded, encoded.size_bytes, "replies", self._replies))
        self._budget.make_room_for_reply()

    def put_request(self, encoded: EncodedMessage) -> bool:
        """Queue a call or goal; False when there is no room beside others. One alone may have any size."""
        waiting_bytes = self._bytes["requests"]
        is_too_much = waiting_bytes and waiting_bytes + encoded.size_bytes > self._limits.max_queued_request_bytes
        if self._closed or is_too_much:
            return False
        request = _Waiting(next(self._sequence), encoded, encoded.size_bytes, "requests", self._replies)
        self._put(request)
        if self._budget.make_room():
            return True
        self._take(request)
        return False

    def put_topic_data(
        self, subscription: Subscription, encoded: EncodedMessage, now: float, *, in_order: bool = False
    ) -> None:
        """Queue topic data that its subscription has admitted, and drop what exceeds the bounds then."""
        if self._closed:
            return
        while 0 < subscription.queue_length <= len(self._waiting.get(subscription, ())):
            self._drop(self._waiting[subscription][0])
        self._drop_late(subscription, now)
        # Behind messages that are bulky, or wait for a throttle that is gone, others wait too: they keep their order.
        lane = self._waiting[subscription][-1].lane if subscription in self._waiting else self._free
        if subscription.paced:
            lane = self._paced
        elif lane is self._free and encoded.size_bytes >= BULKY_BYTES and not in_order:
            lane = self._bulky
        waiting = _TopicData(
            next(self._sequence), encoded, encoded.size_bytes, "topic data", lane, subscription, queued_s=now
        )
        self._waiting.setdefault(subscription, deque()).append(waiting)
        self._put(waiting)
        self._budget.make_room()

    def drop_late(self, now: float) -> None:
        """Drop topic data that has waited for longer than ``max_topic_delay_s``: the client stands still."""
        for subscription in list(self._waiting):
            self._drop_late(subscription, now)

    def drop_oldest(self) -> None:
        oldest = (next(iter(lane.values())) for lane in (self._free, self._bulky, self._paced) if lane)
        self._drop(min(oldest, key=_SEQUENCE))

    def give_up(self) -> None:
        """Drop all that waits and take no more, before the client is closed."""
        self.overflowed = True
        self.close()

    def close(self) -> None:
        """Drop all that waits and take no more."""
        self._closed = True
        for lane in (self._replies, self._free, self._bulky, self._paced):
            for waiting in list(lane.values()):
                self._take(waiting)
        self._to_encode.clear()
        self._count_leaving(0)

    def take_unready(self) -> list[EncodedMessage]:
        """Take the messages to be encoded, each once; call it again once some are encoded: their size is known then."""
        if self._unready:
            self._recount()
        to_encode, self._to_encode = self._to_encode, []
        return to_encode

    def take_due(self, now: float, budget_bytes: int) -> list[EncodedMessage]:
        """Take out what may leave now, in order of queuing, until the messages exceed ``budget_bytes``.

        Call it when the socket takes more, also when nothing waits: what has been taken out before has left then.
        """
        self._count_leaving(0)
        self._budget.note_reading(self)
        for subscription in [each for each in self._waiting if each.closed]:
            for unwanted in list(self._waiting[subscription]):
                self._take(unwanted)
        due: list[_Waiting] = []
        due_bytes = 0
        for waiting in self._due(now):
            if not waiting.encoded.ready:
                break
            due.append(waiting)
            due_bytes += waiting.encoded.size_bytes
            if due_bytes >= budget_bytes:
                break
        if self._bulky:
            self._bulky_first = not self._bulky_first
        leaving_bytes = sum(each.encoded.size_bytes for each in due if not isinstance(each, _TopicData))
        if leaving_bytes >= LARGE_ANSWER_BYTES:
            self._count_leaving(leaving_bytes)
        for waiting in due:
            self._take(waiting)
            if isinstance(waiting, _TopicData):
                waiting.subscription.sent(now)
        # A message that could not be encoded has no frames.
        return [each.encoded for each in due if each.encoded.frame_count]

    def next_due(self, now: float) -> float | None:
        """Return when the next message may leave [s]; None when nothing waits or the first is still to be encoded."""
        if self._unready or self._bulky:
            first = next(self._due(now), None)
            if first is not None:
                return now if first.encoded.ready else None
        elif self._replies or self._free:
            return now
        return min((max(now, subscription.due_s) for subscription in self._throttled()), default=None)

    def _throttled(self) -> list[Subscription]:
        """Return the subscriptions whose messages wait for a throttle."""
        paced = self._paced
        return [each for each, waiting in self._waiting.items() if waiting[-1].lane is paced] if paced else []

    def _due(self, now: float) -> Iterator[_Waiting]:
        """Go over all that may leave, in order; nothing may be taken out meanwhile."""
        lanes: list[Iterable[_Waiting]] = [lane.values() for lane in (self._replies, self._free) if lane]
        for subscription in self._throttled():
            if now >= subscription.due_s:
                # One by one; all of them where the throttle is gone.
                due = itertools.islice(self._waiting[subscription], 1 if subscription.paced else None)
                # Those that have waited since before the subscription had its throttle are free.
                lanes.append(each for each in due if each.lane is self._paced)
        if self._bulky:
            oldest = next(iter(self._bulky.values()))
            if oldest.queued_s >= now - BEHIND_S:
                lanes.append(self._bulky.values())
            elif oldest.encoded.ready:
                rest = heapq.merge(*lanes, key=_SEQUENCE)
                is_next = self._waiting[oldest.subscription][0] is oldest
                goes_first = self._bulky_first and is_next
                return itertools.chain((oldest,), rest) if goes_first else itertools.chain(rest, (oldest,))
        return iter(lanes[0]) if len(lanes) == 1 else heapq.merge(*lanes, key=_SEQUENCE)

    def _put(self, waiting: _Waiting) -> None:
        waiting.lane[waiting.sequence] = waiting
        self._bytes[waiting.account] += waiting.size_bytes
        self._budget.charge(self, waiting.size_bytes)
        if not waiting.encoded.ready:
            self._unready.add(waiting)
            self._to_encode.append(waiting.encoded)
        self._keep_limit()

    def _count_leaving(self, size_bytes: int) -> None:
        more_bytes, self._leaving_bytes = size_bytes - self._leaving_bytes, size_bytes
        if more_bytes > 0:
            self._budget.charge(self, more_bytes)
        elif more_bytes < 0:
            self._budget.release(self, -more_bytes, empty=self.empty)

    def _recount(self) -> None:
        """Correct the sizes of messages that have been encoded; the bounds hold for what they really have."""
        for waiting in [each for each in self._unready if each.encoded.ready]:
            self._unready.remove(waiting)
            more_bytes = waiting.encoded.size_bytes - waiting.size_bytes
            waiting.size_bytes += more_bytes
            self._bytes[waiting.account] += more_bytes
            self._budget.charge(self, more_bytes)
        # A reply that turns out to be larger stays: it is due already.
        self._keep_limit()
        self._budget.make_room_for_reply()

    def _keep_limit(self) -> None:
        """Drop the oldest topic data beyond what may wait for one client."""
        # The newest always stays, even beyond the bound: else it could never be delivered.
        limits = self._limits
        while (count := len(self._free) + len(self._bulky) + len(self._paced)) > 1 and (
            count > limits.max_queued_messages or sum(self._bytes.values()) > limits.max_queued_bytes
        ):
            self.drop_oldest()

    def _drop_late(self, subscription: Subscription, now: float) -> None:
        """Drop the oldest messages of a subscription that could have left longer ago than they may wait."""
        since_s = now - self._limits.max_topic_delay_s
        while waiting := self._waiting.get(subscription):
            oldest = waiting[0]
            if max(subscription.due_s, oldest.queued_s) >= since_s:
                return
            # It is not the client that is slow while a message is encoded.
            if not oldest.encoded.ready:
                oldest.queued_s = now
                return
            self._drop(oldest)

    def _drop(self, oldest: _TopicData) -> None:
        self._take(oldest)
        self.dropped += 1
        self.throttled += oldest.subscription.paced

    def _take(self, waiting: _Waiting) -> None:
        """Take a message out; of the topic data of a subscription it must be the oldest."""
        del waiting.lane[waiting.sequence]
        self._bytes[waiting.account] -= waiting.size_bytes
        self._unready.discard(waiting)
        if isinstance(waiting, _TopicData):
            of_subscription = self._waiting[waiting.subscription]
            of_subscription.popleft()
            if not of_subscription:
                del self._waiting[waiting.subscription]
        self._budget.release(self, waiting.size_bytes, empty=self.empty and not self._leaving_bytes)

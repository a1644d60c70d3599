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
from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

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
        # One for which nothing waited has read all it got: it goes last.
        self._holders.setdefault(holder)

    def release(self, holder: SendQueue, size_bytes: int, *, empty: bool) -> None:
        """Count bytes that wait no more."""
        self.used_bytes -= size_bytes
        if empty:
            self._holders.pop(holder, None)

    def note_reading(self, holder: SendQueue) -> None:
        """Note that a client takes data."""
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


@dataclass(slots=True)
class _Waiting:
    encoded: EncodedMessage
    size_bytes: int


@dataclass(slots=True)
class _TopicData(_Waiting):
    subscription: Subscription
    queued_s: float


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
        # By sequence number, oldest first.
        self._replies: OrderedDict[int, _Waiting] = OrderedDict()
        # Of the replies that wait.
        self.reply_bytes = 0
        # Which of them are requests of others; these have a bound of their own.
        self._requests: set[int] = set()
        self._request_bytes = 0
        # Topic data by sequence number, oldest first: free to leave at any time, bulky, and waiting for a throttle,
        # which must not be gone through each time that the rest is sent.
        self._free: OrderedDict[int, _TopicData] = OrderedDict()
        self._bulky: OrderedDict[int, _TopicData] = OrderedDict()
        self._paced: OrderedDict[int, _TopicData] = OrderedDict()
        # True when the next that leaves of a client that is behind is bulky.
        self._bulky_first = False
        self._topic_bytes = 0
        # Which of them wait for each subscription, oldest first; the subscriptions that wait for a throttle, and those
        # with bulky messages.
        self._waiting: dict[Subscription, deque[int]] = {}
        self._throttled: set[Subscription] = set()
        self._with_bulky: set[Subscription] = set()
        # Messages that hold up those behind them until they are encoded, and those whose encoding has not begun.
        self._unready: dict[int, _Waiting] = {}
        self._to_encode: list[EncodedMessage] = []
        # Large answers and requests that have been taken out last: the socket may still have them.
        self._leaving_bytes = 0

    @property
    def empty(self) -> bool:
        """True when nothing waits."""
        return not (self._free or self._bulky or self._paced or self._replies)

    @property
    def has_topic_data(self) -> bool:
        """True while topic data waits."""
        return bool(self._free or self._bulky or self._paced)

    @property
    def size_bytes(self) -> int:
        """Size of all that waits, and of large answers that the socket may still have [bytes]."""
        return self._topic_bytes + self.reply_bytes + self._request_bytes + self._leaving_bytes

    def put_reply(self, encoded: EncodedMessage) -> None:
        """Queue a reply; one alone may have any size, one too many beside others sets `overflowed`."""
        if self._closed:
            return
        size_bytes = self.reply_bytes + encoded.size_bytes
        if self.reply_bytes and size_bytes > self._limits.max_queued_reply_bytes:
            self.overflowed = True
            return
        self.reply_bytes = size_bytes
        self._put(next(self._sequence), encoded)
        self._keep_limit()
        self._budget.make_room_for_reply()

    def put_request(self, encoded: EncodedMessage) -> bool:
        """Queue a call or goal; False when there is no room beside others. One alone may have any size."""
        size_bytes = self._request_bytes + encoded.size_bytes
        if self._closed or (self._requests and size_bytes > self._limits.max_queued_request_bytes):
            return False
        sequence = next(self._sequence)
        self._request_bytes = size_bytes
        self._requests.add(sequence)
        self._put(sequence, encoded)
        self._keep_limit()
        if self._budget.make_room():
            return True
        self._take_reply(sequence)
        return False

    def put_topic_data(
        self, subscription: Subscription, encoded: EncodedMessage, now: float, *, in_order: bool = False
    ) -> None:
        """Queue topic data that its subscription has admitted, and drop what exceeds the bounds then."""
        if self._closed:
            return
        if subscription in self._waiting:
            while 0 < subscription.queue_length <= len(self._waiting.get(subscription, ())):
                self._drop(self._waiting[subscription][0])
            self._drop_late(subscription, now)
        sequence = next(self._sequence)
        if subscription in self._waiting:
            self._waiting[subscription].append(sequence)
        else:
            self._waiting[subscription] = deque((sequence,))
        waiting = _TopicData(encoded, encoded.size_bytes, subscription, now)
        # Behind messages that wait for a throttle that is gone, others wait too: they keep their order.
        if subscription.paced or subscription in self._throttled:
            self._paced[sequence] = waiting
            self._throttled.add(subscription)
        elif subscription in self._with_bulky or (waiting.size_bytes >= BULKY_BYTES and not in_order):
            self._bulky[sequence] = waiting
            self._with_bulky.add(subscription)
        else:
            self._free[sequence] = waiting
        self._topic_bytes += waiting.size_bytes
        self._count(sequence, waiting)
        self._keep_limit()
        self._budget.make_room()

    def drop_late(self, now: float) -> None:
        """Drop topic data that has waited for longer than ``max_topic_delay_s``: the client stands still."""
        for subscription in list(self._waiting):
            self._drop_late(subscription, now)

    def drop_oldest(self) -> None:
        """Drop the oldest topic data."""
        self._drop(min(next(iter(lane)) for lane in (self._free, self._bulky, self._paced) if lane))

    def give_up(self) -> None:
        """Drop all that waits and take no more, before the client is closed."""
        self.overflowed = True
        self.close()

    def close(self) -> None:
        """Drop all that waits and take no more."""
        self._closed = True
        for sequence in list(self._replies):
            self._take_reply(sequence)
        for sequence in sorted((*self._free, *self._bulky, *self._paced)):
            self._take(sequence)
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
        if self._leaving_bytes:
            self._count_leaving(0)
        if len(self._free) == 1 and not (self._bulky or self._paced or self._replies):
            return self._take_only(now)
        self._budget.note_reading(self)
        self._forget_closed()
        due, due_bytes = [], 0
        for sequence in self._due(now):
            encoded = self._encoded(sequence)
            if not encoded.ready:
                break
            due.append(sequence)
            due_bytes += encoded.size_bytes
            if due_bytes >= budget_bytes:
                break
        if self._bulky:
            self._bulky_first = not self._bulky_first
        leaving_bytes = sum(self._replies[each].encoded.size_bytes for each in due if each in self._replies)
        if leaving_bytes >= LARGE_ANSWER_BYTES:
            self._count_leaving(leaving_bytes)
        taken = [self._take_reply(each) if each in self._replies else self._take_sent(each, now) for each in due]
        # A message that could not be encoded has no frames.
        return [encoded for encoded in taken if encoded.frame_count]

    def next_due(self, now: float) -> float | None:
        """Return when the next message may leave [s]; None when nothing waits or the first is still to be encoded."""
        if self._unready or self._bulky:
            first = next(self._due(now), None)
            if first is not None:
                return now if self._encoded(first).ready else None
        elif self._replies or self._free:
            return now
        return min((max(now, subscription.due_s) for subscription in self._throttled), default=None)

    def _take_only(self, now: float) -> list[EncodedMessage]:
        """Take out the one message that waits, as mostly with a client that keeps up."""
        ((sequence, waiting),) = self._free.items()
        if not waiting.encoded.ready and not waiting.subscription.closed:
            return []
        encoded = self._take_sent(sequence, now)
        return [encoded] if encoded.frame_count and not waiting.subscription.closed else []

    def _due(self, now: float) -> Iterator[int]:
        """Go over the sequence numbers of all that may leave, in order; nothing may be taken out meanwhile."""
        lanes: list[Iterable[int]] = [lane for lane in (self._replies, self._free) if lane]
        for subscription in self._throttled:
            waiting = self._waiting[subscription]
            due = itertools.islice(waiting, subscription.due_count(len(waiting), now))
            # Those that have waited since before the subscription had its throttle are free.
            lanes.append(sequence for sequence in due if sequence in self._paced)
        if self._bulky:
            sequence, oldest = next(iter(self._bulky.items()))
            if oldest.queued_s >= now - BEHIND_S:
                lanes.append(self._bulky)
            elif oldest.encoded.ready:
                first = itertools.islice(self._bulky, 1)
                rest = heapq.merge(*lanes)
                is_next = self._waiting[oldest.subscription][0] == sequence
                return itertools.chain(first, rest) if self._bulky_first and is_next else itertools.chain(rest, first)
        return iter(lanes[0]) if len(lanes) == 1 else heapq.merge(*lanes)

    def _encoded(self, sequence: int) -> EncodedMessage:
        return (self._replies[sequence] if sequence in self._replies else self._topic_data(sequence)).encoded

    def _topic_data(self, sequence: int) -> _TopicData:
        return self._lane_of(sequence)[sequence]

    def _lane_of(self, sequence: int) -> OrderedDict[int, _TopicData]:
        if sequence in self._free:
            return self._free
        return self._bulky if sequence in self._bulky else self._paced

    def _put(self, sequence: int, encoded: EncodedMessage) -> None:
        waiting = self._replies[sequence] = _Waiting(encoded, encoded.size_bytes)
        self._count(sequence, waiting)

    def _count(self, sequence: int, waiting: _Waiting) -> None:
        self._budget.charge(self, waiting.size_bytes)
        if not waiting.encoded.ready:
            self._unready[sequence] = waiting
            self._to_encode.append(waiting.encoded)

    def _count_leaving(self, size_bytes: int) -> None:
        more_bytes, self._leaving_bytes = size_bytes - self._leaving_bytes, size_bytes
        if more_bytes > 0:
            self._budget.charge(self, more_bytes)
        elif more_bytes < 0:
            self._budget.release(self, -more_bytes, empty=self.empty)

    def _recount(self) -> None:
        """Correct the sizes of messages that have been encoded; the bounds hold for what they really have."""
        for sequence in [each for each, waiting in self._unready.items() if waiting.encoded.ready]:
            waiting = self._unready.pop(sequence)
            more_bytes = waiting.encoded.size_bytes - waiting.size_bytes
            waiting.size_bytes += more_bytes
            if sequence in self._requests:
                self._request_bytes += more_bytes
            elif sequence in self._replies:
                self.reply_bytes += more_bytes
            else:
                self._topic_bytes += more_bytes
            self._budget.charge(self, more_bytes)
        # A reply that turns out to be larger stays: it is due already.
        self._keep_limit()
        self._budget.make_room_for_reply()

    def _keep_limit(self) -> None:
        """Drop the oldest topic data beyond what may wait for one client."""
        # The newest always stays, even beyond the bound: else it could never be delivered.
        limits = self._limits
        while (count := len(self._free) + len(self._bulky) + len(self._paced)) > 1 and (
            count > limits.max_queued_messages
            or self._topic_bytes + self.reply_bytes + self._request_bytes > limits.max_queued_bytes
        ):
            self.drop_oldest()

    def _drop_late(self, subscription: Subscription, now: float) -> None:
        """Drop the oldest messages of a subscription that could have left longer ago than they may wait."""
        since_s = now - self._limits.max_topic_delay_s
        while waiting := self._waiting.get(subscription):
            oldest = self._topic_data(waiting[0])
            if max(subscription.due_s, oldest.queued_s) >= since_s:
                return
            # It is not the client that is slow while a message is encoded.
            if not oldest.encoded.ready:
                oldest.queued_s = now
                return
            self._drop(waiting[0])

    def _forget_closed(self) -> None:
        for subscription in [one for one in self._waiting if one.closed]:
            for sequence in list(self._waiting[subscription]):
                self._take(sequence)

    def _take_reply(self, sequence: int) -> EncodedMessage:
        waiting = self._replies.pop(sequence)
        if sequence in self._requests:
            self._requests.remove(sequence)
            self._request_bytes -= waiting.size_bytes
        else:
            self.reply_bytes -= waiting.size_bytes
        self._release(sequence, waiting)
        return waiting.encoded

    def _take_sent(self, sequence: int, now: float) -> EncodedMessage:
        taken = self._take(sequence)
        taken.subscription.sent(now)
        return taken.encoded

    def _drop(self, sequence: int) -> None:
        subscription = self._take(sequence).subscription
        self.dropped += 1
        self.throttled += subscription.paced

    def _take(self, sequence: int) -> _TopicData:
        """Take out topic data; of its subscription it must be the oldest."""
        taken = self._lane_of(sequence).pop(sequence)
        self._topic_bytes -= taken.size_bytes
        waiting = self._waiting[taken.subscription]
        waiting.popleft()
        if not waiting:
            del self._waiting[taken.subscription]
            self._throttled.discard(taken.subscription)
            self._with_bulky.discard(taken.subscription)
        self._release(sequence, taken)
        return taken

    def _release(self, sequence: int, waiting: _Waiting) -> None:
        self._unready.pop(sequence, None)
        self._budget.release(self, waiting.size_bytes, empty=self.empty and not self._leaving_bytes)

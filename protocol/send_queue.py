"""Encoded messages that wait for one client: topic data, which may be dropped, and replies, which may not.

Topic data has one bound in bytes over all topics, and its rule is to drop the oldest. A slow client so costs
a fixed amount of memory, and what it reads at last is recent. A message is encoded already:
one frame, or several fragments that are sent or dropped together.
"""

from __future__ import annotations

import heapq
import itertools
from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator

from protocol.limits import Limits
from protocol.publication import EncodedMessage, Frame
from protocol.subscriptions import Subscription


class SendQueue:
    """The messages of one client, in order of queuing.

    Args:
        limits: the client's bounds.

    Attributes:
        dropped: number of topic messages given up because the client was slow or its queue_length was reached;
            those that came too early for a throttle without a queue are not counted.
        throttled: how many of them are to be put down to the client's own throttle.
        overflowed: whether replies piled up beyond their bound.
    """

    def __init__(self, limits: Limits) -> None:
        self.dropped = 0
        self.throttled = 0
        self.overflowed = False
        self._limits = limits
        self._sequence = itertools.count()
        # By sequence number, oldest first.
        self._replies: OrderedDict[int, EncodedMessage] = OrderedDict()
        self._reply_bytes = 0
        # Which of them are requests of others; these have a bound of their own.
        self._requests: set[int] = set()
        self._request_bytes = 0
        # All topic data by sequence number, oldest first; and which of them wait for each subscription.
        self._topic_data: OrderedDict[int, tuple[EncodedMessage, Subscription]] = OrderedDict()
        self._topic_bytes = 0
        self._waiting: dict[Subscription, deque[int]] = {}
        # Messages that hold up those behind them until they are encoded, and those whose encoding has not begun.
        self._unready: set[EncodedMessage] = set()
        self._to_encode: list[EncodedMessage] = []

    @property
    def empty(self) -> bool:
        """True when nothing waits."""
        return not self._topic_data and not self._replies

    @property
    def reply_bytes(self) -> int:
        """Size of the replies that wait [bytes]."""
        return self._reply_bytes

    @property
    def size_bytes(self) -> int:
        """Size of all that waits [bytes]."""
        return self._topic_bytes + self._reply_bytes + self._request_bytes

    def put_reply(self, encoded: EncodedMessage) -> None:
        """Queue a reply; one alone may have any size, one too many beside others sets `overflowed`."""
        if self._reply_bytes and self._reply_bytes + encoded.size_bytes > self._limits.max_queued_reply_bytes:
            self.overflowed = True
            return
        self._note_unready(encoded)
        self._replies[next(self._sequence)] = encoded
        self._reply_bytes += encoded.size_bytes

    def put_request(self, encoded: EncodedMessage) -> bool:
        """Queue a call or goal for the client, in order with its replies.

        Returns:
            False when there is no room for it beside others; one alone may have any size.
        """
        size_bytes = self._request_bytes + encoded.size_bytes
        if self._requests and size_bytes > self._limits.max_queued_request_bytes:
            return False
        self._note_unready(encoded)
        sequence = next(self._sequence)
        self._replies[sequence] = encoded
        self._requests.add(sequence)
        self._request_bytes = size_bytes
        return True

    def put_topic_data(self, subscription: Subscription, encoded: EncodedMessage) -> None:
        """Queue topic data that its subscription has admitted, and drop what is then too much."""
        while 0 < subscription.queue_length <= len(self._waiting.get(subscription, ())):
            self._drop(self._waiting[subscription][0])
        self._note_unready(encoded)
        sequence = next(self._sequence)
        self._waiting.setdefault(subscription, deque()).append(sequence)
        self._topic_data[sequence] = encoded, subscription
        self._topic_bytes += encoded.size_bytes
        # The newest always stays, even one that is larger than the bound: else it could never be delivered.
        while self._topic_bytes > self._limits.max_queued_topic_bytes and len(self._topic_data) > 1:
            self._drop(next(iter(self._topic_data)))

    def take_unready(self) -> list[EncodedMessage]:
        """Take the messages that are still to be encoded; each is returned once."""
        to_encode, self._to_encode = self._to_encode, []
        return to_encode

    def _note_unready(self, encoded: EncodedMessage) -> None:
        if not encoded.ready:
            self._unready.add(encoded)
            self._to_encode.append(encoded)

    def take_due(self, now: float, budget_bytes: int) -> list[Frame]:
        """Take out what may leave now, in order of queuing, until the budget is used up.

        Args:
            now: present time [s], monotonic.
            budget_bytes: no further message is taken once the taken ones have this size.
        """
        if not self._replies and len(self._topic_data) == 1:
            return self._take_only(now)
        due: list[Frame] = []
        taken_bytes = 0
        for sequence in self._due(now):
            if self._unready and self._waits_for_encoding(sequence):
                break
            encoded = self._take_reply(sequence) if sequence in self._replies else self._take_sent(sequence, now)
            taken_bytes += encoded.size_bytes
            due += encoded.frames
            if taken_bytes >= budget_bytes:
                break
        return due

    def next_due(self, now: float) -> float | None:
        """Return when the next message may leave [s]: `now` when one is due, None when nothing waits.

        None as well when the first that is due is still to be encoded.
        """
        if self._unready:
            first = next(self._due(now), None)
            if first is not None and self._waits_for_encoding(first):
                return None
        if self._replies:
            return now
        return min((max(now, subscription.due_s) for subscription in self._waiting), default=None)

    def _take_only(self, now: float) -> list[Frame]:
        """Take out the one message that waits, as mostly with a client that keeps up, if it may leave."""
        ((sequence, (encoded, subscription)),) = self._topic_data.items()
        if not subscription.closed and not (encoded.ready and subscription.due_count(1, now)):
            return []
        self._take(sequence)
        subscription.sent(now)
        return [] if subscription.closed else list(encoded.frames)

    def _due(self, now: float) -> Iterator[int]:
        """Go over the sequence numbers of all that may leave, in order; taking them out meanwhile is fine."""
        lanes: list[Iterable[int]] = [list(self._replies)] if self._replies else []
        self._forget_closed()
        for subscription, waiting in self._waiting.items():
            count = subscription.due_count(len(waiting), now)
            if count:
                lanes.append(list(itertools.islice(waiting, count)))
        return iter(lanes[0]) if len(lanes) == 1 else heapq.merge(*lanes)

    def _waits_for_encoding(self, sequence: int) -> bool:
        encoded = self._replies[sequence] if sequence in self._replies else self._topic_data[sequence][0]
        self._unready = {each for each in self._unready if not each.ready}
        return not encoded.ready

    def _forget_closed(self) -> None:
        for subscription in [one for one in self._waiting if one.closed]:
            for sequence in list(self._waiting[subscription]):
                self._take(sequence)

    def _take_reply(self, sequence: int) -> EncodedMessage:
        encoded = self._replies.pop(sequence)
        if sequence in self._requests:
            self._requests.remove(sequence)
            self._request_bytes -= encoded.size_bytes
        else:
            self._reply_bytes -= encoded.size_bytes
        return encoded

    def _take_sent(self, sequence: int, now: float) -> EncodedMessage:
        encoded, subscription = self._take(sequence)
        subscription.sent(now)
        return encoded

    def _drop(self, sequence: int) -> None:
        _, subscription = self._take(sequence)
        self.dropped += 1
        self.throttled += subscription.paced

    def _take(self, sequence: int) -> tuple[EncodedMessage, Subscription]:
        """Take out topic data; of its subscription it must be the oldest."""
        encoded, subscription = self._topic_data.pop(sequence)
        self._topic_bytes -= encoded.size_bytes
        waiting = self._waiting[subscription]
        waiting.popleft()
        if not waiting:
            del self._waiting[subscription]
        return encoded, subscription

"""Frames waiting for one client: topic data, which may be dropped, and replies, which may not.

Topic data has one bound in bytes over all topics, and its rule is to drop the oldest. A slow client so costs
a fixed amount of memory, and what it reads at last is recent.
"""

from __future__ import annotations

import itertools
from collections import OrderedDict, deque

from protocol.limits import Limits
from protocol.subscriptions import Subscription

# What the interpreter spends on a waiting frame beside its bytes (170 were measured, the rest is the allocator's),
# so that a flood of tiny frames is bounded too.
FRAME_OVERHEAD_BYTES = 256


class Outbox:
    """The frames of one client, in order of queuing.

    Args:
        limits: the client's bounds.

    Attributes:
        dropped: number of topic frames given up because the client was slow or its queue_length was reached;
            those that came too early for a throttle without a queue are not counted.
        overflowed: whether replies piled up beyond their bound.
    """

    def __init__(self, limits: Limits) -> None:
        self.dropped = 0
        self.overflowed = False
        self._limits = limits
        self._sequence = itertools.count()
        self._replies: list[tuple[int, bytes]] = []
        self._reply_bytes = 0
        # All topic data by sequence number, oldest first; and which of them wait for each subscription.
        self._topic_frames: OrderedDict[int, tuple[bytes, Subscription]] = OrderedDict()
        self._topic_bytes = 0
        self._waiting: dict[Subscription, deque[int]] = {}

    def put_reply(self, frame: bytes) -> None:
        """Queue a reply; one alone may have any size, one too many beside others sets `overflowed`."""
        size = len(frame) + FRAME_OVERHEAD_BYTES
        if self._replies and self._reply_bytes + size > self._limits.max_queued_reply_bytes:
            self.overflowed = True
            return
        self._replies.append((next(self._sequence), frame))
        self._reply_bytes += size

    def put_topic_data(self, subscription: Subscription, frame: bytes) -> None:
        """Queue topic data that its subscription has admitted, and drop what is then too much."""
        while 0 < subscription.queue_length <= len(self._waiting.get(subscription, ())):
            self._drop(self._waiting[subscription][0])
        sequence = next(self._sequence)
        self._waiting.setdefault(subscription, deque()).append(sequence)
        self._topic_frames[sequence] = frame, subscription
        self._topic_bytes += len(frame) + FRAME_OVERHEAD_BYTES
        # The newest always stays, even one that is larger than the bound: else it could never be delivered.
        while self._topic_bytes > self._limits.max_queued_topic_bytes and len(self._topic_frames) > 1:
            self._drop(next(iter(self._topic_frames)))

    def take_due(self, now: float) -> list[bytes]:
        """Take out every frame that may leave now, in order of queuing.

        Args:
            now: present time [s], monotonic.
        """
        # Replies have no throttle; the list is handed over rather than copied.
        due = self._replies
        self._replies = []
        self._reply_bytes = 0
        for subscription, waiting in list(self._waiting.items()):
            leaving = itertools.islice(waiting.copy(), subscription.due_count(len(waiting), now))
            frames = [(sequence, self._take(sequence)) for sequence in leaving]
            if frames and not subscription.closed:
                subscription.sent(now)
                due += frames
        # Sequence numbers differ, so the frames themselves are never compared.
        due.sort()
        return [frame for _, frame in due]

    def next_due(self, now: float) -> float | None:
        """Return when the next frame may leave [s]: `now` when one is due, None when nothing waits."""
        if self._replies:
            return now
        return min((max(now, subscription.due_s) for subscription in self._waiting), default=None)

    def _drop(self, sequence: int) -> None:
        self._take(sequence)
        self.dropped += 1

    def _take(self, sequence: int) -> bytes:
        """Take out topic data; of its subscription it must be the oldest."""
        frame, subscription = self._topic_frames.pop(sequence)
        self._topic_bytes -= len(frame) + FRAME_OVERHEAD_BYTES
        waiting = self._waiting[subscription]
        waiting.popleft()
        if not waiting:
            del self._waiting[subscription]
        return frame

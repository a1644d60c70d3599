"""Memory for what waits to be sent, which the clients of a server share.

The bytes of a message count for each client that it waits for. Several clients may share one message, so the memory in
use is never more than the count, and a message that one client gives up makes room at once.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Protocol

from protocol.limits import MAX_SERVER_QUEUED_BYTES


class Holder(Protocol):
    """Queue of one client, which holds a part of the budget."""

    @property
    def has_topic_data(self) -> bool:
        """True while topic data waits in it."""

    def drop_oldest(self) -> None:
        """Drop the oldest topic data."""

    def give_up(self) -> None:
        """Drop all that waits: the client is to be closed."""


class SendBudget:
    """Bytes that wait to be sent to all clients of a server."""

    def __init__(self, limit_bytes: int = MAX_SERVER_QUEUED_BYTES) -> None:
        self.limit_bytes = limit_bytes
        self.used_bytes = 0
        # Clients with waiting messages, the least recent reader first.
        self._holders: OrderedDict[Holder, None] = OrderedDict()

    @property
    def exceeded(self) -> bool:
        """True while more waits than may."""
        return self.used_bytes > self.limit_bytes

    def charge(self, holder: Holder, size_bytes: int) -> None:
        """Count bytes that begin to wait; call :meth:`make_room` when they stand in the queue."""
        self.used_bytes += size_bytes
        # One for which nothing waited has read all it got: it goes last.
        if holder not in self._holders:
            self._holders[holder] = None

    def release(self, holder: Holder, size_bytes: int, *, empty: bool) -> None:
        """Count bytes that wait no more."""
        self.used_bytes -= size_bytes
        if empty:
            self._holders.pop(holder, None)

    def note_reading(self, holder: Holder) -> None:
        """Note that a client takes data."""
        if holder in self._holders:
            self._holders.move_to_end(holder)

    def make_room(self) -> bool:
        """Have topic data dropped until the limit is kept; return False when it is not, for want of topic data."""
        while self.exceeded:
            victim = next((each for each in self._holders if each.has_topic_data), None)
            if victim is None:
                return False
            victim.drop_oldest()
        return True

    def make_room_for_reply(self) -> None:
        """Make room for replies: without any topic data left, clients that do not read are closed."""
        while not self.make_room():
            next(iter(self._holders)).give_up()

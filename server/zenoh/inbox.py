"""What has come from the network and waits for the event loop: bounded, so that no flood grows the server."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

# So much may wait while the event loop is busy; afterwards the oldest is given up.
MAX_WAITING = 500
MAX_WAITING_BYTES = 33_554_432

# Then clients get their turn.
ITEMS_AT_A_TIME = 20

Item = TypeVar("Item")


class Inbox(Generic[Item]):
    """A queue from zenoh's threads to the event loop.

    Args:
        loop: the event loop.
        take: called there with each item, in order.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, take: Callable[[Item], None]) -> None:
        self._loop = loop
        self._take = take
        self._lock = threading.Lock()
        self._waiting: deque[tuple[Item, int]] = deque()
        self._waiting_bytes = 0
        self._called = False
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """How many items have been given up."""
        return self._dropped

    def put(self, item: Item, size_bytes: int) -> None:
        """Add an item, from any thread; never waits."""
        with self._lock:
            self._waiting.append((item, size_bytes))
            self._waiting_bytes += size_bytes
            while len(self._waiting) > MAX_WAITING or self._waiting_bytes > MAX_WAITING_BYTES:
                self._waiting_bytes -= self._waiting.popleft()[1]
                self._dropped += 1
            called, self._called = self._called, True
        if not called:
            # The loop is closed when the server has ended, and the network has not.
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._take_some)

    def _take_some(self) -> None:
        for item in self._some():
            self._take(item)
        with self._lock:
            self._called = bool(self._waiting)
        if self._called:
            self._loop.call_soon(self._take_some)

    def _some(self) -> list[Item]:
        with self._lock:
            taken = [self._waiting.popleft() for _ in range(min(ITEMS_AT_A_TIME, len(self._waiting)))]
            self._waiting_bytes -= sum(size_bytes for _, size_bytes in taken)
        return [item for item, _ in taken]

"""Places for requests, of which there may become more and fewer."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator


class Places:
    """So many may hold a place at the same time; the others wait in the order in which they came.

    Args:
        count: how many places there are.

    Attributes:
        waiting: how many wait for a place.
    """

    def __init__(self, count: int) -> None:
        self._free = asyncio.Semaphore(count)
        # Places that are taken away from whoever gives one back, or would take one next.
        self._surplus = 0
        self.waiting = 0

    def add(self) -> None:
        """Make one more place."""
        self._give_back()

    def remove(self) -> None:
        """Take one place away; who holds one keeps it as long as it is needed."""
        self._surplus += 1

    @contextlib.asynccontextmanager
    async def held(self) -> AsyncIterator[None]:
        """Wait for a place and hold it."""
        self.waiting += 1
        try:
            await self._take()
        finally:
            self.waiting -= 1
        try:
            yield
        finally:
            self._give_back()

    async def _take(self) -> None:
        await self._free.acquire()
        while self._surplus:
            self._surplus -= 1
            await self._free.acquire()

    def _give_back(self) -> None:
        if self._surplus:
            self._surplus -= 1
        else:
            self._free.release()

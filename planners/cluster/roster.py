"""Which workers of a cluster plan for this server."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping

log = logging.getLogger("armbridge.cluster")

# A worker that cannot plan is asked again after so long: it may have been out of reach, or busy.
RETRY_PAUSE_S = 30.0


class Roster:
    """Workers by address, from when they are first seen until they are gone.

    Args:
        recruit: makes a worker ready; says why it cannot be, or None.

    Attributes:
        members: address -> how many requests it takes at the same time, of those that are ready.
    """

    def __init__(self, recruit: Callable[[str], Awaitable[str | None]]) -> None:
        self._recruit = recruit
        self._recruiting: dict[str, asyncio.Task[None]] = {}
        self._refused: dict[str, tuple[float, str]] = {}
        self.members: dict[str, int] = {}

    def see(self, threads: Mapping[str, int], now_s: float) -> None:
        """Take note of who is there: recruit who is new, and forget who is gone.

        Args:
            threads: address -> how many requests it can take at the same time.
            now_s: monotonic time [s].
        """
        self.members = {worker: count for worker, count in self.members.items() if worker in threads}
        self._refused = {worker: refused for worker, refused in self._refused.items() if worker in threads}
        for worker, count in threads.items():
            refused_s, _ = self._refused.get(worker, (-RETRY_PAUSE_S, ""))
            if worker not in self.members and worker not in self._recruiting and now_s - refused_s >= RETRY_PAUSE_S:
                self._recruiting[worker] = asyncio.create_task(self._try(worker, count, now_s))

    @property
    def busy(self) -> bool:
        """Whether it is not known yet of every worker that it has seen whether it can plan."""
        return bool(self._recruiting)

    async def close(self) -> None:
        """Recruit nobody any more, and have no members."""
        recruiting = list(self._recruiting.values())
        for task in recruiting:
            task.cancel()
        await asyncio.gather(*recruiting, return_exceptions=True)
        self.members.clear()

    async def _try(self, worker: str, count: int, now_s: float) -> None:
        try:
            refusal = await self._recruit(worker)
        except (OSError, TimeoutError) as error:
            refusal = f"it is out of reach: {str(error) or type(error).__name__}"
        except Exception as error:
            log.exception("recruiting the worker %s failed", worker)
            refusal = f"{type(error).__name__}: {error}"
        finally:
            del self._recruiting[worker]
        if refusal is None:
            self._refused.pop(worker, None)
            self.members[worker] = count
            return
        if self._refused.get(worker, (0.0, ""))[1] != refusal:
            log.error("the worker %s of the planning cluster is left out: %s", worker, refusal)
        self._refused[worker] = (now_s, refusal)

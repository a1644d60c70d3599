"""Work on files in threads, with a bound on the threads that a disk without an answer holds."""

import asyncio
import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from server.errors import ServiceError

# A memory card that takes longer is at its end.
TIMEOUT_S = 5.0

Result = TypeVar("Result")


class Disk:
    """Work on files of one place in a thread, one after the other: a disk that never answers holds one thread."""

    def __init__(self, timeout_s: float = TIMEOUT_S) -> None:
        self._timeout_s = timeout_s
        self._one_at_a_time = asyncio.Lock()
        self._work: asyncio.Task[Any] | None = None
        self._until_s = 0.0

    async def do(self, work: Callable[[], Result]) -> Result:
        """Return the result of work, or raise its error.

        Raises OSError for work that does not end in time, and at once for work behind it.
        """
        async with self._one_at_a_time:
            # Work goes on though its caller has left, or has its error.
            await self._end_of_work()
            self._work = doing = asyncio.create_task(asyncio.to_thread(work))
            self._until_s = asyncio.get_running_loop().time() + self._timeout_s
            # Nobody may be left to take its error.
            doing.add_done_callback(lambda done: done.cancelled() or done.exception())
            await self._end_of_work()
            return doing.result()

    async def _end_of_work(self) -> None:
        if self._work is not None and not self._work.done():
            left_s = max(0.0, self._until_s - asyncio.get_running_loop().time())
            if not (await asyncio.wait([self._work], timeout=left_s))[0]:
                raise OSError(errno.ETIMEDOUT, f"the disk does not answer within {self._timeout_s:g} s")

    def follow(self, action: Callable[[], None]) -> None:
        """Act when the work in progress has ended, at once where there is none; never where the loop ends before it."""
        work = self._work

        def act(_work: object = None) -> None:
            # The end of the loop cancels the task, whose thread works on.
            if work is None or not work.cancelled():
                action()

        if work is None or work.done():
            act()
        else:
            work.add_done_callback(act)

    async def serve(self, path: Path | str, failure: str, work: Callable[[], Result]) -> Result:
        """Do work on a file, or raise ServiceError whose sentence begins with `failure`."""
        try:
            return await self.do(work)
        except OSError as error:
            raise ServiceError(f"{failure}: {path}: {error.strerror}") from error
        except ValueError as error:
            raise ServiceError(f"{failure}: {error}") from error

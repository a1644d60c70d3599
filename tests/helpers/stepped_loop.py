"""Event loop for tests that wait: time passes when there is nothing else to do, and then at once."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Callable


class SteppedLoop(asyncio.SelectorEventLoop):
    """Event loop whose clock starts at 0 and goes on to the next timer as soon as no callback is ready.

    Only for tests without sockets, threads and child processes: what takes real time takes none of this clock's, and a
    wait for it with a timeout ends with the timeout.
    """

    def __init__(self) -> None:
        self._now_s = 0.0
        super().__init__(_SteppingSelector(self.advance))

    def time(self) -> float:
        return self._now_s

    def advance(self, seconds: float) -> None:
        """Let time pass while the loop does something else, as when a callback holds it up."""
        self._now_s += seconds


class _SteppingSelector(selectors.DefaultSelector):
    """Selector that has time pass instead of waiting for a timer."""

    def __init__(self, advance: Callable[[float], None]) -> None:
        super().__init__()
        self._advance = advance

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(None if timeout is None else 0.0)
        if not ready and timeout is not None:
            self._advance(timeout)
        return ready

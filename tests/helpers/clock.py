"""Time that a test moves: a clock with timers, and an event loop that never waits."""

import asyncio
import selectors
from collections.abc import Callable
from dataclasses import dataclass


@dataclass
class FakeTimer:
    """Something that happens when the clock gets there."""

    due_s: float
    action: Callable[[], None]
    cancelled: bool = False

    def cancel(self) -> None:
        self.cancelled = True


class FakeClock:
    """Monotonic time [s] and its timers."""

    def __init__(self, now_s: float = 100.0) -> None:
        self.now_s = now_s
        self.timers: list[FakeTimer] = []

    def __call__(self) -> float:
        return self.now_s

    def call_later(self, delay_s: float, action: Callable[[], None]) -> FakeTimer:
        timer = FakeTimer(self.now_s + delay_s, action)
        self.timers.append(timer)
        return timer

    @property
    def waiting(self) -> int:
        """Number of timers that are still to come."""
        return sum(not timer.cancelled for timer in self.timers)

    def advance(self, seconds: float) -> None:
        """Let time pass; what is due happens in order."""
        until_s = self.now_s + seconds
        while due := [timer for timer in self.timers if not timer.cancelled and timer.due_s <= until_s]:
            timer = min(due, key=lambda one: one.due_s)
            self.timers.remove(timer)
            self.now_s = max(self.now_s, timer.due_s)
            timer.action()
        self.now_s = until_s


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

    async def shutdown_default_executor(self, timeout: float | None = None) -> None:  # noqa: ASYNC109
        """Wait for threads in real time: by this clock any timeout of theirs is over at once."""
        await super().shutdown_default_executor()


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

"""Time that a test moves, and what is to happen then."""

from __future__ import annotations

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
        """How many timers are still to come."""
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

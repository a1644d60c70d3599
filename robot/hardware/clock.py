"""Clock of the control loop: the machine's for a real arm, its own for a simulated one.

A real arm moves on while the machine is busy, so its loop must see how late it is. The time of a simulated arm passes
tick by tick, by no more than :data:`MAX_TICK_S` each, so that a starved loop runs slower than real time without effect
on its guards, timers and servos.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque

# Two periods: a tick that starts one period late advances by both, as on a real arm.
MAX_TICK_S = 0.02

# Ticks over which the real-time factor is averaged, a second of them.
FACTOR_TICKS = 100


class LoopClock(ABC):
    """Monotonic clock; call it for the time [s]."""

    @abstractmethod
    def __call__(self) -> float:
        """Return the time [s]."""

    @abstractmethod
    def start_tick(self, machine_s: float, at_most_s: float = MAX_TICK_S) -> None:
        """Mark the start of a tick.

        Args:
            machine_s: the machine's monotonic time [s].
            at_most_s: longest time that may pass for a simulated arm; more after skipped ticks [s].
        """

    @property
    @abstractmethod
    def real_time_factor(self) -> float:
        """Real-time factor as in simulators: arm's time per machine's time."""


class MachineClock(LoopClock):
    """Monotonic clock of the machine."""

    def __call__(self) -> float:
        """Return the time [s]."""
        return time.monotonic()

    def start_tick(self, machine_s: float, at_most_s: float = MAX_TICK_S) -> None:
        """Do nothing: the machine's time passes by itself."""

    @property
    def real_time_factor(self) -> float:
        """Always 1."""
        return 1.0


class SimulationClock(LoopClock):
    """Clock that advances at the start of each tick only, from the machine's monotonic time on [s]."""

    def __init__(self, machine_s: float) -> None:
        self._now_s = self._tick_s = machine_s
        self._passed_s: deque[tuple[float, float]] = deque(maxlen=FACTOR_TICKS)

    def __call__(self) -> float:
        """Return the time [s]."""
        return self._now_s

    def start_tick(self, machine_s: float, at_most_s: float = MAX_TICK_S) -> None:
        """Advance by the time since the last tick, up to a bound."""
        elapsed_s = max(machine_s - self._tick_s, 0.0)
        passed_s = min(elapsed_s, at_most_s)
        self._tick_s = machine_s
        self._now_s += passed_s
        self._passed_s.append((passed_s, elapsed_s))

    @property
    def real_time_factor(self) -> float:
        """Real-time factor over the last second's ticks; 1 before the first."""
        elapsed_s = sum(elapsed for _, elapsed in self._passed_s)
        return sum(passed for passed, _ in self._passed_s) / elapsed_s if elapsed_s > 0.0 else 1.0

"""Time of the control loop: the machine's for a real arm, its own for a simulated one.

A real arm moves on while the machine is busy, so its loop has to see how late it is. A simulated arm need not: its time
passes tick by tick and by no more than :data:`MAX_TICK_S` each, so that a starved loop runs slower than real time and
no guard, timer or servo in it can tell.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque

# Two periods: a tick that starts one period late is made up for, as on a real arm.
MAX_TICK_S = 0.02

# Ticks over which the real-time factor is told, a second of them.
FACTOR_TICKS = 100


class LoopClock(ABC):
    """Monotonic time [s], read by calling it."""

    @abstractmethod
    def __call__(self) -> float:
        """Time now [s]."""

    @abstractmethod
    def start_tick(self, machine_s: float, at_most_s: float = MAX_TICK_S) -> None:
        """Note that a tick starts.

        Args:
            machine_s: the machine's monotonic time [s].
            at_most_s: longest time that may pass for a simulated arm; more where ticks were skipped [s].
        """

    @property
    @abstractmethod
    def real_time_factor(self) -> float:
        """Seconds of the arm's time that pass in one of the machine's, as simulators tell it."""


class MachineClock(LoopClock):
    """The machine's monotonic clock."""

    def __call__(self) -> float:
        """Time now [s]."""
        return time.monotonic()

    def start_tick(self, machine_s: float, at_most_s: float = MAX_TICK_S) -> None:
        """Do nothing: the machine's time passes by itself."""

    @property
    def real_time_factor(self) -> float:
        """One, whatever the machine does."""
        return 1.0


class SimulationClock(LoopClock):
    """Time that stands still within a tick and between ticks, and passes at their starts.

    Args:
        machine_s: the machine's monotonic time, at which it begins [s].
    """

    def __init__(self, machine_s: float) -> None:
        self._now_s = self._tick_s = machine_s
        self._passed_s: deque[tuple[float, float]] = deque(maxlen=FACTOR_TICKS)

    def __call__(self) -> float:
        """Time now [s]."""
        return self._now_s

    def start_tick(self, machine_s: float, at_most_s: float = MAX_TICK_S) -> None:
        """Let the time since the last tick pass, up to a bound."""
        elapsed_s = max(machine_s - self._tick_s, 0.0)
        passed_s = min(elapsed_s, at_most_s)
        self._tick_s = machine_s
        self._now_s += passed_s
        self._passed_s.append((passed_s, elapsed_s))

    @property
    def real_time_factor(self) -> float:
        """Share of the machine's time that has passed here over the last second's ticks; 1 before the first."""
        elapsed_s = sum(elapsed for _, elapsed in self._passed_s)
        return sum(passed for passed, _ in self._passed_s) / elapsed_s if elapsed_s > 0.0 else 1.0

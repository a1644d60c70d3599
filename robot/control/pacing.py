"""Time of the control loop: deadlines and lateness of ticks, and the clock of the arm.

A real arm moves on while the machine is busy, so its loop must see how late it is, and its clock is the machine's. The
time of a simulated arm passes tick by tick, by no more than :data:`MAX_TICK_S` each, so that a starved loop runs slower
than real time without effect on its guards, timers and servos.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable

import numpy as np

PERIOD_S = 0.01

# Ticks over which lateness and the real-time factor are kept: the last second.
TICKS_KEPT = round(1.0 / PERIOD_S)

# Two periods: a tick that starts one period late advances by both, as on a real arm.
MAX_TICK_S = 2.0 * PERIOD_S

# Far above the rounding of monotonic times in periods, far below any visible effect.
ROUNDING = 1e-9


class Pacer:
    """Pacer with absolute deadlines; a missed tick is skipped, never made up for."""

    def __init__(self, now_s: float) -> None:
        self.deadline_s = now_s + PERIOD_S  # monotonic time at which the next tick is due [s]
        self.lateness_s: deque[float] = deque(maxlen=TICKS_KEPT)  # start of the latest ticks after their deadlines [s]

    def start_tick(self, now_s: float) -> None:
        """Record the start of the tick that was due, and set the next deadline."""
        late_s = now_s - self.deadline_s
        self.lateness_s.append(late_s)
        # The rounding of a tick that starts exactly at the next deadline must not make it due again at once.
        self.deadline_s += PERIOD_S * (1 + max(0, math.floor(late_s / PERIOD_S + ROUNDING)))

    def skip(self, ticks: int) -> None:
        """Postpone the next tick by a number of periods."""
        self.deadline_s += ticks * PERIOD_S

    def cancel_skip(self, ticks: int, now_s: float) -> None:
        """Undo :meth:`skip`; a tick that would have been due meanwhile is due now, and not late."""
        self.deadline_s = max(self.deadline_s - ticks * PERIOD_S, now_s)

    def latest(self, count: int) -> tuple[float, ...]:
        """Return the lateness of the latest ticks, one value each [s]."""
        return tuple(self.lateness_s)[-count:]


def percentiles(values_s: Iterable[float]) -> tuple[float, float, float]:
    """Compute p50, p99 and the greatest of some times [s]; zeros when there are none."""
    values = np.fromiter(values_s, dtype=float)
    if not values.size:
        return 0.0, 0.0, 0.0
    p50, p99, greatest = np.percentile(values, (50, 99, 100)).tolist()
    return p50, p99, greatest


class LoopClock:
    """Clock of the control loop, the machine's monotonic one; call it for the time [s]."""

    def __call__(self) -> float:
        """Return the time [s]."""
        return time.monotonic()

    def start_tick(self, machine_s: float, at_most_s: float = MAX_TICK_S) -> None:
        """Mark the start of a tick at a time of the machine [s]; the machine's time passes by itself.

        A simulated arm's time passes by ``at_most_s``, more after skipped ticks [s].
        """

    @property
    def real_time_factor(self) -> float:
        """Real-time factor as in simulators: arm's time per machine's time."""
        return 1.0


class SimulationClock(LoopClock):
    """Clock that starts at a time of the machine, and advances at the start of each tick only."""

    def __init__(self, machine_s: float) -> None:
        self._now_s = self._tick_s = machine_s
        self._passed_s: deque[tuple[float, float]] = deque(maxlen=TICKS_KEPT)

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

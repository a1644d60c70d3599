"""Pacing of the control loop: deadlines and lateness of ticks, and real-time priority."""

from __future__ import annotations

import contextlib
import gc
import math
import os
from collections import deque
from collections.abc import Iterable

import numpy as np

PERIOD_S = 0.01

# Ticks whose lateness is kept: the last second.
KEPT = round(1.0 / PERIOD_S)

# Lowest priority of its class: above every ordinary process, below the kernel's own threads.
REAL_TIME_PRIORITY = 1

# Tried where real-time priority is not permitted.
NICENESS = -10

# Far above the rounding of monotonic times in periods, far below what anything could notice.
ROUNDING = 1e-9


class Pacer:
    """Pacer with absolute deadlines; a missed tick is skipped, never made up for.

    Args:
        now_s: monotonic time [s].

    Attributes:
        deadline_s: monotonic time at which the next tick is due [s].
        lateness_s: start of the latest ticks after their deadlines [s].
    """

    def __init__(self, now_s: float) -> None:
        self.deadline_s = now_s + PERIOD_S
        self.lateness_s: deque[float] = deque(maxlen=KEPT)

    def start_tick(self, now_s: float) -> None:
        """Record the start of the tick that was due, and set the next deadline."""
        late_s = now_s - self.deadline_s
        self.lateness_s.append(late_s)
        # The rounding of a tick that starts exactly at the next deadline must not make it due again at once.
        self.deadline_s += PERIOD_S * (1 + max(0, math.floor(late_s / PERIOD_S + ROUNDING)))

    def skip(self, ticks: int) -> None:
        """Postpone the next tick by a number of periods."""
        self.deadline_s += ticks * PERIOD_S

    def hurry(self, ticks: int, now_s: float) -> None:
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


def become_punctual() -> bool:
    """Request real-time priority, and switch garbage collection off.

    A collection in the middle of a motion would delay ticks; the loop makes no reference cycles.

    Returns:
        True if the process has real-time priority.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    return take_priority()


def take_priority() -> bool:
    """Request real-time priority, else a low niceness; return True if it is real-time."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
        return True
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    return False

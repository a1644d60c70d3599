"""Pacing of the control loop: deadlines and lateness of ticks, and real-time priority."""

from __future__ import annotations

import contextlib
import gc
import logging
import math
import os
import resource
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

log = logging.getLogger("armbridge.arm")

PERIOD_S = 0.01

# Ticks whose lateness is kept: the last second.
KEPT = round(1.0 / PERIOD_S)

# Lowest priority of its class: above every ordinary process, below the kernel's own threads.
REAL_TIME_PRIORITY = 1

# Tried where real-time priority is not permitted.
NICENESS = -10

# Flags of mlockall(2) on x86 and ARM (linux/mman.h): what is mapped, what will be, and each page when it is first used.
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4

# Least RLIMIT_MEMLOCK under which memory is locked. All that the process maps counts against it, whether it is used or
# not: 180 MB at its start, of which it uses 36.
MIN_LOCKABLE_BYTES = 1 << 30

# Far above the rounding of monotonic times in periods, far below any visible effect.
ROUNDING = 1e-9


class Pacer:
    """Pacer with absolute deadlines; a missed tick is skipped, never made up for.

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


class Scheduling(NamedTuple):
    """Protection of the loop's ticks against the rest of the machine."""

    real_time: bool = False
    memory_locked: bool = False


def enter_realtime() -> Scheduling:
    """Request real-time priority, and with it locked memory, and switch garbage collection off.

    A collection in the middle of a motion would delay ticks; the loop makes no reference cycles.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    real_time = take_priority()
    return Scheduling(real_time, real_time and lock_memory())


def lock_memory() -> bool:
    """Keep the process's memory from being swapped out; return True if it is kept, log why not.

    A page that must first be read from a disk makes a tick late by milliseconds. A limit that is reached later would
    make an allocation fail in the middle of a motion, so memory is not locked under a low one.
    """
    limit_bytes, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit_bytes != resource.RLIM_INFINITY and limit_bytes < MIN_LOCKABLE_BYTES:
        log.info("memory is not locked: RLIMIT_MEMLOCK is %d bytes, less than %d", limit_bytes, MIN_LOCKABLE_BYTES)
        return False
    import ctypes  # 10 ms of a start that needs it only here

    if ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT):
        log.info("memory is not locked: mlockall: %s", os.strerror(ctypes.get_errno()))
        return False
    return True


def take_priority() -> bool:
    """Request real-time priority, else a low niceness; return True if it is real-time."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
        return True
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    return False

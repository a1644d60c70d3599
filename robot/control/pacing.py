"""Time of the control loop: deadlines and lateness of ticks, the clock of the arm, and real-time scheduling.

A real arm moves on while the machine is busy, so its loop must see how late it is, and its clock is the machine's. The
time of a simulated arm passes tick by tick, by no more than :data:`MAX_TICK_S` each, so that a starved loop runs slower
than real time without effect on its guards, timers and servos.
"""

import contextlib
import gc
import logging
import math
import os
import resource
import time
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from robot.hardware.config import ClockReading
from robot.trajectory import PERIOD_S

log = logging.getLogger("armbridge.arm")

# A tick that is brought forward comes this share of a period after the last, or later. At 1 Mbit/s six servos are read
# and given their goals within 2 ms, and a USB adapter takes another.
LEAST_SHARE = 0.4

TICKS_KEPT = round(1.0 / PERIOD_S)  # ticks over which lateness and the real-time factor are kept: the last second
MAX_TICK_S = 2.0 * PERIOD_S  # two periods: a tick that starts one period late advances by both, as on a real arm
ROUNDING = 1e-9  # far above the rounding of monotonic times in periods, far below any visible effect


class Pacer:
    """Pacer with absolute deadlines; a missed tick is skipped, never made up for."""

    def __init__(self, now_s: float) -> None:
        self._period_s = PERIOD_S  # of the machine's time [s]
        self.deadline_s = now_s + PERIOD_S  # monotonic time at which the next tick is due [s]
        self.tick_s = now_s  # monotonic time at which the latest tick started [s]
        self.late_s = 0.0  # start of the latest tick after its deadline [s]
        self._prompt_s = now_s  # monotonic time at which the latest prompt tick was wanted [s]
        self.lateness_s: deque[float] = deque(maxlen=TICKS_KEPT)  # start of the latest ticks after their deadlines [s]

    def start_tick(self, now_s: float, rate: float = 1.0) -> None:
        """Record the start of the tick that was due, and set the next deadline, at an arm's time per machine's."""
        self.tick_s, self.late_s = now_s, now_s - self.deadline_s
        self.lateness_s.append(self.late_s)
        period_s = self._period_s = PERIOD_S / rate
        # The rounding of a tick that starts exactly at the next deadline must not make it due again at once.
        self.deadline_s += period_s * (1 + max(0, math.floor(self.late_s / period_s + ROUNDING)))
        if self._prompt_s > now_s:
            self.bring_forward(self._prompt_s)

    def skip(self, ticks: int) -> None:
        """Postpone the next tick by a number of periods."""
        self.deadline_s += ticks * self._period_s

    def cancel_skip(self, ticks: int, now_s: float) -> None:
        """Undo :meth:`skip`; a tick that would have been due meanwhile is due now, and not late."""
        self.deadline_s = max(self.deadline_s - ticks * self._period_s, now_s)

    def bring_forward(self, at_s: float) -> None:
        """Let the first tick from a time on be due then, not late, and :data:`LEAST_SHARE` of a period after another.

        Regular ticks before that time come as ever.
        """
        self._prompt_s = at_s
        self.deadline_s = min(self.deadline_s, max(at_s, self.tick_s + LEAST_SHARE * self._period_s))

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

    stepped_ticks: int | None = None  # single ticks since a simulated arm's time stands still; None while it passes
    rate = 1.0  # arm's time per machine's time, where the machine is fast enough

    def __call__(self) -> float:
        """Return the time [s]."""
        return time.monotonic()

    def pause(self, *, paused: bool, ticks: int = 0) -> None:
        """Do nothing: the time of a real arm passes."""

    def start_tick(self, machine_s: float, at_most_s: float = MAX_TICK_S) -> None:
        """Mark the start of a tick [s]; a simulated arm's time passes by ``at_most_s``, more after skipped ticks."""

    def follow_real_time(self, *, steered: bool) -> None:
        """Let the time pass at the machine's rate while the arm is steered from outside."""

    def stamp_s(self, wall_s: float) -> float:
        """Return the stamp of a reading that was taken at a time of the wall clock, both in seconds since the epoch."""
        return wall_s

    @property
    def real_time_factor(self) -> float:
        """Real-time factor as in simulators: arm's time per machine's time."""
        return 1.0


class SimulationClock(LoopClock):
    """Clock that advances at the start of each tick only, ``rate`` times as fast as the machine's where it can.

    It starts with the machine's time, or goes on from the time of an arm process that has ended.
    """

    def __init__(self, machine_s: float, rate: float = 1.0, start: ClockReading | None = None) -> None:
        self._nominal_rate = self.rate = rate
        self._now_s, stamp_s = start or ClockReading(machine_s, time.time())
        self._epoch_s = stamp_s - self._now_s
        self._tick_s = machine_s
        self._ticks_left = 0  # single ticks to come while the time stands still
        # Reports and /diagnostics come once a second each: of a report that /diagnostics misses, the next has the half.
        self._passed_s: deque[tuple[float, float]] = deque(maxlen=2 * TICKS_KEPT)

    def __call__(self) -> float:
        """Return the time [s]."""
        return self._now_s

    def pause(self, *, paused: bool, ticks: int = 0) -> None:
        """Let the time stand still after ``ticks`` single ones, or pass again."""
        self.stepped_ticks, self._ticks_left = (self.stepped_ticks or 0) if paused else None, ticks

    def start_tick(self, machine_s: float, at_most_s: float = MAX_TICK_S) -> None:
        """Advance by the time since the last tick, up to a bound; by a single tick, or nothing, while it is paused."""
        elapsed_s = max(machine_s - self._tick_s, 0.0)
        self._tick_s = machine_s
        if self.stepped_ticks is not None:
            if self._ticks_left:
                self._ticks_left, self.stepped_ticks = self._ticks_left - 1, self.stepped_ticks + 1
                self._now_s += PERIOD_S
            return
        passed_s = min(self.rate * elapsed_s, at_most_s)
        self._now_s += passed_s
        self._passed_s.append((passed_s, elapsed_s))

    def follow_real_time(self, *, steered: bool) -> None:
        """Let the time pass at the machine's rate while the arm is steered from outside."""
        self.rate = 1.0 if steered else self._nominal_rate

    def stamp_s(self, wall_s: float) -> float:
        """Return the wall clock's time at the first start plus the arm's time since then, where the rate is not 1."""
        if self._nominal_rate == 1.0:
            return wall_s
        return self._epoch_s + self._now_s

    @property
    def real_time_factor(self) -> float:
        """Real-time factor over the ticks of the last two seconds; 1 before the first."""
        elapsed_s = sum(elapsed for _, elapsed in self._passed_s)
        return sum(passed for passed, _ in self._passed_s) / elapsed_s if elapsed_s > 0.0 else 1.0


REAL_TIME_PRIORITY = 1  # lowest priority of its class: above every ordinary process, below the kernel's own threads
NICENESS = -10  # tried where real-time priority is not permitted

# Flags of mlockall(2) on x86 and ARM (linux/mman.h): present mappings, future ones, and each page at its first use.
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4

# Least RLIMIT_MEMLOCK under which memory is locked. All that the process maps counts against it, whether it is used or
# not: 180 MB at its start, 36 of them used.
MIN_LOCKABLE_BYTES = 1 << 30

NOT_LOCKED = "memory is not locked, so swapping may delay a real arm (docs/hardware.md)"


class Scheduling(NamedTuple):
    """Protection of the loop's ticks against the rest of the machine."""

    real_time: bool = False
    memory_locked: bool = False


def enter_realtime(rate: float) -> Scheduling:
    """Request real-time priority and locked memory, and end garbage collections, which would delay ticks.

    A clock faster than the machine's may keep a core busy, and gets no priority over the planners.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    if rate != 1.0:
        return Scheduling()
    real_time = take_priority()
    return Scheduling(real_time, real_time and lock_memory())


def lock_memory() -> bool:
    """Keep memory from being swapped out, unless a low limit would make allocations fail; return True if it is kept."""
    limit_bytes, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit_bytes != resource.RLIM_INFINITY and limit_bytes < MIN_LOCKABLE_BYTES:
        log.info("%s: RLIMIT_MEMLOCK is %d bytes, less than %d", NOT_LOCKED, limit_bytes, MIN_LOCKABLE_BYTES)
        return False
    import ctypes  # 10 ms of a start that needs it only here

    if ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT):
        log.info("%s: mlockall: %s", NOT_LOCKED, os.strerror(ctypes.get_errno()))
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

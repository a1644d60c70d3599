"""Time budget of a problem: its deadline and its cancellation.

A deadline is extended by the time that the process waits for a core, which is no fault of the problem.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from planners.problem import MoveItErrorCode, PlanningFailure

# A goal is allowed 60 s of planning at most (allowed_planning_time): waits for a core extend them by no more than that.
MAX_STARVED_S = 60.0


def read_run_delay_s(pid: int) -> float | None:
    """Read how long a process has waited on run queues since its start [s]; None if that is unknown.

    That is the second field of /proc/PID/schedstat [ns] (the kernel's Documentation/scheduler/sched-stats.rst). It
    counts the main thread, and leaves out a wait that has not ended: at most 50 ms were measured among 12 other
    programs. It is unknown of a process that is gone, and where the kernel does not count it.
    """
    try:
        on_core_ns, run_delay_ns, _ = map(int, Path(f"/proc/{pid}/schedstat").read_text().split())
    except (OSError, ValueError):
        return None
    # A kernel that does not count says "0 0 0" (proc_pid_schedstat in fs/proc/base.c).
    return run_delay_ns * 1e-9 if on_core_ns else None


class Deadline:
    """Deadline of a process, extended by its waits for a core, up to :data:`MAX_STARVED_S`.

    ``run_delay_s`` reads the time that the process has waited for a core so far [s]; None, where it is unknown, leaves
    the deadline as given.
    """

    def __init__(
        self,
        allowed_s: float,
        run_delay_s: Callable[[], float | None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._allowed_s = allowed_s
        self._run_delay_s = run_delay_s
        self._clock = clock
        self._began_s = clock()
        self._waited_before_s = run_delay_s()

    def left_s(self) -> float:
        """Return the time to the deadline by the waits so far [s]; zero or less once it has passed."""
        waited_s, starved_s = self._run_delay_s(), 0.0
        if waited_s is not None and self._waited_before_s is not None:
            starved_s = min(waited_s - self._waited_before_s, MAX_STARVED_S)
        return self._allowed_s + starved_s - (self._clock() - self._began_s)


class Budget:
    """Time left for one problem, from its construction on; ``should_stop`` is true once the request is cancelled."""

    def __init__(self, clock: Callable[[], float], allowed_time_s: float, should_stop: Callable[[], bool]) -> None:
        self._clock = clock
        self._start_s = clock()
        self._allowed_time_s = allowed_time_s
        self.should_stop = should_stop

    @property
    def spent_s(self) -> float:
        """Time since the start [s]."""
        return self._clock() - self._start_s

    @property
    def left_s(self) -> float:
        """Time that is left; 0 or less once it is over [s]."""
        return self._allowed_time_s - self.spent_s

    def share(self, share: float) -> Budget:
        """Return the budget of a part of the work, which has a share of the time that is left."""
        return Budget(self._clock, share * self.left_s, self.should_stop)

    def used_up(self) -> bool:
        """Tell whether to stop now."""
        return self.should_stop() or self.spent_s >= self._allowed_time_s

    def failure(self) -> PlanningFailure:
        """Return the reason for which planning stopped; to be called once the budget is used up."""
        if self.should_stop():
            return preempted(self.spent_s)
        return PlanningFailure(
            MoveItErrorCode.TIMED_OUT,
            f"no motion was found within the allowed {self._allowed_time_s:g} s",
            {"allowed_time_s": self._allowed_time_s},
        )


def preempted(spent_s: float) -> PlanningFailure:
    """Return the answer to a request that was cancelled after so much time [s]."""
    return PlanningFailure(MoveItErrorCode.PREEMPTED, f"planning was stopped after {spent_s:.2f} s")


def never() -> bool:
    """Tell that a request is never cancelled."""
    return False

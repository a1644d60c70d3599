"""Time budget of a problem: its deadline and its cancellation."""

from __future__ import annotations

from collections.abc import Callable

from planners.problem import MoveItErrorCode, PlanningFailure


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
        text = f"no motion was found within the allowed {self._allowed_time_s:g} s"
        return PlanningFailure(MoveItErrorCode.TIMED_OUT, text, {"allowed_time_s": self._allowed_time_s})


def preempted(spent_s: float) -> PlanningFailure:
    """Return the answer to a request that was cancelled after so much time [s]."""
    return PlanningFailure(MoveItErrorCode.PREEMPTED, f"planning was stopped after {spent_s:.2f} s")


def never() -> bool:
    """Tell that a request is never cancelled."""
    return False

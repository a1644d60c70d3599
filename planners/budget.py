"""The time a problem may take, and the permission to go on."""

from __future__ import annotations

from collections.abc import Callable

from planners.problem import MoveItErrorCode, PlanningFailure


class Budget:
    """Time left for one problem.

    Args:
        clock: monotonic time [s]; read on construction and at each question.
        allowed_time_s: how long the problem may take [s].
        should_stop: whether whoever asked has lost interest.
    """

    def __init__(self, clock: Callable[[], float], allowed_time_s: float, should_stop: Callable[[], bool]) -> None:
        self._clock = clock
        self._start_s = clock()
        self._allowed_time_s = allowed_time_s
        self._should_stop = should_stop

    @property
    def spent_s(self) -> float:
        """Time since the start [s]."""
        return self._clock() - self._start_s

    @property
    def stopped(self) -> bool:
        """Whether whoever asked has lost interest."""
        return self._should_stop()

    def used_up(self) -> bool:
        """Whether to stop now."""
        return self.stopped or self.spent_s >= self._allowed_time_s

    def failure(self) -> PlanningFailure:
        """Say why planning stopped; to be called once the budget is used up."""
        if self.stopped:
            return PlanningFailure(MoveItErrorCode.PREEMPTED, f"planning was stopped after {self.spent_s:.2f} s")
        return PlanningFailure(
            MoveItErrorCode.TIMED_OUT,
            f"no motion was found within the allowed {self._allowed_time_s:g} s",
            {"allowed_time_s": self._allowed_time_s},
        )

"""How goals have ended, counted for whoever watches the server over days."""

from __future__ import annotations

from collections import Counter

from server.execution.queue import Answer
from server.operations.distribution import Distribution

# A goal of a screenful of constraints takes seconds; most take milliseconds [s].
PLANNING_TIME_BOUNDS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
MOTION_TIME_BOUNDS_S = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)


class GoalTally:
    """Counts answers.

    Attributes:
        answered: goals by source and name of their code; sources are the server's own topics and actions.
        planning_s: time spent on planning, of goals that came to it.
        motion_s: time for which the arm moved, of goals for which it did.
    """

    def __init__(self) -> None:
        self.answered: Counter[tuple[str, str]] = Counter()
        self.planning_s = Distribution(PLANNING_TIME_BOUNDS_S)
        self.motion_s = Distribution(MOTION_TIME_BOUNDS_S)

    def take(self, source: str, answer: Answer) -> None:
        """Count one answer.

        Args:
            source: the topic or action that its goal came by.
            answer: the answer.
        """
        self.answered[source, answer.code.name] += 1
        performed = answer.performed
        if performed is None:
            return
        if performed.planning_time_s > 0.0:
            self.planning_s.take(performed.planning_time_s)
        if performed.executed is not None:
            self.motion_s.take(performed.executed.duration_s)

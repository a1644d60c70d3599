"""Counters of answered goals, and histograms of their planning and motion times."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client import Counter, Histogram
from prometheus_client.core import Metric
from prometheus_client.registry import Collector

from server.execution.goal import Answer

# Upper bounds of buckets [s]. A goal with many constraints takes seconds to plan; most take milliseconds.
PLANNING_TIME_BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
MOTION_TIME_BUCKETS_S = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)


class GoalCounters(Collector):
    """Counters of answered goals."""

    def __init__(self) -> None:
        self._answered = Counter(
            "armbridge_goals",
            "Goals answered, by the topic or action they came by and the name of MoveIt's code.",
            ("source", "result"),
            registry=None,
        )
        self._planning_s = Histogram(
            "armbridge_goal_planning_seconds",
            "Time spent on planning, a goal.",
            buckets=PLANNING_TIME_BUCKETS_S,
            registry=None,
        )
        self._motion_s = Histogram(
            "armbridge_goal_motion_seconds",
            "Time for which the arm moved, a goal.",
            buckets=MOTION_TIME_BUCKETS_S,
            registry=None,
        )

    def count(self, source: str, answer: Answer) -> None:
        """Count an answered goal."""
        self._answered.labels(source, answer.code.name).inc()
        performed = answer.performed
        if performed is None:
            return
        if performed.planning_time_s > 0.0:
            self._planning_s.observe(performed.planning_time_s)
        if performed.executed is not None:
            self._motion_s.observe(performed.executed.duration_s)

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics of goals."""
        for each in (self._answered, self._planning_s, self._motion_s):
            yield from each.collect()

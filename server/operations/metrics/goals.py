"""Goals, planners and the recording."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from server.operations.goal_tally import GoalTally
from server.operations.metrics.distributions import histogram
from server.operations.parts import PlannersPart, QueuePart, RecorderPart


def goal_metrics(tally: GoalTally) -> Iterator[Metric]:
    """How goals ended."""
    answered = CounterMetricFamily(
        "armbridge_goals",
        "Goals answered, by the topic or action they came by and the name of MoveIt's code.",
        labels=("source", "result"),
    )
    for labels, count in tally.answered.items():
        answered.add_metric(labels, count)
    yield answered
    yield histogram("armbridge_goal_planning_seconds", "Time spent on planning, a goal.", tally.planning_s)
    yield histogram("armbridge_goal_motion_seconds", "Time for which the arm moved, a goal.", tally.motion_s)


def queue_metrics(queue: QueuePart) -> Iterator[Metric]:
    """Goals on their way."""
    yield GaugeMetricFamily("armbridge_goals_waiting", "Goals that wait for their turn.", queue.waiting_count)
    yield GaugeMetricFamily("armbridge_goals_in_hand", "Goals that are worked on, 0 or 1.", int(bool(queue.busy)))


def planner_metrics(planners: PlannersPart) -> Iterator[Metric]:
    """The planners."""
    for state, count in (("loaded", planners.loaded_count), ("idle", planners.idle_count)):
        yield GaugeMetricFamily(f"armbridge_planners_{state}", f"Planner processes that are {state}.", count)
    yield GaugeMetricFamily(
        "armbridge_planners_waiting_requests", "Requests that wait for a planner.", planners.waiting_count
    )


def recording_metrics(recorder: RecorderPart) -> Iterator[Metric]:
    """The recording."""
    yield GaugeMetricFamily("armbridge_recording", "Whether messages are recorded.", int(not recorder.ended))
    yield GaugeMetricFamily("armbridge_recording_waiting_messages", "Messages that wait for the file.", recorder.queued)
    yield CounterMetricFamily(
        "armbridge_recording_dropped_messages", "Messages missing in the recording.", recorder.dropped
    )

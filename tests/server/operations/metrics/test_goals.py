from __future__ import annotations

from planners.problem import MoveItErrorCode
from server.goal_queue import Answer, Performed
from server.operations.goal_tally import GoalTally
from server.operations.metrics.goals import goal_metrics, planner_metrics, queue_metrics, recording_metrics
from tests.helpers.metric_samples import samples
from tests.helpers.watched_parts import WatchedPlanners, WatchedQueue, WatchedRecorder


def test_goals_are_told_by_source_and_result() -> None:
    tally = GoalTally()
    tally.take("/a", Answer(MoveItErrorCode.PLANNING_FAILED, "", performed=Performed({}, planning_time_s=0.3)))
    found = samples(goal_metrics(tally))
    assert found["armbridge_goals_total", "/a", "PLANNING_FAILED"] == 1
    assert found["armbridge_goal_planning_seconds_bucket", "0.25"] == 0
    assert found["armbridge_goal_planning_seconds_bucket", "0.5"] == 1
    assert found["armbridge_goal_motion_seconds_count",] == 0


def test_what_waits_is_told() -> None:
    found = samples(queue_metrics(WatchedQueue(2, "goal 7 is worked on")))
    assert found == {("armbridge_goals_waiting",): 2, ("armbridge_goals_in_hand",): 1}
    assert samples(queue_metrics(WatchedQueue(0, "")))["armbridge_goals_in_hand",] == 0


def test_planners_are_counted_by_what_they_do() -> None:
    found = samples(planner_metrics(WatchedPlanners(loaded_count=2, idle_count=1, waiting_count=3)))
    assert found == {
        ("armbridge_planners_loaded",): 2,
        ("armbridge_planners_idle",): 1,
        ("armbridge_planners_waiting_requests",): 3,
    }


def test_a_recording_tells_what_is_missing_in_it() -> None:
    found = samples(recording_metrics(WatchedRecorder(dropped=4, queued=5, ended=True)))
    assert found == {
        ("armbridge_recording",): 0,
        ("armbridge_recording_waiting_messages",): 5,
        ("armbridge_recording_dropped_messages_total",): 4,
    }

from __future__ import annotations

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from robot.trajectory import Trajectory
from server.execution.queue import Answer, Performed
from server.operations.goal_tally import GoalTally

MOTION = Trajectory(("gripper",), np.array([0.0, 3.0]), np.zeros((2, 1)), np.zeros((2, 1)), np.zeros((2, 1)))


def answered(code: MoveItErrorCode, performed: Performed | None = None) -> Answer:
    return Answer(code, "", performed=performed)


def test_answers_are_counted_by_where_their_goals_came_from_and_how_they_ended() -> None:
    tally = GoalTally()
    for source, code in (("/a", 1), ("/a", 1), ("/a", -1), ("/b", 1)):
        tally.take(source, answered(MoveItErrorCode(code)))
    assert tally.answered == {("/a", "SUCCESS"): 2, ("/a", "PLANNING_FAILED"): 1, ("/b", "SUCCESS"): 1}


def test_only_what_was_planned_and_moved_is_timed() -> None:
    tally = GoalTally()
    tally.take("/a", answered(MoveItErrorCode.FAILURE))
    tally.take("/a", answered(MoveItErrorCode.SUCCESS, Performed({}, executed=MOTION)))
    tally.take("/a", answered(MoveItErrorCode.SUCCESS, Performed({}, planning_time_s=0.02)))
    assert (sum(tally.planning_s.counts), tally.planning_s.total) == (1, pytest.approx(0.02))
    assert (sum(tally.motion_s.counts), tally.motion_s.total) == (1, pytest.approx(3.0))

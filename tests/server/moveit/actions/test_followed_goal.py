from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from protocol.registry import Registry
from robot import model
from robot.messages import ArmState, Outcome
from server.action_goals import Goal, GoalStatus, Result
from server.goal_queue import Answer, GoalState, Performed, Progress
from server.interfaces import Interfaces
from server.moveit.actions.joint_trajectory_controller import FollowCode, FollowedGoal, FollowedTolerances, code_of
from server.node import Node
from tests.helpers.played_arm import JOINTS, PlayedArm
from tests.helpers.trajectories import smooth_move

ARM = model.builtin().groups["arm"].joints
END = Performed({}, (smooth_move(dict.fromkeys(ARM, (0.0, 0.5)), 1.0),))
REACHED = Answer(MoveItErrorCode.SUCCESS, "the arm is there", performed=END)
MOVING = Progress(GoalState.EXECUTING, "", 0.5, 1.0)
INTERFACES = Interfaces(Registry.load())


def at(position_rad: float, goal_rad: float, clock_s: float = 1.0, stamp_s: float = 1.0) -> ArmState:
    position, goal = np.full(len(JOINTS), position_rad), np.full(len(JOINTS), goal_rad)
    return replace(PlayedArm().state, stamp_s=stamp_s, clock_s=clock_s, position_rad=position, goal_rad=goal)


class Followed:
    def __init__(self, path_rad: float = 0.0, goal_rad: float = 0.0, time_s: float = 0.0) -> None:
        self.results: list[Result] = []
        self.cancelled: list[str] = []
        goal = Goal("/follow", "control_msgs/action/FollowJointTrajectory", {}, INTERFACES, None, Node("client"))
        goal.when_ended(self.results.append)
        path = {"elbow_flex": path_rad} if path_rad else {}
        end = {"elbow_flex": goal_rad} if goal_rad else {}
        self.goal = FollowedGoal(goal, ARM, FollowedTolerances(path, end, time_s))

    def state(self, state: ArmState) -> None:
        self.goal.take_state(state, self.cancelled.append)

    @property
    def codes(self) -> list[tuple[int, int]]:
        return [(result.status, result.values["error_code"]) for result in self.results]


def test_a_joint_that_leaves_the_path_tolerance_ends_the_motion_once() -> None:
    followed = Followed(path_rad=0.05)
    followed.state(at(0.0, 0.3))
    followed.goal.take_progress(MOVING)
    for lag_rad in (0.04, 0.06, 0.07):
        followed.state(at(0.3 - lag_rad, 0.3))
    assert len(followed.cancelled) == 1
    followed.goal.take_answer(Answer(MoveItErrorCode.PREEMPTED, "stopped"), at(0.2, 0.3))
    assert followed.codes == [(GoalStatus.ABORTED, FollowCode.PATH_TOLERANCE_VIOLATED)]
    assert "elbow_flex is 0.060 rad" in followed.results[0].values["error_string"]


def test_a_goal_within_its_tolerance_succeeds_at_once() -> None:
    followed = Followed(goal_rad=0.02)
    followed.goal.take_answer(REACHED, at(0.49, 0.5))
    assert followed.codes == [(GoalStatus.SUCCEEDED, FollowCode.SUCCESSFUL)]


def test_a_joint_may_come_near_enough_within_the_goal_time_tolerance() -> None:
    followed = Followed(goal_rad=0.02, time_s=1.0)
    followed.goal.take_answer(REACHED, at(0.45, 0.5, 10.0))
    followed.state(at(0.45, 0.5, 10.5))
    assert followed.codes == []
    followed.state(at(0.49, 0.5, 10.9))
    assert followed.codes == [(GoalStatus.SUCCEEDED, FollowCode.SUCCESSFUL)]


def test_a_joint_that_stays_away_violates_the_goal_tolerance() -> None:
    followed = Followed(goal_rad=0.02, time_s=1.0)
    followed.goal.take_answer(REACHED, at(0.45, 0.5, 10.0))
    followed.state(at(0.45, 0.5, 11.0))
    assert followed.codes == [(GoalStatus.ABORTED, FollowCode.GOAL_TOLERANCE_VIOLATED)]


def test_a_slow_arm_has_all_of_the_goal_time_tolerance_by_its_own_clock() -> None:
    followed = Followed(goal_rad=0.02, time_s=1.0)
    followed.goal.take_answer(REACHED, at(0.45, 0.5, clock_s=10.0, stamp_s=100.0))
    followed.state(at(0.45, 0.5, clock_s=10.9, stamp_s=109.0))
    assert followed.codes == []
    followed.state(at(0.49, 0.5, clock_s=10.95, stamp_s=109.5))
    assert followed.codes == [(GoalStatus.SUCCEEDED, FollowCode.SUCCESSFUL)]


def test_feedback_tells_of_every_joint_while_the_arm_moves() -> None:
    followed = Followed()
    assert followed.goal.feedback(at(0.2, 0.3)) is None
    followed.goal.take_progress(MOVING)
    feedback: Any = followed.goal.feedback(at(0.2, 0.3))
    assert feedback["joint_names"] == list(ARM)
    assert feedback["error"]["positions"] == pytest.approx([0.1] * len(ARM))


ENDS = {
    "reached": (REACHED, FollowCode.SUCCESSFUL),
    "lost": (
        Answer(MoveItErrorCode.CONTROL_FAILED, "", {"outcome": Outcome.TRACKING_LOST.value}),
        FollowCode.PATH_TOLERANCE_VIOLATED,
    ),
    "not settled": (
        Answer(MoveItErrorCode.CONTROL_FAILED, "", {"outcome": Outcome.NOT_SETTLED.value}),
        FollowCode.GOAL_TOLERANCE_VIOLATED,
    ),
    "preempted": (Answer(MoveItErrorCode.PREEMPTED, ""), FollowCode.INVALID_GOAL),
}


@pytest.mark.parametrize(("answer", "code"), ENDS.values(), ids=ENDS.keys())
def test_every_end_has_a_code_of_the_controllers(answer: Answer, code: FollowCode) -> None:
    assert code_of(answer) is code

"""Goals that work in place of those that do not: of the same kind, near them, and verified by a plan."""

import itertools

import numpy as np
import pytest

from planners.goals import AxisGoal, JointGoal, PoseGoal, PositionGoal
from planners.problem import MoveItErrorCode, NearestGoalAnswer, NearestGoalQuestion, Plan, PlanningFailure
from planners.scene import EMPTY_SCENE, Box, Pose, Scene, SceneObject
from tests.planners.setting import Setting

TIP = "gripper_frame_link"
VERSIONS = itertools.count(7_000_001)

# Beside the arm: half a turn of the pan brings it in there.
WALL = (SceneObject("wall", ((Box((0.6, 0.1, 0.6)), Pose()),), Pose((0.3, 0.25, 0.3))),)


@pytest.fixture
def setting(planner, robot, collision):
    planner.set_scene(EMPTY_SCENE)
    return Setting(planner, robot, collision)


@pytest.fixture
def beside_a_wall(setting):
    assert setting.planner.set_scene(Scene(next(VERSIONS), WALL)) is None
    yield setting
    setting.planner.set_scene(EMPTY_SCENE)


def nearest(setting, problem, allowed_time_s=5.0):
    """Return the nearest goal for a problem that has no plan, and how it failed."""
    failure = setting.planner.answer(problem)
    assert isinstance(failure, PlanningFailure), failure
    answer = setting.planner.answer(NearestGoalQuestion(problem, allowed_time_s))
    assert isinstance(answer, NearestGoalAnswer)
    return answer.goal, failure


def test_a_joint_goal_in_contact_becomes_one_that_can_be_planned(beside_a_wall):
    asked = JointGoal({"shoulder_pan": -1.2})
    goal, failure = nearest(beside_a_wall, beside_a_wall.problem(asked))
    assert failure.code is MoveItErrorCode.GOAL_IN_COLLISION
    assert isinstance(goal, JointGoal)
    # Joints that were not asked for stay.
    assert set(goal.positions_rad) == {"shoulder_pan"}
    assert isinstance(beside_a_wall.planner.answer(beside_a_wall.problem(goal)), Plan)


def test_the_way_back_to_the_start_is_not_gone_where_another_way_out_of_the_contact_is_shorter(beside_a_wall):
    start = {"shoulder_pan": 0.8, "shoulder_lift": -1.2, "elbow_flex": 1.2, "wrist_flex": 0.9, "wrist_roll": 1.5}
    asked = dict.fromkeys(beside_a_wall.joints, 0.0) | {"shoulder_pan": -0.8}
    start_rad = beside_a_wall.home(**start)
    goal, _ = nearest(beside_a_wall, beside_a_wall.problem(JointGoal(asked), start_rad))
    travel = dict(zip(beside_a_wall.collision.joint_names, beside_a_wall.collision.travel_m_per_rad, strict=True))

    def travel_m(positions_rad):
        return sum(travel[name] * abs(at - asked[name]) for name, at in positions_rad.items())

    way_back = (
        {name: at + share * (start[name] - at) for name, at in asked.items()} for share in np.arange(0, 1, 0.02)
    )
    free = next(
        positions_rad
        for positions_rad in way_back
        if isinstance(beside_a_wall.planner.answer(beside_a_wall.problem(JointGoal(positions_rad), start_rad)), Plan)
    )
    assert travel_m(goal.positions_rad) < 0.8 * travel_m(free)


@pytest.mark.parametrize(
    "asked",
    [
        PositionGoal(TIP, (0.25, 0.25, 0.2), 0.01),
        PoseGoal(TIP, Pose((0.25, 0.25, 0.2)), 0.01, (0.1, 0.1, 0.1)),
    ],
)
def test_a_goal_of_the_tip_in_contact_becomes_one_at_another_place(beside_a_wall, asked):
    goal, failure = nearest(beside_a_wall, beside_a_wall.problem(asked))
    assert failure.code is MoveItErrorCode.GOAL_IN_COLLISION
    assert type(goal) is type(asked)
    assert isinstance(beside_a_wall.planner.answer(beside_a_wall.problem(goal)), Plan)


def test_a_place_out_of_reach_becomes_the_nearest_that_a_motion_reaches(setting):
    asked = PositionGoal(TIP, (0.6, 0.0, 0.2), 0.01)
    goal, failure = nearest(setting, setting.problem(asked))
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    away_m = np.linalg.norm(np.array(goal.position_m) - asked.position_m)
    assert away_m == pytest.approx(failure.details["distance_m"], abs=0.02)
    assert isinstance(setting.planner.answer(setting.problem(goal)), Plan)


def test_same_question_same_answer(beside_a_wall):
    question = NearestGoalQuestion(beside_a_wall.problem(JointGoal({"shoulder_pan": -1.2})), 5.0)
    first, second = (beside_a_wall.planner.answer(question) for _ in range(2))
    assert first == second


def test_without_time_or_for_a_goal_of_another_kind_there_is_none(beside_a_wall):
    assert nearest(beside_a_wall, beside_a_wall.problem(JointGoal({"shoulder_pan": -1.2})), 1e-9)[0] is None
    axis = AxisGoal(TIP, (0.25, 0.25, 0.2), 0.01, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.05)
    assert nearest(beside_a_wall, beside_a_wall.problem(axis))[0] is None


def test_a_question_that_is_cancelled_ends(beside_a_wall):
    problem = beside_a_wall.problem(JointGoal({"shoulder_pan": -1.2}))
    assert beside_a_wall.planner.answer(NearestGoalQuestion(problem, 5.0), lambda: True) == NearestGoalAnswer(None)

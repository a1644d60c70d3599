"""Goals that work in place of those that do not: of the same kind, near them, and verified by a plan."""

from dataclasses import replace

import numpy as np
import pytest

from planners.goals import AxisGoal, Constraints, JointConstraint, JointGoal, PoseGoal, PositionGoal
from planners.problem import MoveItErrorCode, NearestGoalAnswer, NearestGoalQuestion, Plan, PlanningFailure
from planners.scene import Box, Pose, SceneObject
from tests.planners.scenes import thing

TIP = "gripper_frame_link"
NAN = float("nan")
IN_CONTACT, TIMED_OUT = MoveItErrorCode.GOAL_IN_COLLISION, MoveItErrorCode.TIMED_OUT


@pytest.fixture
def beside_a_wall(setting, put):
    """Put a wall beside the arm: half a turn of the pan brings the arm into it."""
    put(setting.planner, thing(Box((0.6, 0.1, 0.6)), 0.3, 0.25, 0.3))
    return setting


@pytest.fixture
def beside_a_plate(setting, put):
    """Beside a plate from the base outwards, behind which the arm may stand, but cannot come."""
    half_rad = 0.5 * np.radians(30.0)
    x, y = (0.38 * np.array([np.cos(2.0 * half_rad), np.sin(2.0 * half_rad)])).tolist()
    pose = Pose((x, y, 0.5), (0.0, 0.0, float(np.sin(half_rad)), float(np.cos(half_rad))))
    put(setting.planner, SceneObject("plate", ((Box((0.6, 0.01, 1.0)), Pose()),), pose))
    return setting


def nearest(setting, problem, code=None, allowed_time_s=5.0):
    """Return the nearest goal for a problem that cannot be planned, and why it cannot."""
    failure = setting.planner.answer(problem)
    assert isinstance(failure, PlanningFailure), failure
    assert code in (None, failure.code)
    answer = setting.planner.answer(NearestGoalQuestion(problem, allowed_time_s, failure.code))
    assert isinstance(answer, NearestGoalAnswer)
    return answer.goal, failure


def assert_planned(setting, problem, goal):
    assert isinstance(setting.planner.answer(replace(problem, goal=goal)), Plan), goal


def test_the_way_back_to_the_start_is_not_gone_where_another_way_out_of_the_contact_is_shorter(beside_a_wall):
    setting = beside_a_wall
    start = {"shoulder_pan": 0.8, "shoulder_lift": -1.2, "elbow_flex": 1.2, "wrist_flex": 0.9, "wrist_roll": 1.5}
    asked = dict.fromkeys(setting.joints, 0.0) | {"shoulder_pan": -0.8}
    problem = setting.problem(JointGoal(asked), setting.home(**start))
    goal, _ = nearest(setting, problem)
    travel = dict(zip(setting.collision.joint_names, setting.collision.travel_m_per_rad, strict=True))

    def travel_m(goal):
        return sum(travel[name] * abs(at - asked[name]) for name, at in goal.positions_rad.items())

    way_back = (
        JointGoal({name: at + share * (start[name] - at) for name, at in asked.items()})
        for share in np.arange(0, 1, 0.02)
    )
    free = next(each for each in way_back if isinstance(setting.planner.answer(replace(problem, goal=each)), Plan))
    assert travel_m(goal) < 0.8 * travel_m(free)


@pytest.mark.parametrize(
    "asked",
    [
        JointGoal({"shoulder_pan": -1.2}),
        PositionGoal(TIP, (0.25, 0.25, 0.2), 0.01),
        PoseGoal(TIP, Pose((0.25, 0.25, 0.2)), 0.01, (0.1, 0.1, 0.1)),
    ],
)
def test_a_goal_in_contact_becomes_one_of_its_kind_that_can_be_planned(beside_a_wall, asked):
    problem = beside_a_wall.problem(asked)
    goal, _ = nearest(beside_a_wall, problem, IN_CONTACT)
    assert type(goal) is type(asked)
    assert_planned(beside_a_wall, problem, goal)


BEHIND_THE_PLATE = {"shoulder_pan": -1.85}


@pytest.mark.parametrize(
    ("changed", "whole", "code"),
    [
        (BEHIND_THE_PLATE, False, TIMED_OUT),
        (BEHIND_THE_PLATE, True, TIMED_OUT),
        # Everything around this contact is behind the plate.
        ({"shoulder_pan": -1.4}, False, IN_CONTACT),
    ],
)
def test_a_joint_goal_to_which_no_motion_leads_becomes_the_nearest_reached(beside_a_plate, changed, whole, code):
    asked = JointGoal((dict.fromkeys(beside_a_plate.joints, 0.0) if whole else {}) | changed)
    problem = beside_a_plate.problem(asked, beside_a_plate.home(shoulder_pan=0.8), allowed_time_s=0.2)
    goal, _ = nearest(beside_a_plate, problem, code)
    assert goal.positions_rad.keys() == asked.positions_rad.keys()
    assert_planned(beside_a_plate, problem, goal)
    # It is most of the way to the plate.
    assert goal.positions_rad["shoulder_pan"] < 0.3


def test_a_goal_of_the_tip_to_which_no_motion_leads_becomes_one_nearer_than_the_start(beside_a_plate):
    start_rad = beside_a_plate.home(shoulder_pan=0.8)
    asked_m = beside_a_plate.tip_m(beside_a_plate.home(**BEHIND_THE_PLATE))
    problem = beside_a_plate.problem(PoseGoal(TIP, Pose(asked_m), 0.01, (0.1, 0.1, 0.1)), start_rad, allowed_time_s=0.2)
    goal, _ = nearest(beside_a_plate, problem, TIMED_OUT)
    assert isinstance(goal, PoseGoal)
    assert_planned(beside_a_plate, problem, goal)
    away_m = np.linalg.norm(np.array(goal.pose.position_m) - asked_m)
    assert away_m < 0.8 * np.linalg.norm(np.array(beside_a_plate.tip_m(start_rad)) - asked_m)


@pytest.mark.parametrize("tolerance_rad", [0.2, 0.002])
def test_a_joint_goal_that_violates_the_constraints_becomes_the_nearest_that_keeps_them(setting, tolerance_rad):
    asked = JointGoal(dict.fromkeys(setting.joints, 0.0) | {"shoulder_pan": 0.8, "wrist_flex": 0.9})
    level = Constraints(joints=(JointConstraint("wrist_flex", 0.0, tolerance_rad, tolerance_rad),))
    problem = setting.problem(asked, path_constraints=level)
    goal, _ = nearest(setting, problem, MoveItErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS)
    plan = setting.solve(replace(problem, goal=goal))
    wrist = plan.trajectory.positions_rad[:, setting.joints.index("wrist_flex")]
    assert np.all(np.abs(wrist) <= tolerance_rad + 1e-6)
    # The other joints are about where they are asked for.
    assert sum(abs(at - asked.positions_rad[name]) for name, at in goal.positions_rad.items()) < 0.9 + 0.5


def test_a_place_out_of_reach_or_beyond_the_limits_becomes_the_nearest_that_a_motion_reaches(setting):
    asked = PositionGoal(TIP, (0.6, 0.0, 0.2), 0.01)
    goal, failure = nearest(setting, setting.problem(asked), MoveItErrorCode.NO_IK_SOLUTION)
    away_m = np.linalg.norm(np.array(goal.position_m) - asked.position_m)
    assert away_m == pytest.approx(failure.details["distance_m"], abs=0.02)
    assert_planned(setting, setting.problem(asked), goal)
    upper_rad = setting.robot.joints["shoulder_pan"].upper
    problem = setting.problem(JointGoal({"shoulder_pan": upper_rad + 0.4, "elbow_flex": 0.3}))
    goal, _ = nearest(setting, problem, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS)
    assert goal.positions_rad == {"shoulder_pan": upper_rad, "elbow_flex": 0.3}
    assert_planned(setting, problem, goal)


def test_for_a_goal_that_cannot_be_read_or_of_another_kind_or_without_time_there_is_none(beside_a_wall):
    setting, in_contact = beside_a_wall, JointGoal({"shoulder_pan": -1.2})
    for asked in (
        JointGoal({"shoulder_pan": NAN}),
        JointGoal({"shoulder_pan": 9.0, "elbow_flex": NAN}),
        JointGoal({"shoulder_pan": 9.0, "tail": 0.0}),
        PositionGoal("tail", (0.3, 0.0, 0.2), 0.01),
        PositionGoal(TIP, (NAN, 0.0, 0.2), 0.01),
        AxisGoal(TIP, (0.25, 0.25, 0.2), 0.01, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.05),
    ):
        assert nearest(setting, setting.problem(asked))[0] is None, asked
    problem = setting.problem(in_contact)
    assert nearest(setting, problem, allowed_time_s=1e-9)[0] is None
    for code in (IN_CONTACT, TIMED_OUT):
        answer = setting.planner.answer(NearestGoalQuestion(problem, 5.0, code), lambda: True)
        assert answer == NearestGoalAnswer(None) or answer.code is MoveItErrorCode.PREEMPTED
    # A goal is not offered where planning it would take longer than the problem allows.
    short = setting.problem(JointGoal({"shoulder_pan": 0.5}), allowed_time_s=1e-9)
    assert nearest(setting, short, TIMED_OUT)[0] is None

import dataclasses
import math

import numpy as np
import pytest

from planners.checks import (
    START_CONTACT_DEPTH_M,
    START_LIMIT_TOLERANCE_RAD,
    check_goal_contact,
    check_request,
    check_start,
    check_start_contact,
    out_of_reach,
)
from planners.collision import CollidingPair
from planners.goals import JointGoal, PositionGoal
from planners.kinematics import IkResult
from planners.problem import MoveItErrorCode, PlanningProblem

TIP = "gripper_frame_link"
POINT = PositionGoal(TIP, (0.3, 0.0, 0.2), 0.01)
NAN = math.nan


@pytest.fixture
def at_home(robot):
    return {joint.name: 0.0 for joint in robot.movable_joints}


@pytest.fixture
def problem(at_home):
    return PlanningProblem("arm", at_home, JointGoal({"elbow_flex": 0.5}))


def refusal(robot, problem, **changes):
    return check_request(robot, dataclasses.replace(problem, **changes))


def test_sound_requests_pass(robot, problem):
    assert refusal(robot, problem) is None
    assert refusal(robot, problem, goal=POINT) is None


@pytest.mark.parametrize(
    ("changes", "code", "said"),
    [
        ({"group": "leg"}, MoveItErrorCode.INVALID_GROUP_NAME, ["leg", "arm", "gripper"]),
        ({"velocity_scaling": 0.0}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["velocity scaling", "0"]),
        ({"velocity_scaling": 1.5}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["velocity scaling", "1.5"]),
        ({"acceleration_scaling": NAN}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["acceleration scaling", "nan"]),
        ({"allowed_time_s": -1.0}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["allowed planning time", "-1"]),
        ({"allowed_time_s": math.inf}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["allowed planning time", "inf"]),
        ({"goal": JointGoal({"elbow": 0.5})}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["'elbow'", "elbow_flex"]),
        ({"goal": JointGoal({"gripper": 0.5})}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["'gripper'", "'arm'"]),
        ({"goal": JointGoal({"elbow_flex": NAN})}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["elbow_flex", "nan"]),
        (
            {"goal": JointGoal({"elbow_flex": 1.7})},
            MoveItErrorCode.INVALID_GOAL_CONSTRAINTS,
            ["elbow_flex", "1.7 rad", "-1.69 to 1.69 rad"],
        ),
        ({"goal": PositionGoal("hand", (0, 0, 0), 0.1)}, MoveItErrorCode.INVALID_LINK_NAME, ["'hand'", TIP]),
        ({"goal": PositionGoal(TIP, (0, NAN, 0), 0.1)}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["(0, nan, 0)"]),
        ({"goal": PositionGoal(TIP, (0.3, 0, 0), 0.0)}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["tolerance", "0"]),
        ({"goal": PositionGoal(TIP, (0.3, 0, 0), NAN)}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, ["tolerance", "nan"]),
    ],
)
def test_senseless_requests_are_refused_with_names_and_values(robot, problem, changes, code, said):
    failure = refusal(robot, problem, **changes)
    assert failure.code is code
    assert all(part in failure.message for part in said), failure.message


def test_refusal_of_a_joint_goal_carries_joint_value_and_limits_as_data(robot, problem):
    failure = refusal(robot, problem, goal=JointGoal({"elbow_flex": -2.0}))
    joint = robot.joints["elbow_flex"]
    assert failure.details == {
        "joint": "elbow_flex",
        "position_rad": -2.0,
        "lower_rad": joint.lower,
        "upper_rad": joint.upper,
    }


def test_joint_goal_may_exceed_a_limit_by_rounding_only(robot, problem):
    upper = robot.joints["elbow_flex"].upper
    assert refusal(robot, problem, goal=JointGoal({"elbow_flex": upper + 0.009}, tolerance_rad=0.01)) is None
    assert refusal(robot, problem, goal=JointGoal({"elbow_flex": upper + 0.011}, tolerance_rad=0.01))


def test_start_a_little_beyond_a_limit_is_accepted_and_further_is_not(robot, at_home):
    lower = robot.joints["wrist_flex"].lower
    assert check_start(robot, at_home | {"wrist_flex": lower - 0.9 * START_LIMIT_TOLERANCE_RAD}) is None
    failure = check_start(robot, at_home | {"wrist_flex": lower - 1.1 * START_LIMIT_TOLERANCE_RAD})
    assert failure.code is MoveItErrorCode.START_STATE_INVALID
    assert "'wrist_flex'" in failure.message
    assert failure.details["lower_rad"] == lower


@pytest.mark.parametrize("value", [NAN, math.inf, None])
def test_start_without_a_finite_position_for_every_joint_is_refused(robot, at_home, value):
    start_rad = {name: position for name, position in (at_home | {"gripper": value}).items() if position is not None}
    failure = check_start(robot, start_rad)
    assert failure.code is MoveItErrorCode.START_STATE_INVALID
    assert "'gripper'" in failure.message
    assert "limits" not in failure.message


def test_shallow_contact_at_the_start_is_let_go_and_a_deep_one_is_not():
    shallow = CollidingPair("base_link", "wrist_link", 0.9 * START_CONTACT_DEPTH_M)
    deep = CollidingPair("shoulder_link", "wrist_link", 1.1 * START_CONTACT_DEPTH_M)
    assert check_start_contact([]) is None
    assert check_start_contact([shallow]) is None
    failure = check_start_contact([shallow, deep])
    assert failure.code is MoveItErrorCode.START_STATE_IN_COLLISION
    assert "shoulder_link and wrist_link by 11.0 mm" in failure.message
    assert len(failure.details["pairs"]) == 2


def test_goal_that_touches_is_refused_however_shallow(collision):
    folded = np.array([0.0, -1.7, 1.65, 1.0, 0.0, 0.0])
    failure = check_goal_contact(collision, folded)
    assert failure.code is MoveItErrorCode.GOAL_IN_COLLISION
    assert "shoulder_link and lower_arm_link" in failure.message
    assert failure.details["pairs"][0]["depth_m"] > 0.0


def test_goal_in_the_open_passes(collision):
    assert check_goal_contact(collision, np.zeros(6)) is None


def test_point_out_of_reach_is_answered_with_the_nearest_one_and_its_distance():
    found = IkResult((), (), np.zeros(6), np.array([0.25, 0.0, 0.2]), 0.05)
    failure = out_of_reach(POINT, found)
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert "(0.3, 0, 0.2) m" in failure.message
    assert "(0.25, 0, 0.2) m" in failure.message
    assert "5.0 cm" in failure.message
    assert failure.details["nearest_m"] == [0.25, 0.0, 0.2]
    assert failure.details["distance_m"] == 0.05

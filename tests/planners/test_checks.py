import dataclasses
import math

import pytest

from planners.checks import (
    START_CONTACT_DEPTH_M,
    START_LIMIT_TOLERANCE_RAD,
    check_ik_question,
    check_request,
    check_start,
    check_start_contact,
    check_state_question,
)
from planners.geometry.collision import CollidingPair
from planners.goals import Constraints, JointConstraint, JointGoal, PositionGoal
from planners.problem import IkQuestion, MoveItErrorCode, PlanningProblem, StateQuestion
from tests.planners.refusals import refusal

TIP = "gripper_frame_link"
POINT = PositionGoal(TIP, (0.3, 0.0, 0.2), 0.01)
NAN = math.nan
NO_RANGE = Constraints(joints=(JointConstraint("elbow", 0.5, 0.1, 0.1),))
INVALID = MoveItErrorCode.INVALID_GOAL_CONSTRAINTS


@pytest.fixture
def problem(at_home):
    return PlanningProblem("arm", at_home, JointGoal({"elbow_flex": 0.5}))


def refused(robot, problem, **changes):
    return refusal(check_request, robot, dataclasses.replace(problem, **changes))


def test_sound_requests_pass(robot, problem):
    assert refused(robot, problem) is None
    assert refused(robot, problem, goal=POINT) is None


@pytest.mark.parametrize(
    ("changes", "code", "said"),
    [
        ({"group": "leg"}, MoveItErrorCode.INVALID_GROUP_NAME, ["leg", "arm", "gripper"]),
        ({"velocity_scaling": 0.0}, INVALID, ["velocity scaling", "0"]),
        ({"velocity_scaling": 1.5}, INVALID, ["velocity scaling", "1.5"]),
        ({"acceleration_scaling": NAN}, INVALID, ["acceleration scaling", "nan"]),
        ({"allowed_time_s": -1.0}, INVALID, ["allowed planning time", "-1"]),
        ({"allowed_time_s": math.inf}, INVALID, ["allowed planning time", "inf"]),
        ({"optimization_time_s": -1.0}, INVALID, ["optimization time", "-1"]),
        ({"optimization_time_s": NAN}, INVALID, ["optimization time", "nan"]),
        ({"attempts": 0}, INVALID, ["attempts", "0"]),
        ({"planner_id": "AORRTC"}, INVALID, ["'AORRTC'", "RRTConnect"]),
        ({"start_velocity_rad_s": {"elbow": 0.1}}, MoveItErrorCode.START_STATE_INVALID, ["'elbow'", "'arm'"]),
        ({"start_velocity_rad_s": {"elbow_flex": NAN}}, MoveItErrorCode.START_STATE_INVALID, ["elbow_flex", "nan"]),
        ({"start_velocity_rad_s": {"elbow_flex": -99.0}}, MoveItErrorCode.START_STATE_INVALID, ["-99 rad/s", "limit"]),
        ({"goal": JointGoal({"elbow_flex": NAN})}, INVALID, ["elbow_flex", "nan"]),
        ({"path_constraints": NO_RANGE}, INVALID, ["'elbow'"]),
    ],
)
def test_senseless_requests_are_refused_with_names_and_values(robot, problem, changes, code, said):
    failure = refused(robot, problem, **changes)
    assert failure.code is code
    assert all(part in failure.message for part in said), failure.message


def test_moving_start_may_be_as_fast_as_the_scaled_limit(robot, problem):
    limit = robot.joints["elbow_flex"].max_velocity
    half = {"start_velocity_rad_s": {"elbow_flex": -0.5 * limit}}
    assert refused(robot, problem, velocity_scaling=0.5, **half) is None
    assert refused(robot, problem, velocity_scaling=0.4, **half).details["limit_rad_s"] == pytest.approx(0.4 * limit)


def test_start_a_little_beyond_a_limit_is_accepted_and_further_is_not(robot, at_home):
    lower = robot.joints["wrist_flex"].lower
    assert refusal(check_start, robot, at_home | {"wrist_flex": lower - 0.9 * START_LIMIT_TOLERANCE_RAD}) is None
    failure = refusal(check_start, robot, at_home | {"wrist_flex": lower - 1.1 * START_LIMIT_TOLERANCE_RAD})
    assert failure.code is MoveItErrorCode.START_STATE_INVALID
    assert "'wrist_flex'" in failure.message
    assert failure.details["lower_rad"] == lower


@pytest.mark.parametrize("value", [NAN, math.inf, None])
def test_start_without_a_finite_position_for_every_joint_is_refused(robot, at_home, value):
    start_rad = {name: position for name, position in (at_home | {"gripper": value}).items() if position is not None}
    failure = refusal(check_start, robot, start_rad)
    assert failure.code is MoveItErrorCode.START_STATE_INVALID
    assert "'gripper'" in failure.message
    assert "limits" not in failure.message


def test_shallow_contact_at_the_start_is_let_go_and_a_deep_one_is_not():
    shallow = CollidingPair("base_link", "wrist_link", 0.9 * START_CONTACT_DEPTH_M)
    deep = CollidingPair("shoulder_link", "wrist_link", 1.1 * START_CONTACT_DEPTH_M)
    assert refusal(check_start_contact, []) is None
    assert refusal(check_start_contact, [shallow]) is None
    failure = refusal(check_start_contact, [shallow, deep])
    assert failure.code is MoveItErrorCode.START_STATE_IN_COLLISION
    assert "shoulder_link and wrist_link by 11.0 mm" in failure.message
    assert len(failure.details["pairs"]) == 2


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"group": "leg"}, MoveItErrorCode.INVALID_GROUP_NAME),
        ({"allowed_time_s": 0.0}, INVALID),
        ({"goal": PositionGoal("hand", (0.3, 0.0, 0.2), 0.01)}, MoveItErrorCode.INVALID_LINK_NAME),
        ({"constraints": NO_RANGE}, INVALID),
    ],
)
def test_senseless_questions_for_configurations_are_refused(robot, at_home, changes, code):
    question = IkQuestion("arm", at_home, POINT)
    assert refusal(check_ik_question, robot, question) is None
    assert refusal(check_ik_question, robot, dataclasses.replace(question, **changes)).code is code


def test_senseless_questions_about_states_are_refused_and_bad_states_are_not(robot, at_home):
    question = StateQuestion("arm", at_home | {"elbow_flex": 9.0})
    assert refusal(check_state_question, robot, question) is None
    for changes in ({"group": "leg"}, {"positions_rad": {}}, {"constraints": NO_RANGE}):
        assert refusal(check_state_question, robot, dataclasses.replace(question, **changes)) is not None

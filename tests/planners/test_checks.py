import dataclasses
import math

import pytest

from planners.checks import (
    MAX_ALTERNATIVES,
    START_CONTACT_DEPTH_M,
    START_LIMIT_TOLERANCE_RAD,
    check_constraints,
    check_goal,
    check_ik_question,
    check_request,
    check_start,
    check_start_contact,
    check_state_question,
)
from planners.geometry.collision import CollidingPair
from planners.goals import (
    AnyOf,
    AxisGoal,
    ConstraintGoal,
    Constraints,
    JointConstraint,
    JointGoal,
    OrientationConstraint,
    PoseGoal,
    PositionConstraint,
    PositionGoal,
)
from planners.ik.kinematics import MAX_POINTS
from planners.problem import IkQuestion, MoveItErrorCode, PlanningProblem, StateQuestion
from planners.scene import Pose
from tests.planners.invariants import refusal

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


AXIS = AxisGoal(TIP, (0.3, 0.0, 0.2), 0.01, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.1)
POSE = PoseGoal(TIP, Pose((0.3, 0.0, 0.2)), 0.01, (0.1, 0.1, 0.1))
JOINT_RANGE = JointConstraint("elbow_flex", 0.5, 0.1, 0.1)
REGION = PositionConstraint(TIP, Pose((0.3, 0.0, 0.2)), radius_m=0.1)
ORIENTATION = OrientationConstraint(TIP, (0.0, 0.0, 0.0, 1.0), (0.1, 0.1, 0.1))


def joint_range(**changes):
    return Constraints(joints=(dataclasses.replace(JOINT_RANGE, **changes),))


def region(**changes):
    return Constraints(positions=(dataclasses.replace(REGION, **changes),))


def orientation(**changes):
    return Constraints(orientations=(dataclasses.replace(ORIENTATION, **changes),))


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (JointGoal({"elbow": 0.5}), ["'elbow'", "elbow_flex"]),
        (JointGoal({"gripper": 0.5}), ["'gripper'", "'arm'"]),
        (JointGoal({"": 0.5}), ["''"]),
        (JointGoal({"elbow_flex": NAN}), ["elbow_flex", "nan"]),
        (JointGoal({"elbow_flex": 1.7}), ["elbow_flex", "1.7 rad", "-1.69 to 1.69 rad"]),
        (JointGoal({"elbow_flex": 0.5}, tolerance_rad=-0.1), ["joint tolerance", "-0.1"]),
        (dataclasses.replace(POINT, position_m=(0, NAN, 0)), ["(0, nan, 0)"]),
        (dataclasses.replace(POINT, offset_m=(0, math.inf, 0)), ["offset", "inf"]),
        (dataclasses.replace(POINT, tolerance_m=0.0), ["tolerance", "not 0"]),
        (dataclasses.replace(POINT, tolerance_m=NAN), ["tolerance", "nan"]),
        (dataclasses.replace(AXIS, axis=(0.0, 0.0, 0.0)), ["axis", "length 0"]),
        (dataclasses.replace(AXIS, direction=(0.0, 0.0, 2.0)), ["direction", "length 2"]),
        (dataclasses.replace(AXIS, axis_tolerance_rad=-0.1), ["axis tolerance", "-0.1"]),
        (dataclasses.replace(POSE, pose=Pose((0.3, 0, 0.2), (0.0, 0.0, 0.0, 0.0))), ["orientation", "length 0"]),
        (dataclasses.replace(POSE, pose=Pose((0.3, 0, 0.2), (NAN, 0.0, 0.0, 1.0))), ["orientation", "nan"]),
        (dataclasses.replace(POSE, position_tolerance_m=-1.0), ["position tolerance", "-1"]),
        (dataclasses.replace(POSE, orientation_tolerance_rad=(0.1, -0.1, 0.1)), ["orientation tolerance", "-0.1"]),
        (ConstraintGoal(Constraints()), ["no constraint"]),
        (ConstraintGoal(joint_range(position_rad=NAN)), ["elbow_flex", "nan"]),
        (AnyOf(()), ["0", str(MAX_ALTERNATIVES)]),
        (AnyOf((POINT,) * (MAX_ALTERNATIVES + 1)), [str(MAX_ALTERNATIVES + 1)]),
        (AnyOf((POINT, JointGoal({"elbow_flex": NAN}))), ["elbow_flex"]),
    ],
)
def test_senseless_goals_are_refused_with_names_and_values(robot, arm, goal, said):
    failure = refusal(check_goal, robot, arm, goal)
    assert failure.code is MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert all(part in failure.message for part in said), failure.message


@pytest.mark.parametrize(
    "goal",
    [
        dataclasses.replace(POINT, link="hand"),
        dataclasses.replace(AXIS, link=""),
        dataclasses.replace(POSE, link="hand"),
        ConstraintGoal(region(link="hand")),
        ConstraintGoal(orientation(link="hand")),
    ],
)
def test_unknown_links_are_refused_with_the_known_ones(robot, arm, goal):
    failure = refusal(check_goal, robot, arm, goal)
    assert failure.code is MoveItErrorCode.INVALID_LINK_NAME
    assert TIP in failure.message
    # A group whose joints are not one chain has no tip.
    assert ("not one chain" in failure.message) == (not failure.details["link"])


@pytest.mark.parametrize(
    ("constraints", "said"),
    [
        (joint_range(joint="elbow"), ["'elbow'", "elbow_flex"]),
        (joint_range(above_rad=-0.1), ["elbow_flex", "-0.1"]),
        (joint_range(below_rad=NAN), ["elbow_flex", "nan"]),
        (joint_range(position_rad=2.0), ["elbow_flex", "-1.69 to 1.69"]),
        (joint_range(weight=-1.0), ["weight", "-1"]),
        (Constraints(joints=(JOINT_RANGE, dataclasses.replace(JOINT_RANGE, position_rad=1.0))), ["no position"]),
        (region(radius_m=None), ["either a box or a sphere"]),
        (region(half_size_m=(0.1, 0.1, 0.1)), ["either a box or a sphere"]),
        (region(radius_m=0.0), ["position tolerance", "not 0"]),
        (region(region=Pose((0, 0, 0), (0.0, 0.0, 0.0, 0.0))), ["length 0"]),
        (region(offset_m=(0, 0, NAN)), ["offset", "nan"]),
        (Constraints(positions=(REGION,) * (MAX_POINTS + 1)), [str(MAX_POINTS)]),
        (orientation(orientation=(0.0, 0.0, 0.0, 0.5)), ["length 0.5"]),
        (orientation(tolerance_rad=(0.1, 0.1, 0.0)), ["orientation tolerance", "not 0"]),
        (orientation(weight=NAN), ["weight", "nan"]),
    ],
)
def test_senseless_constraints_are_refused_with_names_and_values(robot, constraints, said):
    failure = refusal(check_constraints, robot, constraints)
    assert failure.code is MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert all(part in failure.message for part in said), failure.message


def test_joint_goal_may_exceed_a_limit_by_rounding_only(robot, arm):
    joint = robot.joints["elbow_flex"]
    upper = joint.upper
    assert refusal(check_goal, robot, arm, JointGoal({"elbow_flex": upper + 0.009}, tolerance_rad=0.01)) is None
    failure = refusal(check_goal, robot, arm, JointGoal({"elbow_flex": upper + 0.011}, tolerance_rad=0.01))
    limits = {"lower_rad": joint.lower, "upper_rad": upper}
    assert failure.details == {"joint": "elbow_flex", "position_rad": upper + 0.011, **limits}

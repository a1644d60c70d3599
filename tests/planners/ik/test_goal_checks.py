import dataclasses
import math

import pytest

from planners.checks import MAX_ALTERNATIVES, check_constraints, check_goal
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
from planners.problem import MoveItErrorCode
from planners.scene import Pose
from tests.planners.refusals import refusal

TIP = "gripper_frame_link"
NAN = math.nan
POINT = PositionGoal(TIP, (0.3, 0.0, 0.2), 0.01)
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

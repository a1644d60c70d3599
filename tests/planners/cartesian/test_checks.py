from dataclasses import replace

import numpy as np
import pytest

from planners.cartesian.checks import check_path, check_shape
from planners.goals import Constraints, JointConstraint
from planners.problem import Arc, CartesianProblem, Line, MoveItErrorCode
from planners.scene import Pose

PROBLEM = CartesianProblem("arm", {}, "gripper_frame_link", (Line(Pose((0.2, 0.0, 0.1))),))
NAN = float("nan")


@pytest.mark.parametrize(
    ("asked", "code", "said"),
    [
        ({"group": "leg"}, MoveItErrorCode.INVALID_GROUP_NAME, "leg"),
        ({"link": "toe"}, MoveItErrorCode.INVALID_LINK_NAME, "toe"),
        ({"link": ""}, MoveItErrorCode.INVALID_LINK_NAME, "''"),
        ({"segments": ()}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "no segment"),
        ({"velocity_scaling": 0.0}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "velocity scaling"),
        ({"acceleration_scaling": 1.5}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "acceleration scaling"),
        ({"max_step_m": 0.0}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "greatest step"),
        ({"max_joint_step_rad": -1.0}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "joint step"),
        ({"tip_speed_m_s": NAN}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "tip speed"),
        ({"allowed_time_s": float("inf")}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "planning time"),
        (
            {"keep_orientation": True, "orientation_tolerance_rad": -0.1},
            MoveItErrorCode.INVALID_GOAL_CONSTRAINTS,
            "orientation tolerance",
        ),
        (
            {"path_constraints": Constraints(joints=(JointConstraint("knee", 0.0, 0.1, 0.1),))},
            MoveItErrorCode.INVALID_GOAL_CONSTRAINTS,
            "knee",
        ),
    ],
)
def test_each_bad_name_or_number_is_refused_by_name(robot, asked, code, said):
    refusal = check_path(robot, replace(PROBLEM, **asked))
    assert refusal.code == code
    assert said in refusal.message


@pytest.mark.parametrize(
    ("segment", "said"),
    [
        (Line(Pose((NAN, 0.0, 0.0))), "not finite"),
        (Line(Pose((0.2, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))), "length 0"),
        (Line(Pose((0.2, 0.0, 0.0), (0.0, 0.0, 0.0, NAN))), "length nan"),
        (Arc((NAN, 0.0, 0.0), Pose((0.2, 0.0, 0.0))), "not finite"),
    ],
)
def test_a_bad_segment_is_told_by_its_number(robot, segment, said):
    refusal = check_path(robot, replace(PROBLEM, segments=(*PROBLEM.segments, segment)))
    assert refusal.code == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert "segment 1" in refusal.message
    assert said in refusal.message


def test_a_good_problem_is_not_refused(robot):
    assert check_path(robot, PROBLEM) is None
    assert check_shape(np.array([0.1, 0.0, 0.1]), PROBLEM) is None


def test_an_arc_without_a_circle_is_refused():
    flat = replace(PROBLEM, segments=(Arc((0.15, 0.0, 0.1), Pose((0.2, 0.0, 0.1))),))
    assert "segment 0" in check_shape(np.array([0.1, 0.0, 0.1]), flat).message


def test_a_path_of_too_many_points_is_refused_with_the_limit():
    refusal = check_shape(np.array([0.1, 0.0, 0.1]), replace(PROBLEM, max_step_m=1e-6))
    assert refusal.code == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert "10000" in refusal.message

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.cartesian.tip_path import TipPath, apart_rad, arc_flaw, check_path, check_shape
from planners.goals import Constraints, JointConstraint
from planners.problem import Arc, CartesianProblem, Line, MoveItErrorCode
from planners.scene import Pose
from tests.helpers.resources import examples
from tests.planners.invariants import refusal

START = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.1]))
QUARTER_ABOUT_Z = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))

coordinates = st.floats(-0.3, 0.3).map(lambda value: round(value, 3))
points = st.tuples(*[coordinates] * 3)


def places(path, count=200):
    return np.array([path.at(along_m).translation for along_m in np.linspace(0.0, path.length_m, count)])


def tame(arc):
    return arc_flaw(START.translation, arc) is None


arcs = st.builds(lambda via, end: Arc(via, Pose(end)), points, points).filter(tame)


@given(arcs)
@examples(30)
def test_an_arc_goes_evenly_through_its_points_and_has_its_length(arc):
    path = TipPath(START, [arc])
    way = places(path, 500)
    np.testing.assert_allclose(way[0], START.translation, atol=1e-9)
    np.testing.assert_allclose(way[-1], arc.end.position_m, atol=1e-6)
    step_m = np.linalg.norm(np.diff(way, axis=0), axis=1).max()
    assert np.linalg.norm(way - np.array(arc.via_m), axis=1).min() <= step_m + 1e-6
    steps_m = np.linalg.norm(np.diff(way, axis=0), axis=1)
    np.testing.assert_allclose(steps_m, steps_m.mean(), rtol=1e-3)
    assert steps_m.sum() == pytest.approx(path.length_m, rel=1e-3)


def test_a_turn_on_the_spot_has_a_length_and_turns_evenly():
    path = TipPath(START, [Line(Pose((0.2, 0.0, 0.1), QUARTER_ABOUT_Z))])
    assert path.length_m == pytest.approx(0.1 * np.pi / 2.0)
    half = path.at(0.5 * path.length_m)
    assert apart_rad(START, half) == pytest.approx(np.pi / 4.0)
    np.testing.assert_allclose(half.translation, START.translation)


def test_repeated_points_add_nothing():
    there = Line(Pose((0.25, 0.0, 0.1)))
    path = TipPath(START, [Line(Pose((0.2, 0.0, 0.1))), there, there])
    assert path.length_m == pytest.approx(0.05)
    assert path.corners_m == [path.length_m]
    assert TipPath(START, [Line(Pose((0.2, 0.0, 0.1)))]).length_m == 0.0


@pytest.mark.parametrize(("second", "corners"), [((0.3, 0.0, 0.1), 1), ((0.25, 0.05, 0.1), 2), ((0.2, 0.0, 0.1), 2)])
def test_corners_are_where_the_direction_changes(second, corners):
    path = TipPath(START, [Line(Pose((0.25, 0.0, 0.1))), Line(Pose(second))])
    assert len(path.corners_m) == corners
    assert path.corners_m[0] == pytest.approx(0.05 if corners == 2 else 0.1)


@pytest.mark.parametrize(
    ("via", "end", "flaw"),
    [
        ((0.2, 0.0, 0.1), (0.3, 0.0, 0.1), "the same"),
        ((0.25, 0.0, 0.1), (0.2, 0.0, 0.1), "the same"),
        ((0.25, 0.0, 0.1), (0.3, 0.0, 0.1), "on a line"),
    ],
)
def test_points_that_make_no_arc_are_told(via, end, flaw):
    assert flaw in arc_flaw(START.translation, Arc(via, Pose(end)))


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
    failure = refusal(check_path, robot, replace(PROBLEM, **asked))
    assert failure.code == code
    assert said in failure.message


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
    failure = refusal(check_path, robot, replace(PROBLEM, segments=(*PROBLEM.segments, segment)))
    assert failure.code == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert "segment 1" in failure.message
    assert said in failure.message


def test_a_path_of_too_many_points_is_refused_with_the_limit():
    failure = refusal(check_shape, np.array([0.1, 0.0, 0.1]), replace(PROBLEM, max_step_m=1e-6))
    assert failure.code == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert "10000" in failure.message

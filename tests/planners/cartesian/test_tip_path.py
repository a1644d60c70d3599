from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.cartesian.tip_path import TipPath, apart_rad, arc_flaw, check_path, check_shape
from planners.goals import Constraints, JointConstraint
from planners.problem import Arc, CartesianProblem, Line
from planners.problem import MoveItErrorCode as Code
from planners.scene import Pose
from tests.helpers.resources import examples
from tests.planners.invariants import refusal

START = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.1]))
QUARTER_ABOUT_Z = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))

coordinates = st.floats(-0.3, 0.3).map(lambda value: round(value, 3))
points = st.tuples(*[coordinates] * 3)


def tame(arc):
    return arc_flaw(START.translation, arc) is None


def path_to(*places_m):
    return TipPath(START, [Line(Pose(place_m)) for place_m in places_m])


@given(st.builds(lambda via, end: Arc(via, Pose(end)), points, points).filter(tame))
@examples(30)
def test_an_arc_goes_evenly_through_its_points_and_has_its_length(arc):
    path = TipPath(START, [arc])
    way = np.array([path.at(along_m).translation for along_m in np.linspace(0.0, path.length_m, 500)])
    np.testing.assert_allclose(way[0], START.translation, atol=1e-9)
    np.testing.assert_allclose(way[-1], arc.end.position_m, atol=1e-6)
    steps_m = np.linalg.norm(np.diff(way, axis=0), axis=1)
    assert np.linalg.norm(way - np.array(arc.via_m), axis=1).min() <= steps_m.max() + 1e-6
    np.testing.assert_allclose(steps_m, steps_m.mean(), rtol=1e-3)
    assert steps_m.sum() == pytest.approx(path.length_m, rel=1e-3)


def test_a_turn_on_the_spot_has_a_length_and_turns_evenly():
    path = TipPath(START, [Line(Pose((0.2, 0.0, 0.1), QUARTER_ABOUT_Z))])
    assert path.length_m == pytest.approx(0.1 * np.pi / 2.0)
    half = path.at(0.5 * path.length_m)
    assert apart_rad(START, half) == pytest.approx(np.pi / 4.0)
    np.testing.assert_allclose(half.translation, START.translation)


def test_repeated_points_add_nothing_and_corners_are_where_the_direction_changes():
    here_m, there_m = (0.2, 0.0, 0.1), (0.25, 0.0, 0.1)
    path = path_to(here_m, there_m, there_m)
    assert path.length_m == pytest.approx(0.05)
    assert path.corners_m == [path.length_m]
    assert path_to(here_m).length_m == 0.0
    for second_m, corners in (((0.3, 0.0, 0.1), 1), ((0.25, 0.05, 0.1), 2), (here_m, 2)):
        path = path_to(there_m, second_m)
        assert len(path.corners_m) == corners
        assert path.corners_m[0] == pytest.approx(0.05 if corners == 2 else 0.1)


def test_points_that_make_no_arc_are_told():
    for via_m, end_m, flaw in (
        ((0.2, 0.0, 0.1), (0.3, 0.0, 0.1), "the same"),
        ((0.25, 0.0, 0.1), (0.2, 0.0, 0.1), "the same"),
        ((0.25, 0.0, 0.1), (0.3, 0.0, 0.1), "on a line"),
    ):
        assert flaw in arc_flaw(START.translation, Arc(via_m, Pose(end_m)))


PROBLEM = CartesianProblem("arm", {}, "gripper_frame_link", (Line(Pose((0.2, 0.0, 0.1))),))
NAN = float("nan")
INVALID = Code.INVALID_GOAL_CONSTRAINTS


def assert_refused(failure, code, *words):
    assert failure.code == code, words
    assert all(word in failure.message for word in words), failure


def test_each_bad_name_number_or_segment_is_refused_by_name_and_too_many_points_with_the_limit(robot):
    knee = Constraints(joints=(JointConstraint("knee", 0.0, 0.1, 0.1),))
    for asked, code, said in (
        ({"group": "leg"}, Code.INVALID_GROUP_NAME, "leg"),
        ({"link": "toe"}, Code.INVALID_LINK_NAME, "toe"),
        ({"link": ""}, Code.INVALID_LINK_NAME, "''"),
        ({"segments": ()}, INVALID, "no segment"),
        ({"velocity_scaling": 0.0}, INVALID, "velocity scaling"),
        ({"acceleration_scaling": 1.5}, INVALID, "acceleration scaling"),
        ({"max_step_m": 0.0}, INVALID, "greatest step"),
        ({"max_joint_step_rad": -1.0}, INVALID, "joint step"),
        ({"tip_speed_m_s": NAN}, INVALID, "tip speed"),
        ({"allowed_time_s": float("inf")}, INVALID, "planning time"),
        ({"keep_orientation": True, "orientation_tolerance_rad": -0.1}, INVALID, "orientation tolerance"),
        ({"path_constraints": knee}, INVALID, "knee"),
    ):
        assert_refused(refusal(check_path, robot, replace(PROBLEM, **asked)), code, said)
    for segment, said in (
        (Line(Pose((NAN, 0.0, 0.0))), "not finite"),
        (Line(Pose((0.2, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))), "length 0"),
        (Line(Pose((0.2, 0.0, 0.0), (0.0, 0.0, 0.0, NAN))), "length nan"),
        (Arc((NAN, 0.0, 0.0), Pose((0.2, 0.0, 0.0))), "not finite"),
    ):
        bad = replace(PROBLEM, segments=(*PROBLEM.segments, segment))
        assert_refused(refusal(check_path, robot, bad), INVALID, "segment 1", said)
    too_fine = replace(PROBLEM, max_step_m=1e-6)
    assert_refused(refusal(check_shape, np.array([0.1, 0.0, 0.1]), too_fine), INVALID, "10000")

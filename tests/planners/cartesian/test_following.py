from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.cartesian.following import (
    CHORD_M,
    CORNER_STEP_M,
    ON_PATH_M,
    FollowedPath,
    PathEnd,
    PathFollower,
    tip_curve,
)
from planners.cartesian.tip_path import TipPath, apart_m
from planners.motions.spline import NaturalSpline
from tests.helpers.resources import examples
from tests.planners.following import line, shares
from tests.planners.invariants import never

START = np.array([0.0, -0.5, 0.7, 0.4, 0.0])


def following(follower, start, segments, check_point=lambda point: None, should_stop=never, **asked):
    tracker = follower.tracker(start)
    path = TipPath(tracker.pose(start), segments)
    options = {"max_step_m": 0.005, "keep_orientation": "orientation_tolerance_rad" in asked} | asked
    problem = follower.problem(start, *segments, **options)
    return PathFollower(problem, tracker, path, check_point, should_stop)


def shifted(follower, *offset_m):
    placement = follower.pose(START)
    return line(pin.SE3(placement.rotation, placement.translation + np.array(offset_m)))


@given(share=shares, near=shares)
@examples(20)
def test_points_lie_on_the_path_no_further_apart_than_asked(follower, share, near):
    start = follower.point(0.8 * share)
    task = following(follower, start, [line(follower.pose(follower.near(start, near)))])
    followed = task.from_point(start)
    assert np.diff(followed.along_m).max(initial=0.0) <= 0.005 + 1e-9
    for along_m, point in zip(followed.along_m, followed.points, strict=True):
        assert apart_m(task.path.at(along_m), task.tracker.pose(point)) <= ON_PATH_M


@given(share=shares, near=shares)
@examples(20)
def test_straight_joint_lines_between_points_stay_near_the_path(follower, share, near):
    start = follower.point(0.8 * share)
    task = following(follower, start, [line(follower.pose(follower.near(start, near)))])
    followed = task.from_point(start)
    for i in range(len(followed.points) - 1):
        halfway = task.tracker.pose(0.5 * (followed.points[i] + followed.points[i + 1]))
        assert apart_m(task.path.at(0.5 * (followed.along_m[i] + followed.along_m[i + 1])), halfway) <= CHORD_M


def test_a_path_within_reach_is_followed_to_its_end(follower):
    task = following(follower, START, [shifted(follower, 0.0, 0.05, 0.02)])
    followed = task.from_point(START)
    assert followed.ended is None
    assert followed.along_m[-1] == pytest.approx(task.path.length_m)


def test_a_point_lies_in_each_corner_and_close_ones_beside_it(follower):
    task = following(follower, START, [shifted(follower, 0.0, 0.05, 0.0), shifted(follower, 0.0, 0.05, -0.05)])
    along_m = task.from_point(START).along_m
    corner = int(np.argmin(np.abs(along_m - 0.05)))
    assert along_m[corner] == pytest.approx(0.05, abs=1e-12)
    assert np.diff(along_m)[corner - 1] <= 1.5 * CORNER_STEP_M
    assert np.diff(along_m)[corner] <= 3.0 * CORNER_STEP_M


def test_a_flaw_ends_the_path_at_its_first_point(follower):
    limit_rad = START[0] - 0.1
    flaw = PathEnd("constraint", "too far to the right", {})
    task = following(
        follower,
        START,
        [shifted(follower, 0.0, 0.1, 0.0)],
        check_point=lambda point: flaw if point[0] < limit_rad else None,
    )
    followed = task.from_point(START)
    assert followed.ended is flaw
    assert limit_rad <= followed.points[-1][0] < limit_rad + 0.003


coordinates = st.floats(-2.0, 2.0).map(lambda value: round(value, 3))
curves = st.lists(st.tuples(*[coordinates] * 3), min_size=2, max_size=12).map(np.array)
spacings = st.integers(1, 5)


def spline(points, spacing):
    """Knots now near each other, now further apart."""
    spans = 0.01 * (1.0 + np.arange(len(points) - 1) % spacing)
    return NaturalSpline(np.concatenate(([0.0], np.cumsum(spans))), points)


@given(curves, spacings)
def test_the_grid_has_every_knot_and_rises(points, spacing):
    path = spline(points, spacing)
    assert np.all(np.diff(path.grid) > 0.0)
    assert np.abs(path.grid[:, np.newaxis] - path.knots).min(axis=0).max() < 1e-12


def test_points_that_are_not_finite_make_no_curve():
    with pytest.raises(ValueError, match="finite"):
        NaturalSpline(np.array([0.0, 1.0]), np.array([[0.0], [np.nan]]))


@pytest.fixture
def drawn(follower):
    """A curve through points far too few for a line of 8 cm, the path, and the tracker."""
    tracker = follower.tracker(START)
    placement = tracker.pose(START)
    path = TipPath(placement, [line(pin.SE3(placement.rotation, placement.translation + np.array([0.0, 0.08, 0.0])))])
    end = tracker.follow(START, path.at(0.08), 0.0)
    few = FollowedPath(np.array([0.0, 0.08]), np.array([START, end]), None)
    return tip_curve(few, path, tracker), path, tracker


def test_points_are_added_until_the_curve_is_near_the_path(drawn):
    drawn, path, tracker = drawn
    assert len(drawn.followed.points) > 3
    along_m = np.linspace(0.0, 0.08, 300)
    off_m = [apart_m(path.at(s), tracker.pose(p)) for s, p in zip(along_m, drawn.curve(along_m), strict=True)]
    assert max(off_m) <= 1.2 * CHORD_M


def test_the_deviation_is_that_of_the_curve(drawn):
    drawn, path, tracker = drawn
    along_m = np.linspace(0.0, 0.08, 300)
    line_m = np.array([path.at(s).translation for s in along_m])
    places_m = np.array([tracker.pose(p).translation for p in drawn.curve(along_m)])
    off_m = max(np.min(np.linalg.norm(line_m - place, axis=1)) for place in places_m)
    assert drawn.deviation.position_m == pytest.approx(off_m, abs=0.3 * off_m + 1e-5)


def test_the_curve_stays_within_the_limits_where_a_joint_stops_at_one(follower):
    tracker = follower.tracker(START)
    placement = tracker.pose(START)
    path = TipPath(placement, [line(pin.SE3(placement.rotation, placement.translation + np.array([0.0, 0.0, 0.04])))])
    along_m = np.linspace(0.0, 0.04, 9)
    points = np.array([tracker.follow(START, path.at(s), 0.0) for s in along_m])
    shift = follower.upper_rad[4] - 1e-3 - points[:, 4].max()
    points[:4, 4] += np.linspace(-0.2, 0.0, 4) + shift
    points[4:, 4] = follower.upper_rad[4] - 1e-3
    drawn = tip_curve(FollowedPath(along_m, points, None), path, tracker)
    assert not tracker.outside(drawn.curve(np.linspace(0.0, 0.04, 1000))).any()

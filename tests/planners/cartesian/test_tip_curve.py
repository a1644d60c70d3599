from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.cartesian.following import CHORD_M, FollowedPath
from planners.cartesian.tip_curve import SplinePath, tip_curve
from planners.cartesian.tip_path import TipPath, apart_m
from tests.planners.following import line

coordinates = st.floats(-2.0, 2.0).map(lambda value: round(value, 3))
curves = st.lists(st.tuples(*[coordinates] * 3), min_size=2, max_size=12).map(np.array)
spacings = st.integers(1, 5)


def spline(points, spacing):
    """Knots now near each other, now further apart."""
    spans = 0.01 * (1.0 + np.arange(len(points) - 1) % spacing)
    return SplinePath(np.concatenate(([0.0], np.cumsum(spans))), points)


@given(curves, spacings)
def test_the_curve_goes_through_its_points(points, spacing):
    path = spline(points, spacing)
    np.testing.assert_allclose(path(path.knots), points, atol=1e-12)


@given(curves, spacings)
def test_slope_and_bend_are_the_derivatives_of_the_position(points, spacing):
    path = spline(points, spacing)
    middle = 0.5 * (path.knots[1:] + path.knots[:-1])
    step = 1e-6
    slope = (path(middle + step) - path(middle - step)) / (2 * step)
    bend = (path(middle + step, 1) - path(middle - step, 1)) / (2 * step)
    np.testing.assert_allclose(slope, path(middle, 1), atol=1e-5 * max(1.0, np.abs(slope).max()))
    np.testing.assert_allclose(bend, path(middle, 2), atol=1e-5 * max(1.0, np.abs(bend).max()))


@given(curves, spacings)
def test_slope_and_bend_do_not_jump_in_the_points(points, spacing):
    path = spline(points, spacing)
    before, after = np.nextafter(path.knots[1:-1], 0.0), np.nextafter(path.knots[1:-1], 9.0)
    for order in (1, 2):
        scale = max(1.0, np.abs(path(path.knots, order)).max())
        np.testing.assert_allclose(path(before, order), path(after, order), atol=1e-9 * scale)


@given(st.tuples(*[coordinates] * 3).map(np.array), spacings)
def test_points_on_a_line_make_a_line(direction, spacing):
    points = np.linspace(0.0, 1.0, 7)[:, np.newaxis] * direction
    path = SplinePath(np.linspace(0.0, 1.0, 7), points)
    at = np.linspace(0.0, 1.0, 50)
    np.testing.assert_allclose(path(at), at[:, np.newaxis] * direction, atol=1e-12)


@given(curves, spacings)
def test_the_grid_has_every_knot_and_rises(points, spacing):
    path = spline(points, spacing)
    assert np.all(np.diff(path.grid) > 0.0)
    assert np.abs(path.grid[:, np.newaxis] - path.knots).min(axis=0).max() < 1e-12


def test_points_that_are_not_finite_make_no_curve():
    with pytest.raises(ValueError, match="finite"):
        SplinePath(np.array([0.0, 1.0]), np.array([[0.0], [np.nan]]))


START = np.array([0.0, -0.5, 0.7, 0.4, 0.0])


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

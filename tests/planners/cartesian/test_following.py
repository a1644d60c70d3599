import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.cartesian.planning import CHORD_M, FollowedPath, tip_curve
from planners.cartesian.tip_path import TipPath, apart_m
from tests.helpers.resources import examples
from tests.planners.following import line, shares

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
    (followed, curve, _), path, tracker = drawn
    assert len(followed.points) > 3
    along_m = np.linspace(0.0, 0.08, 300)
    off_m = [apart_m(path.at(s), tracker.pose(p)) for s, p in zip(along_m, curve(along_m), strict=True)]
    assert max(off_m) <= 1.2 * CHORD_M


def test_the_curve_stays_within_the_limits_where_a_joint_stops_at_one(follower):
    tracker = follower.tracker(START)
    placement = tracker.pose(START)
    path = TipPath(placement, [line(pin.SE3(placement.rotation, placement.translation + np.array([0.0, 0.0, 0.04])))])
    along_m = np.linspace(0.0, 0.04, 9)
    points = np.array([tracker.follow(START, path.at(s), 0.0) for s in along_m])
    shift = follower.upper_rad[4] - 1e-3 - points[:, 4].max()
    points[:4, 4] += np.linspace(-0.2, 0.0, 4) + shift
    points[4:, 4] = follower.upper_rad[4] - 1e-3
    _, curve, _ = tip_curve(FollowedPath(along_m, points, None), path, tracker)
    assert not tracker.outside(curve(np.linspace(0.0, 0.04, 1000))).any()


steps_m = st.tuples(*[st.floats(-0.005, 0.005)] * 3).map(np.array)


def moved(placement, step_m):
    return pin.SE3(placement.rotation, placement.translation + step_m)


@given(share=shares, step_m=steps_m)
@examples(60)
def test_no_joint_goes_beyond_its_limits(follower, share, step_m):
    start = follower.point(1.1 * share)
    tracker = follower.tracker(start)
    assert not tracker.outside(tracker.follow(start, moved(tracker.pose(start), 20.0 * step_m), 1.0)).any()


def test_turning_for_the_orientation_alone_is_limited(follower):
    start = np.array([0.2, -0.4, 0.6, 0.3, 0.1])
    placement = follower.pose(start)
    target = pin.SE3(placement.rotation @ pin.exp3(np.array([0.0, 0.0, 1.0])), placement.translation)
    tracker = follower.tracker(start)
    assert np.abs(tracker.follow(start, target, 0.05) - start).max() <= 0.06
    assert np.abs(tracker.follow(start, target, 2.0) - start).max() > 0.5


def test_the_speed_of_the_tip_is_that_of_its_positions(follower):
    point, tangent, step = np.array([0.1, -0.4, 0.6, 0.3, 0.1]), np.array([1.0, 0.5, -0.5, 0.2, 0.3]), 1e-6
    tracker = follower.tracker(point)
    moved_m = apart_m(tracker.pose(point - step * tangent), tracker.pose(point + step * tangent))
    assert tracker.speed_m(point, tangent) == pytest.approx(0.5 * moved_m / step, rel=1e-5)

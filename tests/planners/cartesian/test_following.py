from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import strategies as st

from planners.cartesian.following import (
    CHORD_M,
    CORNER_STEP_M,
    FollowedPath,
    PathEnd,
    PathFollower,
    tip_curve,
)
from planners.cartesian.tip_path import TipPath, apart_m
from tests.planners.following import line
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

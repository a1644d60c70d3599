from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from planners.cartesian.planning import (
    CHORD_M,
    FollowedPath,
    tip_curve,
)
from planners.cartesian.tip_path import TipPath, apart_m
from tests.planners.following import line

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

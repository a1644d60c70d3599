import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.cartesian.tip_path import apart_m
from tests.helpers.resources import examples
from tests.planners.following import shares

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

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from planners.cartesian.profile import SAMPLE_PERIOD_S, Profile, sampled, within_limits
from planners.cartesian.spline import SplinePath
from planners.rates import RateLimits
from robot.trajectory import Trajectory
from tests.planners.invariants import assert_keeps_rates, assert_well_formed

POINTS = np.array([[0.0, 0.0], [0.5, 0.2], [1.0, -0.1]])


def test_a_profile_takes_the_time_of_its_mean_rates() -> None:
    profile = Profile(np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, 0.0]))
    np.testing.assert_allclose(profile.times_s, [0.0, 1.0, 3.0])


def test_samples_begin_and_end_at_rest_in_the_ends_and_are_no_further_apart_than_a_tick() -> None:
    path = SplinePath(np.array([0.0, 0.6, 1.3]), POINTS)
    end = float(path.grid[-1])
    profile = Profile(np.array([0.0, 0.5 * end, end]), np.array([0.0, 1.0, 0.0]))
    motion = sampled(path, profile, ("a", "b"), POINTS)
    assert_well_formed(motion)
    np.testing.assert_array_equal(motion.positions_rad[[0, -1]], POINTS[[0, -1]])
    assert not motion.velocities_rad_s[[0, -1]].any()
    assert np.diff(motion.time_s).max() <= SAMPLE_PERIOD_S + 0.002


@given(st.floats(0.01, 10.0), st.floats(0.01, 10.0))
def test_a_motion_is_slowed_down_until_it_keeps_its_limits_between_samples(velocity, acceleration):
    positions = np.array([[0.0], [0.3], [0.2]])
    motion = Trajectory(("a",), np.array([0.0, 0.1, 0.2]), positions, np.zeros((3, 1)), np.zeros((3, 1)))
    limits = RateLimits(np.array([velocity]), np.array([acceleration]))
    slowed = within_limits(motion, limits)
    assert_keeps_rates(slowed, limits)
    assert slowed.duration_s >= motion.duration_s

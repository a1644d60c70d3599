import numpy as np
import pytest

from planners.motions.curve import averaged, averaging_start, from_moving, line, polyline, window_ticks
from planners.problem import RateLimits
from tests.planners.invariants import assert_from_rest_to_rest, assert_keeps_rates, assert_well_formed

NAMES = ("a", "b")
LIMITS = RateLimits(np.array([2.0, 1.2]), np.array([6.0, 3.0]), np.array([60.0, 50.0]))
START, GOAL = np.array([0.1, -0.3]), np.array([1.0, 0.5])
MOVING = np.array([0.7, -0.4])


def assert_keeps_jerk(trajectory, limits):
    _, _, first = trajectory.sample(0.0)
    np.testing.assert_allclose(first, 0.0, atol=1e-9)
    times_s = np.arange(0.0, trajectory.duration_s, 0.001)
    accelerations = np.array([trajectory.sample(t)[2] for t in times_s])
    assert np.all(np.abs(np.diff(accelerations, axis=0)) <= 0.001 * limits.jerk_rad_s3 * 1.001 + 1e-6)


@pytest.mark.parametrize("points", [[START, GOAL], [START, GOAL, [0.2, 0.9]]])
def test_averaged_curves_keep_all_limits(points):
    trajectory = averaged(polyline(np.array(points), LIMITS), window_ticks(LIMITS), NAMES)
    assert_well_formed(trajectory)
    assert_from_rest_to_rest(trajectory, points[0], points[-1])
    assert_keeps_rates(trajectory, LIMITS)
    assert_keeps_jerk(trajectory, LIMITS)


def test_a_straight_line_stays_straight():
    trajectory = averaged(line(START, GOAL, LIMITS), window_ticks(LIMITS), NAMES)
    share = (trajectory.positions_rad - START) / (GOAL - START)
    np.testing.assert_allclose(share[:, 0], share[:, 1], atol=1e-9)


def test_a_moving_start_is_met_in_position_and_velocity():
    window = window_ticks(LIMITS)
    trajectory = averaged(from_moving(averaging_start(START, MOVING, window), MOVING, GOAL, LIMITS), window, NAMES)
    np.testing.assert_allclose(trajectory.positions_rad[0], START, atol=1e-12)
    np.testing.assert_allclose(trajectory.velocities_rad_s[0], MOVING, atol=1e-12)
    assert_keeps_rates(trajectory, LIMITS)
    assert_keeps_jerk(trajectory, LIMITS)


def test_there_is_no_window_without_jerk_limits():
    assert window_ticks(RateLimits(np.ones(2), np.ones(2))) == 0
    assert window_ticks(RateLimits(np.ones(2), np.ones(2), np.array([np.inf, np.inf]))) == 0

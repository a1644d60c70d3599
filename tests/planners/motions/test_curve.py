import numpy as np
import pytest

from planners.motions.curve import TICK_S, Curve, averaged, averaging_start, from_moving, polyline, window_ticks
from planners.problem import RateLimits
from tests.planners.invariants import assert_from_rest_to_rest, assert_keeps_rates, assert_well_formed

NAMES = ("a", "b")
LIMITS = RateLimits(np.array([2.0, 1.2]), np.array([6.0, 3.0]), np.array([60.0, 50.0]))
ZIGZAG = np.array([[0.0, 0.0], [1.0, 0.5], [0.2, 0.9]])


@pytest.fixture
def curve():
    return polyline(ZIGZAG, LIMITS)


def test_samples_are_ten_milliseconds_apart_at_most_and_repeat_the_curve(curve):
    trajectory = curve.sampled(NAMES)
    assert_well_formed(trajectory)
    spacing_s = np.diff(trajectory.time_s)
    assert 0.9 * TICK_S < spacing_s.min() < spacing_s.max() < 0.0112
    ticks = np.arange(1, curve.duration_ticks, 37)
    positions, velocities, _ = curve.at(ticks)
    for i, tick in enumerate(ticks):
        position, velocity, _ = trajectory.sample(TICK_S * tick)
        np.testing.assert_allclose(position, positions[i], atol=1e-10)
        np.testing.assert_allclose(velocity, velocities[i], atol=1e-8)


def test_replacing_a_part_by_itself_changes_nothing_and_the_ends_stay_exact(curve):
    same = curve.replaced(1000, 5000, curve.part(1000, 5000))
    moved = curve.part(100, curve.duration_ticks)
    moved.positions_rad[-1] += 1e-13
    np.testing.assert_array_equal(curve.replaced(100, curve.duration_ticks, moved).positions_rad[-1], ZIGZAG[-1])
    ticks = np.arange(0, curve.duration_ticks, 91)
    np.testing.assert_allclose(same.at(ticks)[0], curve.at(ticks)[0], atol=1e-12)
    assert same.duration_ticks == curve.duration_ticks


def test_turning_points_between_knots_count_for_the_range():
    # Thrown up at 1 rad/s and braked at 2 rad/s^2 it turns 0.25 rad higher, where no knot is.
    thrown = Curve(np.array([0, 10000]), np.zeros((2, 1)), np.array([[1.0], [-1.0]]))
    assert thrown.stays_within(np.array([-0.01]), np.array([0.2501]))
    assert not thrown.stays_within(np.array([-0.01]), np.array([0.2499]))
    assert not thrown.stays_within(np.array([0.01]), np.array([1.0]))


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
    share = (trajectory.positions_rad - START) / (GOAL - START)
    # A straight line stays straight.
    assert len(points) > 2 or np.abs(share[:, 0] - share[:, 1]).max() < 1e-9


def test_a_moving_start_is_met_in_position_and_velocity():
    window = window_ticks(LIMITS)
    trajectory = averaged(from_moving(averaging_start(START, MOVING, window), MOVING, GOAL, LIMITS), window, NAMES)
    np.testing.assert_allclose(trajectory.positions_rad[0], START, atol=1e-12)
    np.testing.assert_allclose(trajectory.velocities_rad_s[0], MOVING, atol=1e-12)
    assert_keeps_rates(trajectory, LIMITS)
    assert_keeps_jerk(trajectory, LIMITS)

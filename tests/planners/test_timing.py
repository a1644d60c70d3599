import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planners.profile import SAMPLE_PERIOD_S, SHORTEST_INTERVAL_S, RateLimits
from planners.timing import time_path
from tests.planners.invariants import (
    assert_from_rest_to_rest,
    assert_keeps_rates,
    assert_well_formed,
)

NAMES = ("a", "b", "c")
LIMITS = RateLimits(np.array([2.0, 1.2, 1.6]), np.array([6.0, 3.0, 5.0]))

coordinates = st.floats(-2.0, 2.0, allow_nan=False).map(lambda value: round(value, 6))
polylines = st.lists(st.tuples(*[coordinates] * 3), min_size=1, max_size=6).map(np.array)
blends = st.sampled_from([0.0, 0.075, 0.3])


def least_time_s(distance, velocity, acceleration):
    """Least time from rest to rest over a distance."""
    if distance < velocity**2 / acceleration:
        return 2.0 * np.sqrt(distance / acceleration)
    return distance / velocity + velocity / acceleration


@given(polylines, blends)
@settings(max_examples=60)
def test_every_polyline_is_timed_from_rest_to_rest_within_the_limits(points, blend_rad):
    trajectory = time_path(points, NAMES, LIMITS, blend_rad)
    assert trajectory is not None
    assert_well_formed(trajectory)
    assert_from_rest_to_rest(trajectory, points[0], points[-1])
    assert_keeps_rates(trajectory, LIMITS)


@given(st.tuples(*[coordinates] * 3).map(np.array))
def test_straight_motion_takes_the_least_time_of_its_slowest_joint(goal):
    points = np.array([np.zeros(3), goal])
    trajectory = time_path(points, NAMES, LIMITS, 0.0)
    # Joints keep to the line, so the tightest velocity and acceleration may be those of different joints.
    share = np.maximum(np.abs(goal), 1e-12)
    bound_s = least_time_s(1.0, np.min(LIMITS.velocity_rad_s / share), np.min(LIMITS.acceleration_rad_s2 / share))
    assert trajectory.duration_s == pytest.approx(bound_s, rel=1e-6, abs=SHORTEST_INTERVAL_S)


@pytest.mark.parametrize("distance_rad", [1e-7, 1e-6, 1e-5, 1e-3])
def test_tiny_moves_are_timed_and_end_exactly(distance_rad):
    points = np.array([[0.1, 0.2, 0.3], [0.1 + distance_rad, 0.2, 0.3]])
    trajectory = time_path(points, NAMES, LIMITS, 0.3)
    assert_well_formed(trajectory)
    assert_from_rest_to_rest(trajectory, *points)
    assert 0.0 < trajectory.duration_s < 0.05


@pytest.mark.parametrize("count", [1, 2, 5])
def test_no_move_is_one_sample_at_time_zero(count):
    trajectory = time_path(np.ones((count, 3)), NAMES, LIMITS, 0.3)
    assert_well_formed(trajectory)
    assert trajectory.duration_s == 0.0
    np.testing.assert_array_equal(trajectory.positions_rad, np.ones((1, 3)))


@pytest.mark.parametrize("blend_rad", [0.0, 0.3])
def test_samples_are_ten_milliseconds_apart(blend_rad):
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], [1.0, -1.0, 1.0]])
    spacing_s = np.diff(time_path(points, NAMES, LIMITS, blend_rad).time_s)
    assert spacing_s.max() <= 1.1 * (SAMPLE_PERIOD_S + SHORTEST_INTERVAL_S)
    assert spacing_s.min() >= SHORTEST_INTERVAL_S


def test_without_blends_the_motion_stops_in_every_corner():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], [1.0, -1.0, 1.0], [0.0, 0.0, 0.0]])
    trajectory = time_path(points, NAMES, LIMITS, 0.0)
    for corner in points[1:-1]:
        at = np.argmin(np.linalg.norm(trajectory.positions_rad - corner, axis=1))
        np.testing.assert_allclose(trajectory.positions_rad[at], corner, atol=1e-9)
        np.testing.assert_allclose(trajectory.velocities_rad_s[at], 0.0, atol=1e-9)


def test_rounded_corners_save_time():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], [1.2, 1.0, 1.0]])
    durations_s = [time_path(points, NAMES, LIMITS, blend).duration_s for blend in (0.0, 0.075, 0.3)]
    assert durations_s == sorted(durations_s, reverse=True)
    assert durations_s[-1] < 0.9 * durations_s[0]


def test_lower_limits_make_a_slower_motion_that_keeps_them():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], [1.2, 1.0, 1.0]])
    slow = RateLimits(0.3 * LIMITS.velocity_rad_s, 0.3 * LIMITS.acceleration_rad_s2)
    trajectory = time_path(points, NAMES, slow, 0.3)
    assert_keeps_rates(trajectory, slow)
    assert trajectory.duration_s > 1.8 * time_path(points, NAMES, LIMITS, 0.3).duration_s


def test_the_last_point_is_reached_exactly_even_right_after_a_near_one():
    goal = np.array([1.2, 1.0, 1.0])
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], goal + 5e-10, goal])
    np.testing.assert_array_equal(time_path(points, NAMES, LIMITS, 0.3).positions_rad[-1], goal)


def test_repeated_points_change_nothing():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], [1.2, 1.0, 1.0]])
    repeated = np.repeat(points, 3, axis=0)
    expected, got = (time_path(p, NAMES, LIMITS, 0.3) for p in (points, repeated))
    np.testing.assert_array_equal(got.positions_rad, expected.positions_rad)
    np.testing.assert_array_equal(got.time_s, expected.time_s)

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from planners.motions import curve as curves
from planners.motions.curve import TICK_S, Curve, averaged, from_moving, line, polyline, same_point, window_ticks
from planners.problem import RateLimits
from tests.helpers.resources import examples
from tests.planners.invariants import (
    assert_from_rest_to_rest,
    assert_keeps_rates,
    assert_well_formed,
    least_time_of_line_s,
)

NAMES = ("a", "b")
LIMITS = RateLimits(np.array([2.0, 1.2]), np.array([6.0, 3.0]), np.array([60.0, 50.0]))
ZIGZAG = np.array([[0.0, 0.0], [1.0, 0.5], [0.2, 0.9]])


def test_samples_are_ten_milliseconds_apart_at_most_and_repeat_the_curve_whose_parts_can_be_replaced():
    curve = polyline(ZIGZAG, LIMITS)
    trajectory = curve.sampled(NAMES)
    assert_well_formed(trajectory)
    spacing_s = np.diff(trajectory.time_s)
    assert 0.9 * TICK_S < spacing_s.min() < spacing_s.max() < 0.0112
    ticks = np.arange(1, curve.duration_ticks, 37)
    positions, velocities, _ = curve.at(ticks)
    samples = [trajectory.sample(TICK_S * tick) for tick in ticks]
    np.testing.assert_allclose([position for position, _, _ in samples], positions, atol=1e-10)
    np.testing.assert_allclose([velocity for _, velocity, _ in samples], velocities, atol=1e-8)
    same = curve.replaced(1000, 5000, curve.part(1000, 5000))
    np.testing.assert_allclose(same.at(ticks)[0], positions, atol=1e-12)
    assert same.duration_ticks == curve.duration_ticks
    moved = curve.part(100, curve.duration_ticks)
    moved.positions_rad[-1] += 1e-13
    np.testing.assert_array_equal(curve.replaced(100, curve.duration_ticks, moved).positions_rad[-1], ZIGZAG[-1])


def test_turning_points_between_knots_count_for_the_range_and_a_joint_that_would_overshoot_takes_no_time_between():
    # Thrown up at 1 rad/s and braked at 2 rad/s^2 it turns 0.25 rad higher, where no knot is.
    thrown = Curve(np.array([0, 10000]), np.zeros((2, 1)), np.array([[1.0], [-1.0]]))
    for lower, upper, within in ((-0.01, 0.2501, True), (-0.01, 0.2499, False), (0.01, 1.0, False)):
        assert thrown.stays_within(np.array([lower]), np.array([upper])) == within
    # Moving at 1 rad/s it is there at once or, turning back twice, much later.
    p0, p1, v = np.zeros(1), np.array([0.1]), np.array([1.0])
    limits = RateLimits(np.array([3.0]), np.array([1.0]))
    possible = [bool(way_of(p0, v, p1, v, np.array(ticks), limits).possible.all()) for ticks in (1000, 4000, 60000)]
    assert possible == [True, False, True]


START, GOAL = np.array([0.1, -0.3]), np.array([1.0, 0.5])
MOVING = np.array([0.7, -0.4])


def assert_keeps_rates_and_jerk(trajectory):
    assert_keeps_rates(trajectory, LIMITS)
    accelerations = np.array([trajectory.sample(t)[2] for t in np.arange(0.0, trajectory.duration_s, 0.001)])
    np.testing.assert_allclose(accelerations[0], 0.0, atol=1e-9)
    assert np.all(np.abs(np.diff(accelerations, axis=0)) <= 0.001 * LIMITS.jerk_rad_s3 * 1.001 + 1e-6)


def test_averaged_curves_keep_all_limits_and_meet_a_moving_start_in_position_and_velocity():
    window = window_ticks(LIMITS)
    for points in ([START, GOAL], [START, GOAL, [0.2, 0.9]]):
        trajectory = averaged(polyline(np.array(points), LIMITS), window, NAMES)
        assert_well_formed(trajectory)
        assert_from_rest_to_rest(trajectory, points[0], points[-1])
        assert_keeps_rates_and_jerk(trajectory)
        share = (trajectory.positions_rad - START) / (GOAL - START)
        # A straight line stays straight.
        assert len(points) > 2 or np.abs(share[:, 0] - share[:, 1]).max() < 1e-9
    start = curves.averaging_start(START, MOVING, window)
    trajectory = averaged(from_moving(start, MOVING, GOAL, LIMITS), window, NAMES)
    np.testing.assert_allclose(trajectory.positions_rad[0], START, atol=1e-12)
    np.testing.assert_allclose(trajectory.velocities_rad_s[0], MOVING, atol=1e-12)
    assert_keeps_rates_and_jerk(trajectory)


ABC = ("a", "b", "c")
ABC_LIMITS = RateLimits(np.array([2.0, 1.2, 1.6]), np.array([6.0, 3.0, 5.0]))

points = st.tuples(*[st.floats(-2.0, 2.0, allow_nan=False).map(lambda value: round(value, 6))] * 3).map(np.array)
velocities = st.tuples(*[st.floats(-0.99, 0.99)] * 3).map(lambda share: np.array(share) * ABC_LIMITS.velocity_rad_s)


@given(st.lists(points, min_size=1, max_size=6).map(np.array))
@examples(60)
def test_every_polyline_is_timed_from_rest_to_rest_within_the_limits_and_repeated_points_change_nothing(corners):
    curve = polyline(corners, ABC_LIMITS)
    trajectory = curve.sampled(ABC)
    assert_well_formed(trajectory)
    if not same_point(corners[0], corners[-1]):
        assert_from_rest_to_rest(trajectory, corners[0], corners[-1])
    assert_keeps_rates(trajectory, ABC_LIMITS)
    repeated = polyline(np.repeat(corners, 3, axis=0), ABC_LIMITS)
    np.testing.assert_array_equal(repeated.positions_rad, curve.positions_rad)
    np.testing.assert_array_equal(repeated.ticks, curve.ticks)
    # A polyline stops in every corner, and waits there.
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], [1.0, -1.0, 1.0]])
    stopping, waiting = (polyline(corners, ABC_LIMITS, wait) for wait in (0, 300))
    assert waiting.duration_ticks == stopping.duration_ticks + 300
    at_corner = np.flatnonzero(np.all(waiting.positions_rad == corners[1], axis=1))
    np.testing.assert_array_equal(waiting.velocities_rad_s[at_corner], np.zeros((2, 3)))


@given(points)
def test_a_line_takes_the_least_time_of_its_tightest_joint_and_a_tiny_one_ends_exactly(goal):
    if not same_point(goal, np.zeros(3)):
        duration_s = TICK_S * line(np.zeros(3), goal, ABC_LIMITS).duration_ticks
        bound_s = least_time_of_line_s(goal, ABC_LIMITS)
        assert bound_s - 1e-9 <= duration_s <= bound_s + 3.0 * TICK_S
    for distance_rad in (1e-7, 1e-6, 1e-5, 1e-3):
        end = goal + np.array([distance_rad, 0.0, 0.0])
        trajectory = line(goal, end, ABC_LIMITS).sampled(ABC)
        assert_well_formed(trajectory)
        assert_from_rest_to_rest(trajectory, goal, end)
        assert 0.0 < trajectory.duration_s < 0.05, distance_rad


@given(points, velocities, points)
@examples(100)
def test_a_moving_start_is_left_smoothly_and_each_joint_comes_to_rest_as_soon_as_it_can(start, velocity, goal):
    curve = from_moving(start, velocity, goal, ABC_LIMITS)
    if curve is not None:
        np.testing.assert_array_equal(curve.positions_rad[[0, -1]], [start, goal])
        np.testing.assert_array_equal(curve.velocities_rad_s[[0, -1]], [velocity, np.zeros(3)])
        assert_keeps_rates(curve.sampled(ABC), ABC_LIMITS)
    curve = curves.brake(start, velocity, ABC_LIMITS)
    np.testing.assert_array_equal(curve.velocities_rad_s[[0, -1]], [velocity, np.zeros(3)])
    assert_keeps_rates(curve.sampled(ABC), ABC_LIMITS)
    nearest = start + 0.5 * velocity * np.abs(velocity) / ABC_LIMITS.acceleration_rad_s2
    assert np.all(np.abs(curve.positions_rad[-1] - nearest) <= TICK_S * ABC_LIMITS.velocity_rad_s)


def way_of(p0, v0, p1, v1, ticks, limits):
    return curves.Ways(*(each[np.newaxis] for each in (p0, v0, p1, v1, ticks)), limits)


@given(points, velocities, points, velocities)
@examples(200)
def test_ramps_join_two_states_within_the_limits(p0, v0, p1, v1):
    least_s = curves.least_time_s(p0, v0, p1, v1, curves.reduced(ABC_LIMITS))
    way = way_of(p0, v0, p1, v1, curves.whole_ticks(least_s), ABC_LIMITS)
    assume(way.possible.all())
    curve = way.curve(0)
    velocities, steps_s = curve.velocities_rad_s, TICK_S * np.diff(curve.ticks)[:, None]
    shares = np.array([0.5, 0.25, 0.875])
    np.testing.assert_allclose(
        way.places(np.zeros(1, int), shares)[0], curve.at(shares * curve.duration_ticks)[0], atol=1e-9
    )
    np.testing.assert_array_equal(curve.positions_rad[[0, -1]], [p0, p1])
    np.testing.assert_array_equal(velocities[[0, -1]], [v0, v1])
    assert np.all(np.abs(np.diff(velocities, axis=0)) <= steps_s * ABC_LIMITS.acceleration_rad_s2 * (1.0 + 1e-6))
    assert np.all(np.abs(velocities) <= ABC_LIMITS.velocity_rad_s * (1.0 + 1e-6))
    way_rad = 0.5 * (velocities[1:] + velocities[:-1]) * steps_s
    np.testing.assert_allclose(np.diff(curve.positions_rad, axis=0), way_rad, atol=1e-9)

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from planners.motions.curve import TICK_S, connect, least_time_s, reduced, whole_ticks
from planners.problem import RateLimits
from tests.helpers.resources import examples

LIMITS = RateLimits(np.array([3.0, 2.0, 1.5]), np.array([10.0, 5.0, 8.0]))

positions = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)
shares = st.tuples(*[st.floats(-0.99, 0.99)] * 3).map(np.array)


def accelerations(curve):
    return np.diff(curve.velocities_rad_s, axis=0) / (TICK_S * np.diff(curve.ticks))[:, None]


@given(positions, shares, positions, shares)
@examples(200)
def test_ramps_join_two_states_within_the_limits(p0, v0, p1, v1):
    v0, v1 = v0 * LIMITS.velocity_rad_s, v1 * LIMITS.velocity_rad_s
    curve = connect(p0, v0, p1, v1, int(whole_ticks(least_time_s(p0, v0, p1, v1, reduced(LIMITS)))), LIMITS)
    assume(curve is not None)
    np.testing.assert_array_equal(curve.positions_rad[[0, -1]], [p0, p1])
    np.testing.assert_array_equal(curve.velocities_rad_s[[0, -1]], [v0, v1])
    assert np.all(np.abs(accelerations(curve)) <= LIMITS.acceleration_rad_s2 * (1.0 + 1e-6))
    assert np.all(np.abs(curve.velocities_rad_s) <= LIMITS.velocity_rad_s * (1.0 + 1e-6))
    mean = 0.5 * (curve.velocities_rad_s[1:] + curve.velocities_rad_s[:-1])
    np.testing.assert_allclose(
        np.diff(curve.positions_rad, axis=0), mean * (TICK_S * np.diff(curve.ticks))[:, None], atol=1e-9
    )


@given(positions, positions)
def test_from_rest_to_rest_there_are_always_ramps(p0, p1):
    rest = np.zeros(3)
    ticks = int(whole_ticks(least_time_s(p0, rest, p1, rest, reduced(LIMITS))))
    assert connect(p0, rest, p1, rest, ticks, LIMITS) is not None
    assert connect(p0, rest, p1, rest, 3 * ticks, LIMITS) is not None


def test_nearly_all_states_are_joined_in_the_least_time():
    rng = np.random.default_rng(3)
    found = []
    for p0, p1, v0, v1 in rng.uniform(-0.9, 0.9, (500, 4, 1)):
        limits = RateLimits(np.array([2.0]), np.array([5.0]))
        v0, v1 = 2.0 * v0, 2.0 * v1
        ticks = int(whole_ticks(least_time_s(p0, v0, p1, v1, reduced(limits))))
        found.append(connect(p0, v0, p1, v1, ticks, limits) is not None)
    # The rest would go straight from one velocity to the other and cannot take even a tick more.
    assert np.mean(found) > 0.97


def test_nothing_is_faster_than_the_least_time():
    rng = np.random.default_rng(4)
    for _ in range(300):
        p0, p1 = rng.uniform(-1.0, 1.0, (2, 3))
        v0, v1 = rng.uniform(-0.9, 0.9, (2, 3)) * LIMITS.velocity_rad_s
        ticks = int(least_time_s(p0, v0, p1, v1, LIMITS) / TICK_S)
        assert connect(p0, v0, p1, v1, int(0.98 * ticks), LIMITS) is None


@pytest.mark.parametrize(("distance", "expected_s"), [(0.1, 2.0 * np.sqrt(0.01)), (3.0, 1.3)])
def test_least_time_from_rest_to_rest_is_that_of_a_triangle_or_a_trapezoid(distance, expected_s):
    limits = RateLimits(np.array([3.0]), np.array([10.0]))
    time_s = least_time_s(np.zeros(1), np.zeros(1), np.array([distance]), np.zeros(1), limits)
    assert time_s == pytest.approx(expected_s)


def test_least_times_of_many_parts_come_at_once():
    rng = np.random.default_rng(1)
    p0, v0, p1, v1 = rng.uniform(-1.0, 1.0, (4, 9, 3))
    together = least_time_s(p0, v0, p1, v1, LIMITS)
    assert together.shape == (9,)
    alone = [least_time_s(p0[i], v0[i], p1[i], v1[i], LIMITS) for i in range(9)]
    np.testing.assert_array_equal(together, alone)


def test_a_joint_that_would_overshoot_cannot_take_a_time_between():
    # Moving at 1 rad/s it is there at once or, turning back twice, much later.
    p0, p1, v = np.zeros(1), np.array([0.1]), np.array([1.0])
    limits = RateLimits(np.array([3.0]), np.array([1.0]))
    assert connect(p0, v, p1, v, 1000, limits) is not None
    assert connect(p0, v, p1, v, 4000, limits) is None
    assert connect(p0, v, p1, v, 60000, limits) is not None

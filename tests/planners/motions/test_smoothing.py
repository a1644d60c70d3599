import numpy as np
import pytest

from planners.motions.curve import TICK_S
from planners.motions.ramps import least_time_s
from planners.motions.smoothing import smooth
from planners.motions.timing import polyline
from planners.rates import RateLimits
from tests.planners.invariants import assert_from_rest_to_rest, assert_keeps_rates, never

NAMES = ("a", "b")
LIMITS = RateLimits(np.array([3.0, 2.0]), np.array([10.0, 6.0]))
DETOUR = np.array([[0.0, 0.0], [1.0, -0.5], [1.2, 0.8], [0.4, 1.0]])


def anywhere(piece):
    return True


def outside_the_disc(piece):
    """Nothing may come nearer than 0.4 to a point beside the detour."""
    points = piece.at(np.linspace(0, piece.duration_ticks, 60))[0]
    return bool(np.all(np.linalg.norm(points - (0.6, 0.4), axis=1) > 0.4))


def shortened(free=anywhere, seed=0, should_stop=never):
    return smooth(polyline(DETOUR, LIMITS), LIMITS, free, np.random.default_rng(seed), should_stop)


@pytest.mark.parametrize("seed", range(5))
def test_a_shortened_curve_keeps_ends_and_limits(seed):
    trajectory = shortened(outside_the_disc, seed).sampled(NAMES)
    assert_from_rest_to_rest(trajectory, DETOUR[0], DETOUR[-1])
    assert_keeps_rates(trajectory, LIMITS)


@pytest.mark.parametrize("seed", range(5))
def test_a_shortened_curve_consists_of_free_pieces(seed):
    assert outside_the_disc(polyline(DETOUR, LIMITS))
    curve = shortened(outside_the_disc, seed)
    assert outside_the_disc(curve)
    assert curve.duration_ticks < 0.8 * polyline(DETOUR, LIMITS).duration_ticks


def test_where_everything_is_free_nearly_the_least_time_is_left():
    least_s = least_time_s(DETOUR[0], np.zeros(2), DETOUR[-1], np.zeros(2), LIMITS)
    assert TICK_S * shortened().duration_ticks < 1.03 * least_s


def test_a_moving_start_keeps_its_velocity():
    whole = polyline(DETOUR, LIMITS)
    moving = whole.part(1500, whole.duration_ticks)
    curve = smooth(moving, LIMITS, anywhere, np.random.default_rng(0), never)
    np.testing.assert_array_equal(curve.velocities_rad_s[0], moving.velocities_rad_s[0])
    assert moving.velocities_rad_s[0].any()
    assert curve.duration_ticks < moving.duration_ticks


def test_where_nothing_is_free_the_curve_stays():
    curve = shortened(lambda piece: False)
    np.testing.assert_array_equal(curve.positions_rad, polyline(DETOUR, LIMITS).positions_rad)


def test_the_same_seed_gives_the_same_curve():
    first, again = shortened(seed=3), shortened(seed=3)
    np.testing.assert_array_equal(first.positions_rad, again.positions_rad)
    np.testing.assert_array_equal(first.ticks, again.ticks)


def test_shortening_stops_when_asked_to():
    assert shortened(should_stop=lambda: True).duration_ticks == polyline(DETOUR, LIMITS).duration_ticks

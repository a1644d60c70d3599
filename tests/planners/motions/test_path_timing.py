import os
import sys
from pathlib import Path

import numpy as np
import pytest
import toppra
import toppra.algorithm
import toppra.constraint
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from planners.motions.path_timing import time_along, toppra_profile, within_limits
from planners.motions.spline import NaturalSpline
from planners.problem import RateLimits
from robot.trajectory import Trajectory
from tests.helpers.programs import run
from tests.helpers.resources import examples
from tests.planners.invariants import (
    assert_from_rest_to_rest,
    assert_keeps_rates,
    assert_well_formed,
    fine_samples,
    least_time_of_line_s,
)

NAMES = ("a", "b", "c")
LIMITS = RateLimits(np.array([2.0, 1.2, 1.6]), np.array([6.0, 3.0, 5.0]))


@given(st.floats(0.01, 10.0), st.floats(0.01, 10.0))
def test_a_motion_is_slowed_down_until_it_keeps_its_limits_between_samples(velocity, acceleration):
    positions = np.array([[0.0], [0.3], [0.2]])
    motion = Trajectory(("a",), np.array([0.0, 0.1, 0.2]), positions, np.zeros((3, 1)), np.zeros((3, 1)))
    limits = RateLimits(np.array([velocity]), np.array([acceleration]))
    slowed = within_limits(motion, limits)
    assert_keeps_rates(slowed, limits)
    assert slowed.duration_s >= motion.duration_s


coordinates = st.floats(-1.0, 1.0).map(lambda value: round(value, 3))
polylines = (
    st.lists(st.tuples(*[coordinates] * 3), min_size=2, max_size=8)
    .map(np.array)
    .filter(lambda points: np.linalg.norm(np.diff(points, axis=0), axis=1).min() > 0.0)
)


def spline(points):
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return NaturalSpline(np.concatenate(([0.0], np.cumsum(lengths))), points)


def straight(*goal, points=9):
    return np.linspace(0.0, 1.0, points)[:, np.newaxis] * np.array(goal)


def test_a_motion_that_would_take_too_long_is_not_sampled() -> None:
    slow = RateLimits(LIMITS.velocity_rad_s, 1e-9 * LIMITS.acceleration_rad_s2)
    assert time_along(spline(straight(1.0, 0.5, -0.5)), NAMES, slow) is None


@given(polylines, st.floats(0.05, 1.0))
@examples(60)
def test_every_curve_is_timed_from_rest_to_rest_within_the_limits_and_a_top_rate_is_kept(points, top_rate):
    path = spline(points)
    motion = time_along(path, NAMES, LIMITS)
    assert motion is not None
    assert_well_formed(motion)
    assert_from_rest_to_rest(motion, points[0], points[-1])
    assert_keeps_rates(motion, LIMITS)
    profile = toppra_profile(path, LIMITS, np.full(len(path.grid), top_rate))
    assert profile.rate.max() <= top_rate * (1.0 + 1e-6)


@given(polylines)
@examples(20)
def test_the_motion_stays_on_the_curve(points):
    path = spline(points)
    along = path(np.linspace(0.0, path.knots[-1], 1000))
    positions, _, _ = fine_samples(time_along(path, NAMES, LIMITS), per_interval=3)
    off = [np.min(np.linalg.norm(along - position, axis=1)) for position in positions[::25]]
    spacing = np.linalg.norm(np.diff(along, axis=0), axis=1).max()
    assert max(off) < 0.5 * spacing + 1e-4


@given(st.tuples(*[coordinates] * 3).map(np.array).filter(lambda goal: np.abs(goal).max() > 0.01))
def test_a_straight_line_takes_the_least_time_there_is(goal):
    motion = time_along(spline(straight(*goal)), NAMES, LIMITS)
    bound_s = least_time_of_line_s(goal, LIMITS)
    assert bound_s - 1e-9 <= motion.duration_s <= 1.03 * bound_s


@pytest.mark.parametrize("points", [4, 16, 64])
def test_a_stretch_where_no_joint_moves_hardly_takes_time(points):
    moving = straight(1.0, 0.5, 0.0, points=16)
    path = NaturalSpline(np.arange(16.0 + points), np.vstack((moving, np.tile(moving[-1], (points, 1)))))
    alone_s = time_along(NaturalSpline(np.arange(16.0), moving), NAMES, LIMITS).duration_s
    motion = time_along(path, NAMES, LIMITS)
    assert_keeps_rates(motion, LIMITS)
    assert motion.duration_s < 1.5 * alone_s


OUT = np.cumsum(0.03 ** np.arange(7))[:, np.newaxis] * np.array([1.0, 0.5, -0.2])


def test_a_path_without_any_timing_or_that_toppra_cannot_time_has_none(monkeypatch):
    assert toppra_profile(NaturalSpline(np.array([0.0, 1.0, 2.0]), np.zeros((3, 3))), LIMITS) is None
    # The arm could not leave the bend of this path.
    assert toppra_profile(spline(np.vstack((OUT, OUT[-2::-1]))), LIMITS) is None
    line = spline(straight(1.0, 1.0, 1.0, points=2))
    assert toppra_profile(line, RateLimits(np.ones(3), np.full(3, np.nan))) is None
    for rate in (None, np.full(21, np.nan)):
        untimed = (None, rate, None)
        monkeypatch.setattr(toppra.algorithm.TOPPRA, "compute_parameterization", lambda *_, untimed=untimed: untimed)
        assert toppra_profile(line, LIMITS) is None


def test_no_warning_is_shown_where_toppra_is_compiled(tmp_path: Path) -> None:
    """As at the first start after an installation that compiles nothing, and at each where nothing can be kept."""
    program = [sys.executable, "-W", "always", "-c", "import planners.motions.path_timing"]
    done = run(*program, env={**os.environ, "PYTHONPYCACHEPREFIX": str(tmp_path)}, check=True)
    assert "toppra" not in done.stderr


@pytest.mark.parametrize("count", [2, 3, 4, 5, 8, 37, 400])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_the_curve_is_the_natural_cubic_spline(count, order):
    rng = np.random.default_rng(count)
    knots = np.cumsum(rng.uniform(0.01, 1.0, count))
    points = rng.normal(size=(count, 6))
    at = np.concatenate((knots, rng.uniform(knots[0] - 0.1, knots[-1] + 0.1, 200)))
    expected = CubicSpline(knots, points, bc_type="natural")(at, order)
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(NaturalSpline(knots, points)(at, order), expected, atol=1e-9 * scale)

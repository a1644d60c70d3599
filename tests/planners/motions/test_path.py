"""Paths and their timing."""

import os
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import toppra
import toppra.algorithm
import toppra.constraint
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from planners.geometry.joint_space import JointSpace
from planners.goals import Constraints, OrientationConstraint
from planners.ik.constraints import ConditionSet, conditions
from planners.motions import path as paths
from planners.motions.curve import line, polyline
from planners.motions.path import ConnectSearch, Query, TreeSearch, curve_free, via_point, without_detours
from planners.motions.path_timing import time_along, toppra_profile, within_limits
from planners.motions.spline import NaturalSpline
from planners.problem import PLANNER_IDS, RateLimits
from robot.trajectory import Trajectory
from tests.helpers.programs import run
from tests.helpers.resources import examples
from tests.planners import invariants

HOME = np.zeros(5)
READY = np.array([0.0, -0.5, 0.5, 0.0, 0.0])
BLOCKED = np.array(invariants.BLOCKED_LINES)
STEP_M = 0.005


def after(space, checks):
    """Stop after a number of checks."""
    most = space.checks + checks
    return lambda: space.checks >= most


def connect(query, seed=0, should_stop=invariants.never, project=None):
    return ConnectSearch(query, project, seed).run(should_stop)


@pytest.mark.parametrize("name", PLANNER_IDS)
def test_every_planner_finds_a_free_path_from_start_to_goal_and_the_same_by_the_same_seed(joint_space, name):
    start, goal = BLOCKED[1]
    asked = Query(joint_space, start, [goal], STEP_M)

    def search(seed):
        tree = ConnectSearch(asked, None, seed) if name == "RRTConnect" else TreeSearch(asked, name, seed)
        return tree.run(after(joint_space, 6000))

    seed, path = next((seed, path) for seed in range(5) if (path := search(seed)) is not None)
    np.testing.assert_array_equal(search(seed), path)
    np.testing.assert_array_equal(path[[0, -1]], [start, goal])
    shorter = without_detours(joint_space, path, STEP_M)
    np.testing.assert_array_equal(shorter[[0, -1]], path[[0, -1]])
    assert 2 < len(shorter) <= len(path)
    for each in (path, shorter):
        assert all(paths.line_free_sparsely(joint_space, *edge, STEP_M) for edge in pairwise(each))
    assert np.all((path >= joint_space.lower_rad) & (path <= joint_space.upper_rad))


def test_search_ends_at_one_of_several_goals_or_soon_after_it_is_asked_to(joint_space):
    for start, goal in BLOCKED:
        goals = [goal, goal + 0.01]
        path = connect(Query(joint_space, start, goals, STEP_M), 3)
        assert any(np.array_equal(path[-1], each) for each in goals)
    # A goal in collision can never be reached.
    inside, asked = np.array([0.0, -1.745, 1.69, 1.0, 0.0]), iter(range(20))
    assert connect(Query(joint_space, HOME, [inside], STEP_M), 0, lambda: next(asked, None) is None) is None


DETOUR = np.array([HOME, [0.5, -0.2, 0.3, 0.1, 0.0], [-0.4, -0.6, 0.2, 0.0, 0.3], [0.3, 0.1, 0.4, 0.0, 0.0], READY])
LIMITS = RateLimits(np.full(5, 3.0), np.full(5, 10.0))


def test_detours_that_a_free_line_passes_by_are_left_out_and_lines_and_curves_blocked_by_the_arm_itself(joint_space):
    without_detours(joint_space, DETOUR[:2], STEP_M)
    # The edges of a path are known to be free.
    assert joint_space.checks == 0
    np.testing.assert_array_equal(without_detours(joint_space, DETOUR, STEP_M), [HOME, READY])
    np.testing.assert_array_equal(without_detours(joint_space, DETOUR, STEP_M, lambda: True), DETOUR)
    assert curve_free(joint_space, line(HOME, READY, LIMITS), STEP_M)
    assert not curve_free(joint_space, line(HOME, READY, LIMITS), STEP_M, lambda: True)
    begun = joint_space.checks
    assert not curve_free(joint_space, line(HOME, READY, LIMITS), STEP_M, after(joint_space, 20)), "stopped on the way"
    assert joint_space.checks <= begun + 20 + paths.CHECKS_A_POLL
    assert paths.line_free_sparsely(joint_space, HOME, READY, STEP_M)
    for start, goal in BLOCKED:
        assert not curve_free(joint_space, line(start, goal, LIMITS), STEP_M)
        assert not curve_free(joint_space, polyline(np.array([READY, start, goal]), LIMITS), STEP_M)
        assert not paths.line_free_sparsely(joint_space, start, goal, STEP_M)
    # Nor is a curve free that leaves a joint's range.
    beyond = READY.copy()
    beyond[0] = joint_space.upper_rad[0] + 0.01
    assert not curve_free(joint_space, line(READY, beyond, LIMITS), STEP_M)


def test_every_piece_of_a_line_is_looked_at_once_and_its_end_first_and_a_curve_is_free_if_it_is_at_steps():
    for pieces in (1, 2, 3, 7, 16):
        shares = paths.coarse_first(pieces).ravel()
        assert shares[0] == 1.0
        assert sorted(shares) == pytest.approx(np.arange(1, pieces + 1) / pieces)
    # In the way is a wire thinner than the gaps between a curve's first samples.
    square = Walled()
    square.free = lambda point: abs(point[0] - 0.13) > 0.006
    for end, step_m, is_free in ((EAST, 0.01, False), (EAST, 0.5, True), (MIDDLE, 0.01, True)):
        assert curve_free(square, line(WEST, end, RateLimits(np.ones(2), np.ones(2))), step_m) == is_free


TIP = "gripper_frame_link"
# The gripper points down within 6 degrees.
DOWN = Constraints(orientations=(OrientationConstraint(TIP, (1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 3.2)),))
LEFT, RIGHT = np.array([0.8, 0.0, 0.0, 1.57, 0.0, 0.0]), np.array([-0.8, 0.3, 0.0, 1.27, 0.0, 0.0])


def test_path_leads_from_start_to_goal_where_the_condition_holds_unless_stopped(goal_states, collision, arm):
    holds = ConditionSet(goal_states.forward, conditions(DOWN, collision)).holds
    start, goal = (goal_states.projection(arm, DOWN, q)(q[:5]) for q in (LEFT, RIGHT))
    space = JointSpace(collision, arm.joints, np.zeros(6), holds=holds)
    query, project = Query(space, start, [goal], 0.02), goal_states.projection(arm, DOWN, np.zeros(6))
    path = connect(query, 1, project=project)
    np.testing.assert_array_equal(path, connect(query, 1, project=project))
    np.testing.assert_array_equal(path[[0, -1]], [start, goal])
    for first, last in pairwise(path):
        assert all(holds(np.append(first + u * (last - first), 0.0)) for u in (0.0, 0.5, 1.0))
    assert connect(query, 1, lambda: True, project) is None
    asked = iter(range(50))
    assert connect(query, 1, lambda: next(asked, None) is None, lambda _: None) is None


WALL_STEP_M = 0.1


class Walled:
    """A square that a wall at x = 0 divides but for a gap, as far as a search needs it."""

    lower_rad, upper_rad = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    travel_m_per_rad = np.ones(2)

    def __init__(self, *gap):
        self.gap = gap
        self.checks = 0

    def free(self, point):
        self.checks += 1
        return abs(point[0]) > 0.1 or self.gap[0] < point[1] < self.gap[1]


class WalledRoom(Walled):
    """As the square, with four more axes along which nothing is in the way."""

    lower_rad, upper_rad, travel_m_per_rad = -np.ones(6), np.ones(6), np.ones(6)


WEST, MIDDLE, EAST = np.array([[-0.8, 0.0], [0.1, 0.0], [0.8, 0.0]])


def test_points_amid_steps_halve_the_steps_that_a_search_checks():
    checked = []

    class Recorded(Walled):
        def free(self, point):
            checked.append(point[0])
            return True

    space = Recorded()
    assert paths.line_free_sparsely(space, WEST, EAST, 0.11)
    between = paths.amid_steps(space, WEST, EAST, 0.11)[:, 0]
    np.testing.assert_allclose(sorted([*checked, *between]), np.linspace(-0.8, 0.8, 31)[1:])


def test_a_narrow_gap_takes_fewer_checks_where_blocked_points_only_go_to_points_nearby(monkeypatch):
    monkeypatch.setattr(paths, "TREE_EDGE_M", 0.6)
    start, goal = (np.append(point, np.zeros(4)) for point in (WEST, EAST))

    def checks(edges):
        monkeypatch.setattr(paths, "DOMAIN_EDGES", edges)
        spaces = [WalledRoom(0.6, 0.7) for _ in range(10)]
        for seed, space in enumerate(spaces):
            path = connect(Query(space, start, [goal], WALL_STEP_M), seed, after(space, 20_000))
            np.testing.assert_array_equal(path[[0, -1]], [start, goal])
        return sum(space.checks for space in spaces)

    assert checks(paths.DOMAIN_EDGES) < 0.7 * checks(np.inf)


def way(space, should_stop=invariants.never):
    asked = Query(space, WEST, [EAST], WALL_STEP_M)
    return via_point(asked, np.array([1.0, 1.0]), np.random.default_rng(0), should_stop)


def test_the_path_leads_through_the_gap_or_the_search_gives_up_after_some_checks():
    path = way(Walled(0.3, 0.9))
    np.testing.assert_array_equal(path[[0, 2]], [WEST, EAST])
    shares = np.linspace(0.0, 1.0, 200)[:, np.newaxis]
    on_it = np.concatenate([first + shares * (last - first) for first, last in pairwise(path)])
    # Between two points that were checked the path may be a step deep in the wall.
    wider = Walled(0.3 - WALL_STEP_M, 0.9 + WALL_STEP_M)
    assert all(wider.free(point) or abs(point[0]) > 0.1 - WALL_STEP_M for point in on_it)
    space = Walled(2.0, 2.0)
    assert way(space) is None
    one_line = np.ceil(4.0 / WALL_STEP_M)
    assert paths.MOST_CHECKS <= space.checks < paths.MOST_CHECKS + one_line
    space = Walled(0.3, 0.9)
    assert (way(space, lambda: True), space.checks) == (None, 0)


NAMES = ("a", "b", "c")
TIMING_LIMITS = RateLimits(np.array([2.0, 1.2, 1.6]), np.array([6.0, 3.0, 5.0]))


@given(st.floats(0.01, 10.0), st.floats(0.01, 10.0))
def test_a_motion_is_slowed_down_until_it_keeps_its_limits_between_samples(velocity, acceleration):
    positions = np.array([[0.0], [0.3], [0.2]])
    motion = Trajectory(("a",), np.array([0.0, 0.1, 0.2]), positions, np.zeros((3, 1)), np.zeros((3, 1)))
    limits = RateLimits(np.array([velocity]), np.array([acceleration]))
    slowed = within_limits(motion, limits)
    invariants.assert_keeps_rates(slowed, limits)
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


@given(polylines, st.floats(0.05, 1.0))
@examples(60)
def test_every_curve_is_timed_and_followed_from_rest_to_rest_within_the_limits_and_a_top_rate(points, top_rate):
    path = spline(points)
    motion = time_along(path, NAMES, TIMING_LIMITS)
    assert motion is not None
    invariants.assert_well_formed(motion)
    invariants.assert_from_rest_to_rest(motion, points[0], points[-1])
    invariants.assert_keeps_rates(motion, TIMING_LIMITS)
    profile = toppra_profile(path, TIMING_LIMITS, np.full(len(path.grid), top_rate))
    assert profile.rate.max() <= top_rate * (1.0 + 1e-6)
    along = path(np.linspace(0.0, path.knots[-1], 1000))
    positions, _, _ = invariants.fine_samples(motion, per_interval=3)
    off = [np.min(np.linalg.norm(along - position, axis=1)) for position in positions[::25]]
    spacing = np.linalg.norm(np.diff(along, axis=0), axis=1).max()
    assert max(off) < 0.5 * spacing + 1e-4
    # One that would take too long is not sampled.
    slow = RateLimits(TIMING_LIMITS.velocity_rad_s, 1e-9 * TIMING_LIMITS.acceleration_rad_s2)
    assert time_along(path, NAMES, slow) is None


@given(st.tuples(*[coordinates] * 3).map(np.array).filter(lambda goal: np.abs(goal).max() > 0.01))
def test_a_straight_line_takes_the_least_time_and_a_stretch_where_no_joint_moves_hardly_any(goal):
    motion = time_along(spline(straight(*goal)), NAMES, TIMING_LIMITS)
    bound_s = invariants.least_time_of_line_s(goal, TIMING_LIMITS)
    assert bound_s - 1e-9 <= motion.duration_s <= 1.03 * bound_s
    moving = straight(1.0, 0.5, 0.0, points=16)
    alone_s = time_along(NaturalSpline(np.arange(16.0), moving), NAMES, TIMING_LIMITS).duration_s
    for points in (4, 16, 64):
        path = NaturalSpline(np.arange(16.0 + points), np.vstack((moving, np.tile(moving[-1], (points, 1)))))
        motion = time_along(path, NAMES, TIMING_LIMITS)
        invariants.assert_keeps_rates(motion, TIMING_LIMITS)
        assert motion.duration_s < 1.5 * alone_s


OUT = np.cumsum(0.03 ** np.arange(7))[:, np.newaxis] * np.array([1.0, 0.5, -0.2])


def test_a_path_without_any_timing_or_that_toppra_cannot_time_has_none(monkeypatch):
    assert toppra_profile(NaturalSpline(np.array([0.0, 1.0, 2.0]), np.zeros((3, 3))), TIMING_LIMITS) is None
    # The arm could not leave the bend of this path.
    assert toppra_profile(spline(np.vstack((OUT, OUT[-2::-1]))), TIMING_LIMITS) is None
    line = spline(straight(1.0, 1.0, 1.0, points=2))
    assert toppra_profile(line, RateLimits(np.ones(3), np.full(3, np.nan))) is None
    for rate in (None, np.full(21, np.nan)):
        untimed = (None, rate, None)
        monkeypatch.setattr(toppra.algorithm.TOPPRA, "compute_parameterization", lambda *_, untimed=untimed: untimed)
        assert toppra_profile(line, TIMING_LIMITS) is None


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

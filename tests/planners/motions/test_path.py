import itertools
from itertools import pairwise

import numpy as np
import pytest

from planners.geometry.joint_space import JointSpace
from planners.goals import Constraints, OrientationConstraint
from planners.ik.constraints import ConditionSet, conditions
from planners.motions import path as path_module
from planners.motions.curve import line, polyline
from planners.motions.path import (
    DOMAIN_EDGES,
    MOST_CHECKS,
    ConnectSearch,
    Query,
    TreeSearch,
    coarse_first,
    curve_free,
    line_free_sparsely,
    via_point,
    without_detours,
)
from planners.problem import PLANNER_IDS, RateLimits
from tests.planners.invariants import BLOCKED_LINES, never

HOME = np.zeros(5)
READY = np.array([0.0, -0.5, 0.5, 0.0, 0.0])
STEP_M = 0.005
RRT_CONNECT = "RRTConnect"


@pytest.fixture(params=BLOCKED_LINES)
def blocked(request):
    return tuple(np.array(point) for point in request.param)


def after(space, checks):
    """Stop after a number of checks."""
    most = space.checks + checks
    return lambda: space.checks >= most


def free(space, path):
    return all(space.line_free(start, end, STEP_M) for start, end in itertools.pairwise(path))


def search(query, name, seed):
    return ConnectSearch(query, None, seed) if name == RRT_CONNECT else TreeSearch(query, name, seed)


@pytest.mark.parametrize("name", PLANNER_IDS)
def test_every_planner_finds_a_free_path_from_start_to_goal_and_the_same_by_the_same_seed(joint_space, name):
    start, goal = (np.array(point) for point in BLOCKED_LINES[1])
    asked = Query(joint_space, start, [goal], STEP_M)
    paths = ((seed, search(asked, name, seed).run(after(joint_space, 6000))) for seed in range(5))
    seed, path = next((seed, path) for seed, path in paths if path is not None)
    np.testing.assert_array_equal(search(asked, name, seed).run(after(joint_space, 6000)), path)
    np.testing.assert_array_equal(path[[0, -1]], [start, goal])
    shorter = without_detours(joint_space, path, STEP_M)
    np.testing.assert_array_equal(shorter[[0, -1]], path[[0, -1]])
    assert 2 < len(shorter) <= len(path)
    assert free(joint_space, path)
    assert free(joint_space, shorter)
    assert np.all((path >= joint_space.lower_rad) & (path <= joint_space.upper_rad))


def test_search_ends_at_one_of_several_goals(joint_space, blocked):
    start, goal = blocked
    goals = [goal, goal + 0.01]
    path = ConnectSearch(Query(joint_space, start, goals, STEP_M), None, 3).run(never)
    assert any(np.array_equal(path[-1], each) for each in goals)


def test_search_stops_soon_after_it_is_asked_to(joint_space):
    # A goal in collision can never be reached.
    inside = np.array([0.0, -1.745, 1.69, 1.0, 0.0])
    asked = iter(range(20))
    assert (
        ConnectSearch(Query(joint_space, HOME, [inside], STEP_M), None, 0).run(lambda: next(asked, None) is None)
        is None
    )


def test_detours_that_a_free_line_passes_by_are_left_out(joint_space):
    detour = np.array([HOME, [0.5, -0.2, 0.3, 0.1, 0.0], [-0.4, -0.6, 0.2, 0.0, 0.3], [0.3, 0.1, 0.4, 0.0, 0.0], READY])
    np.testing.assert_array_equal(without_detours(joint_space, detour, STEP_M), [HOME, READY])


def test_a_path_that_is_not_free_after_all_is_none(joint_space, blocked):
    assert without_detours(joint_space, np.array(blocked), STEP_M) is None


LIMITS = RateLimits(np.full(5, 3.0), np.full(5, 10.0))


def test_nothing_is_free_once_the_search_is_stopped(joint_space):
    assert without_detours(joint_space, np.array([HOME, READY]), STEP_M, lambda: True) is None
    assert not curve_free(joint_space, line(HOME, READY, LIMITS), STEP_M, lambda: True)


@pytest.mark.parametrize("blocked", BLOCKED_LINES)
def test_a_curve_through_the_arm_itself_is_blocked(joint_space, blocked):
    start, goal = (np.array(point) for point in blocked)
    assert curve_free(joint_space, line(HOME, READY, LIMITS), STEP_M)
    assert not curve_free(joint_space, line(start, goal, LIMITS), STEP_M)
    assert not curve_free(joint_space, polyline(np.array([READY, start, goal]), LIMITS), STEP_M)


def test_a_curve_that_leaves_a_joints_range_is_not_free(joint_space):
    beyond = READY.copy()
    beyond[0] = joint_space.upper_rad[0] + 0.01
    assert not curve_free(joint_space, line(READY, beyond, LIMITS), STEP_M)


@pytest.mark.parametrize("pieces", [1, 2, 3, 7, 16])
def test_every_piece_of_a_line_is_looked_at_once_and_its_end_first(pieces):
    shares = coarse_first(pieces).ravel()
    assert shares[0] == 1.0
    assert sorted(shares) == pytest.approx(np.arange(1, pieces + 1) / pieces)


@pytest.mark.parametrize("blocked", BLOCKED_LINES)
def test_a_sparse_check_of_a_line_finds_obstacles_as_wide_as_its_steps(joint_space, blocked):
    assert not line_free_sparsely(joint_space, *map(np.array, blocked), STEP_M)
    assert line_free_sparsely(joint_space, HOME, READY, STEP_M)


TIP = "gripper_frame_link"
# The gripper points down within 6 degrees.
DOWN = Constraints(orientations=(OrientationConstraint(TIP, (1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 3.2)),))
LEFT, RIGHT = np.array([0.8, 0.0, 0.0, 1.57, 0.0, 0.0]), np.array([-0.8, 0.3, 0.0, 1.27, 0.0, 0.0])


@pytest.fixture
def holds(goal_states, collision):
    return ConditionSet(goal_states.forward, conditions(DOWN, collision)).holds


@pytest.fixture
def projected(goal_states, collision, arm, holds):
    start, goal = (goal_states.projection(arm, DOWN, q)(q[:5]) for q in (LEFT, RIGHT))
    space = JointSpace(collision, arm.joints, np.zeros(6), holds=holds)
    project = goal_states.projection(arm, DOWN, np.zeros(6))
    return Query(space, start, [goal], 0.02), project


def test_path_leads_from_start_to_goal_where_the_condition_holds(projected, holds):
    query, project = projected
    path = ConnectSearch(query, project, 1).run(never)
    np.testing.assert_array_equal(path, ConnectSearch(query, project, 1).run(never))
    np.testing.assert_array_equal(path[0], query.start)
    np.testing.assert_array_equal(path[-1], query.goals[0])
    for start, end in itertools.pairwise(path):
        assert all(holds(np.append(start + u * (end - start), 0.0)) for u in (0.0, 0.5, 1.0))


def test_search_that_is_stopped_has_no_path(projected):
    query, project = projected
    assert ConnectSearch(query, project, 1).run(lambda: True) is None
    asked = iter(range(50))
    assert ConnectSearch(query, lambda _: None, 1).run(lambda: next(asked, None) is None) is None


WALL_STEP_M = 0.1
WHOLE = np.ones(5)


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


WEST, MIDDLE, EAST = np.array([[-0.8, 0.0], [0.1, 0.0], [0.8, 0.0]])


class Wire(Walled):
    """A square with a wire in the way, thinner than the gaps between a curve's first samples."""

    def free(self, point):
        return abs(point[0] - 0.13) > 0.006


@pytest.mark.parametrize(("end", "step_m", "is_free"), [(EAST, 0.01, False), (EAST, 0.5, True), (MIDDLE, 0.01, True)])
def test_a_curve_is_free_if_it_is_at_steps(end, step_m, is_free):
    assert curve_free(Wire(), line(WEST, end, RateLimits(np.ones(2), np.ones(2))), step_m) == is_free


def query(space, *goals):
    return Query(space, WEST, goals, WALL_STEP_M)


class WalledRoom(Walled):
    """As the square, with four more axes along which nothing is in the way."""

    lower_rad, upper_rad, travel_m_per_rad = -np.ones(6), np.ones(6), np.ones(6)


def test_a_narrow_gap_takes_fewer_checks_where_blocked_points_only_go_to_points_nearby(monkeypatch):
    monkeypatch.setattr(path_module, "TREE_EDGE_M", 0.6)
    start, goal = (np.append(point, np.zeros(4)) for point in (WEST, EAST))

    def checks(edges):
        monkeypatch.setattr(path_module, "DOMAIN_EDGES", edges)
        spaces = [WalledRoom(0.6, 0.7) for _ in range(10)]
        for seed, space in enumerate(spaces):
            path = ConnectSearch(Query(space, start, [goal], WALL_STEP_M), None, seed).run(after(space, 20_000))
            np.testing.assert_array_equal(path[[0, -1]], [start, goal])
        return sum(space.checks for space in spaces)

    assert checks(DOMAIN_EDGES) < 0.7 * checks(np.inf)


def way(asked, seed=0, should_stop=never, velocity_rad_s=(1.0, 1.0)):
    return via_point(asked, np.array(velocity_rad_s), np.random.default_rng(seed), should_stop)


def test_the_path_leads_through_the_gap_from_the_start_to_the_goal():
    path = way(query(Walled(0.3, 0.9), EAST))
    np.testing.assert_array_equal(path[[0, 2]], [WEST, EAST])
    shares = np.linspace(0.0, 1.0, 200)[:, np.newaxis]
    on_it = np.concatenate([first + shares * (last - first) for first, last in pairwise(path)])
    # Between two points that were checked the path may be a step deep in the wall.
    assert all(
        Walled(0.3 - WALL_STEP_M, 0.9 + WALL_STEP_M).free(point) or abs(point[0]) > 0.1 - WALL_STEP_M for point in on_it
    )


def test_where_no_line_is_free_the_search_gives_up_after_some_checks():
    asked = query(Walled(2.0, 2.0), EAST)
    assert way(asked) is None
    one_line = np.ceil(4.0 / WALL_STEP_M)
    assert MOST_CHECKS <= asked.space.checks < MOST_CHECKS + one_line


def test_a_search_that_is_stopped_checks_nothing():
    asked = query(Walled(0.3, 0.9), EAST)
    assert way(asked, should_stop=lambda: True) is None
    assert asked.space.checks == 0


def test_a_path_of_the_arm_ends_at_a_goal_and_is_free_at_its_points(joint_space):
    start, goal = (np.array(point) for point in BLOCKED_LINES[1])
    asked = Query(joint_space, start, [goal], 0.08)
    paths = (via_point(asked, WHOLE, np.random.default_rng(seed), never) for seed in range(20))
    path = next(path for path in paths if path is not None)
    np.testing.assert_array_equal(path[[0, 2]], [start, goal])
    assert all(joint_space.free(point) for point in path)

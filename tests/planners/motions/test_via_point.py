"""Paths by way of one point: through gaps of a wall, and for the SO-101 where a straight line is not free."""

from itertools import pairwise

import numpy as np

from planners.motions.path import MOST_CHECKS, Query, via_point
from tests.planners.invariants import BLOCKED_LINES, never

STEP_M = 0.1
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


LEFT, RIGHT = np.array([-0.8, 0.0]), np.array([0.8, 0.0])


def query(space, *goals):
    return Query(space, LEFT, goals, STEP_M)


def found(asked, seed=0, should_stop=never, velocity_rad_s=(1.0, 1.0)):
    return via_point(asked, np.array(velocity_rad_s), np.random.default_rng(seed), should_stop)


def test_the_path_leads_through_the_gap_from_the_start_to_the_goal():
    path = found(query(Walled(0.3, 0.9), RIGHT))
    np.testing.assert_array_equal(path[[0, 2]], [LEFT, RIGHT])
    shares = np.linspace(0.0, 1.0, 200)[:, np.newaxis]
    on_it = np.concatenate([first + shares * (last - first) for first, last in pairwise(path)])
    # Between two points that were checked the path may be a step deep in the wall.
    assert all(Walled(0.3 - STEP_M, 0.9 + STEP_M).free(point) or abs(point[0]) > 0.1 - STEP_M for point in on_it)


def test_where_no_line_is_free_the_search_gives_up_after_some_checks():
    asked = query(Walled(2.0, 2.0), RIGHT)
    assert found(asked) is None
    one_line = np.ceil(4.0 / STEP_M)
    assert MOST_CHECKS <= asked.space.checks < MOST_CHECKS + one_line


def test_a_search_that_is_stopped_checks_nothing():
    asked = query(Walled(0.3, 0.9), RIGHT)
    assert found(asked, should_stop=lambda: True) is None
    assert asked.space.checks == 0


def test_a_path_of_the_arm_ends_at_a_goal_and_is_free_at_its_points(joint_space):
    start, goal = (np.array(point) for point in BLOCKED_LINES[1])
    asked = Query(joint_space, start, [goal], 0.08)
    paths = (via_point(asked, WHOLE, np.random.default_rng(seed), never) for seed in range(20))
    path = next(path for path in paths if path is not None)
    np.testing.assert_array_equal(path[[0, 2]], [start, goal])
    assert all(joint_space.free(point) for point in path)

from __future__ import annotations

import itertools

import numpy as np
import pytest

from planners.geometry.joint_space import JointSpace
from planners.geometry.sweep import ALL_PAIRS
from planners.goals import Constraints, OrientationConstraint
from planners.ik.constraints import ConditionSet, conditions
from planners.motions.curve import line, polyline
from planners.motions.path import CountedSpace, Query, checks_in, coarse_first, projected_search
from planners.problem import RateLimits
from tests.planners.invariants import BLOCKED_LINES, never

HOME = np.zeros(5)
READY = np.array([0.0, -0.5, 0.5, 0.0, 0.0])
LIMITS = RateLimits(np.full(5, 3.0), np.full(5, 10.0))
STEP_M = 0.01


@pytest.fixture
def counted(joint_space):
    return CountedSpace(joint_space)


def test_every_question_counts(counted):
    counted.free(HOME)
    assert counted.checks == 1
    counted.candidate_pairs(np.array([HOME, READY]), np.full((2, 5), 0.01), [ALL_PAIRS, ALL_PAIRS])
    assert counted.checks == 3
    counted.touches_any(HOME, ALL_PAIRS)
    assert counted.checks == 4


def test_nothing_is_free_once_nobody_waits_for_it(joint_space):
    stopped = CountedSpace(joint_space, lambda: True)
    assert not stopped.line_free(HOME, READY, STEP_M)
    assert not stopped.curve_free(line(HOME, READY, LIMITS), STEP_M)


@pytest.mark.parametrize("blocked", BLOCKED_LINES)
def test_a_curve_through_the_arm_itself_is_blocked(counted, blocked):
    start, goal = (np.array(point) for point in blocked)
    assert counted.curve_free(line(HOME, READY, LIMITS), STEP_M)
    assert not counted.curve_free(line(start, goal, LIMITS), STEP_M)
    assert not counted.curve_free(polyline(np.array([READY, start, goal]), LIMITS), STEP_M)


def test_a_curve_that_leaves_a_joints_range_is_not_free(counted):
    beyond = READY.copy()
    beyond[0] = counted.upper_rad[0] + 0.01
    assert not counted.curve_free(line(READY, beyond, LIMITS), STEP_M)


def test_time_is_worth_checks_in_proportion():
    assert checks_in(0.0) == 0
    assert checks_in(0.02) == 2 * checks_in(0.01) > 0


@pytest.mark.parametrize("pieces", [1, 2, 3, 7, 16])
def test_every_piece_of_a_line_is_looked_at_once_and_its_end_first(pieces):
    shares = coarse_first(pieces).ravel()
    assert shares[0] == 1.0
    assert sorted(shares) == pytest.approx(np.arange(1, pieces + 1) / pieces)


@pytest.mark.parametrize("blocked", BLOCKED_LINES)
def test_a_sparse_check_of_a_line_finds_obstacles_as_wide_as_its_steps(counted, blocked):
    assert not counted.line_free_sparsely(*map(np.array, blocked), STEP_M)
    assert counted.line_free_sparsely(HOME, READY, STEP_M)


TIP = "gripper_frame_link"
# The gripper points down within 6 degrees.
DOWN = Constraints(orientations=(OrientationConstraint(TIP, (1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 3.2)),))
LEFT, RIGHT = np.array([0.8, 0.0, 0.0, 1.57, 0.0, 0.0]), np.array([-0.8, 0.3, 0.0, 1.27, 0.0, 0.0])


@pytest.fixture
def holds(goal_states, joints):
    return ConditionSet(goal_states.forward, conditions(DOWN, joints)).holds


@pytest.fixture
def setting(goal_states, collision, arm, holds):
    start, goal = (goal_states.projection(arm, DOWN, q)(q[:5]) for q in (LEFT, RIGHT))
    space = JointSpace(collision, arm, np.zeros(6), holds=holds)
    project = goal_states.projection(arm, DOWN, np.zeros(6))
    return Query(CountedSpace(space), start, [goal], 0.02), project


def test_path_leads_from_start_to_goal_where_the_condition_holds(setting, holds):
    query, project = setting
    path = projected_search(query, project, 1, never)
    np.testing.assert_array_equal(path, projected_search(query, project, 1, never))
    np.testing.assert_array_equal(path[0], query.start)
    np.testing.assert_array_equal(path[-1], query.goals[0])
    for start, end in itertools.pairwise(path):
        assert all(holds(np.append(start + u * (end - start), 0.0)) for u in (0.0, 0.5, 1.0))


def test_search_that_is_stopped_has_no_path(setting):
    query, project = setting
    assert projected_search(query, project, 1, lambda: True) is None
    asked = iter(range(50))
    assert projected_search(query, lambda _: None, 1, lambda: next(asked, None) is None) is None

import numpy as np
import pytest

from planners.geometry.sweep import ANYTHING
from planners.motions.effort import CountedSpace, checks_in, coarse_first
from planners.motions.timing import line, polyline
from planners.rates import RateLimits
from tests.planners.invariants import BLOCKED_LINES

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
    counted.threats(np.array([HOME, READY]), np.full((2, 5), 0.01), [ANYTHING, ANYTHING])
    assert counted.checks == 3
    counted.touches_any(HOME, ANYTHING)
    assert counted.checks == 4


def test_the_same_questions_count_the_same(joint_space):
    spaces = [CountedSpace(joint_space) for _ in range(2)]
    for space in spaces:
        space.curve_free(line(HOME, READY, LIMITS), STEP_M)
    assert spaces[0].checks == spaces[1].checks > 0


def test_a_curve_through_open_space_is_free(counted):
    assert counted.curve_free(line(HOME, READY, LIMITS), STEP_M)


def test_nothing_is_free_once_nobody_waits_for_it(joint_space):
    stopped = CountedSpace(joint_space, lambda: True)
    assert not stopped.line_free(HOME, READY, STEP_M)
    assert not stopped.curve_free(line(HOME, READY, LIMITS), STEP_M)


@pytest.mark.parametrize("blocked", BLOCKED_LINES)
def test_a_curve_through_the_arm_itself_is_blocked(counted, blocked):
    start, goal = (np.array(point) for point in blocked)
    assert not counted.curve_free(line(start, goal, LIMITS), STEP_M)
    assert not counted.curve_free(polyline(np.array([READY, start, goal]), LIMITS), STEP_M)


def test_a_curve_that_leaves_a_joints_range_is_not_free(counted):
    beyond = READY.copy()
    beyond[0] = counted.upper_rad[0] + 0.01
    assert not counted.curve_free(line(READY, beyond, LIMITS), STEP_M)


def test_finer_steps_take_more_checks_near_something(joint_space):
    start = np.array(BLOCKED_LINES[0][0])
    checks = []
    for step_m in (0.05, 0.002):
        space = CountedSpace(joint_space)
        space.curve_free(line(start, 0.9 * start, LIMITS), step_m)
        checks.append(space.checks)
    assert checks[1] > checks[0]


def test_time_is_worth_checks_in_proportion():
    assert checks_in(0.0) == 0
    assert checks_in(0.02) == 2 * checks_in(0.01) > 0


@pytest.mark.parametrize("pieces", [1, 2, 3, 7, 16])
def test_every_piece_of_a_line_is_looked_at_once_and_its_end_first(pieces):
    shares = coarse_first(pieces).ravel()
    assert shares[0] == 1.0
    assert sorted(shares) == pytest.approx(np.arange(1, pieces + 1) / pieces)


@pytest.mark.parametrize("blocked", BLOCKED_LINES)
def test_a_glance_at_a_line_sees_what_is_as_wide_as_its_steps(counted, blocked):
    assert not counted.glance(*map(np.array, blocked), STEP_M)
    assert counted.glance(HOME, READY, STEP_M)

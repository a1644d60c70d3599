import numpy as np
import pytest

from planners.motion import Task
from planners.path import search
from tests.planners.invariants import (
    BLOCKED_LINES,
    assert_from_rest_to_rest,
    assert_keeps_rates,
    assert_touches_nothing,
    never,
)

HOME = np.zeros(5)
READY = np.array([0.0, -0.5, 0.5, 0.0, 0.0])


@pytest.fixture
def task_between(joint_space, arm, rate_limits):
    return lambda start, *goals: Task(joint_space, arm.joints, rate_limits, np.array(start), np.array(goals))


@pytest.fixture
def at_home(collision):
    return dict.fromkeys(collision.joint_names, 0.0)


def test_straight_motion_follows_the_line(task_between):
    motion = task_between(HOME, READY).straight_motion()
    assert_from_rest_to_rest(motion, HOME, READY)
    np.testing.assert_allclose(motion.positions_rad[:, 1], -motion.positions_rad[:, 2], atol=1e-12)


def test_straight_motion_takes_the_first_goal_with_a_free_line(task_between):
    start, behind = BLOCKED_LINES[0]
    motion = task_between(start, behind, HOME, READY).straight_motion()
    np.testing.assert_array_equal(motion.positions_rad[-1], HOME)


@pytest.mark.parametrize("line", BLOCKED_LINES)
def test_there_is_no_straight_motion_through_the_arm(task_between, line):
    assert task_between(*line).straight_motion() is None


@pytest.mark.parametrize("line", BLOCKED_LINES)
def test_searched_motion_goes_around_within_the_limits(task_between, collision, rate_limits, at_home, line):
    motion = task_between(*line).searched_motion(0, 1, never)
    assert_from_rest_to_rest(motion, *line)
    assert_keeps_rates(motion, rate_limits)
    assert_touches_nothing(motion, collision, at_home)


def test_more_attempts_are_never_slower(task_between):
    task = task_between(*BLOCKED_LINES[1])
    durations_s = [task.searched_motion(0, attempts, never).duration_s for attempts in (1, 2, 4)]
    assert durations_s == sorted(durations_s, reverse=True)


def test_rounded_corners_that_touch_something_are_cut_less(task_between, joint_space, collision, at_home):
    # The path is free; rounding it at full width may not be. Whatever comes out must be.
    for seed in range(4):
        start, goal = (np.array(point) for point in BLOCKED_LINES[1])
        path = search(joint_space, start, [goal], seed, never)
        motion = task_between(start, goal)._rounded_motion(path)
        if motion is not None:
            assert_touches_nothing(motion, collision, at_home)


@pytest.mark.parametrize("line", BLOCKED_LINES)
def test_no_motion_leaves_without_a_check_of_the_timed_curve(task_between, line):
    assert task_between(*line)._checked_motion(np.array(line), blend_rad=0.0) is None


def test_stopped_search_has_no_motion(task_between):
    assert task_between(*BLOCKED_LINES[0]).searched_motion(0, 5, lambda: True) is None

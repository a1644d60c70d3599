from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from planners.budget import Budget
from planners.geometry.certificate import Contact, certify
from planners.motions import motion
from planners.motions.curve import TICK_S, least_time_s, polyline
from planners.motions.motion import Motion, MotionTask, find_motion, smooth
from planners.motions.path import NOMINAL_CHECKS_PER_S
from planners.motions.path_timing import MAX_DURATION_S
from planners.problem import VIA_POINT, MoveItErrorCode, PlanningFailure, RateLimits
from planners.scene import Box
from tests.planners.invariants import (
    BLOCKED_LINES,
    assert_from_rest_to_rest,
    assert_keeps_positions,
    assert_keeps_rates,
    assert_touches_nothing,
    never,
)
from tests.planners.scenes import scene, thing

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
    return smooth(polyline(DETOUR, LIMITS), LIMITS, anywhere, free, np.random.default_rng(seed), should_stop)[-1]


@pytest.mark.parametrize("seed", range(5))
def test_a_shortened_curve_keeps_ends_and_limits_and_consists_of_free_pieces(seed):
    assert outside_the_disc(polyline(DETOUR, LIMITS))
    curve = shortened(outside_the_disc, seed)
    trajectory = curve.sampled(NAMES)
    assert_from_rest_to_rest(trajectory, DETOUR[0], DETOUR[-1])
    assert_keeps_rates(trajectory, LIMITS)
    assert outside_the_disc(curve)
    assert curve.duration_ticks < 0.8 * polyline(DETOUR, LIMITS).duration_ticks


def test_in_free_space_shortening_nearly_reaches_the_least_time():
    least_s = least_time_s(DETOUR[0], np.zeros(2), DETOUR[-1], np.zeros(2), LIMITS)
    assert TICK_S * shortened().duration_ticks < 1.03 * least_s


CHECKS_A_CERTIFICATE = 3000  # of a motion that is found just before the time is over, and of longer ones if it touches

HOME = np.zeros(5)
READY = np.array([0.0, -0.5, 0.5, 0.0, 0.0])


def unlimited():
    return Budget(lambda: 0.0, 1.0, never)


@pytest.fixture
def task_between(joint_space, arm, rate_limits):
    def task(start, *goals, velocity=HOME, limits=rate_limits, **options):
        goals = [np.array(goal) for goal in goals]
        return MotionTask(joint_space, arm.joints, limits, np.array(start), np.array(velocity), goals, **options)

    return task


def test_the_first_goal_with_a_free_line_is_taken(task_between):
    start, behind = BLOCKED_LINES[0]
    motion = find_motion(task_between(start, behind, HOME, READY), unlimited())
    assert motion.goal == 1
    np.testing.assert_array_equal(motion.trajectory.positions_rad[-1], HOME)


@pytest.mark.parametrize("scaling", [1e-6, 1e-12])
def test_a_motion_that_would_take_too_long_is_refused_before_it_is_sampled(task_between, scaling):
    task = task_between(HOME, READY)
    slow = replace(task, limits=replace(task.limits, velocity_rad_s=scaling * task.limits.velocity_rad_s))
    failure = find_motion(slow, unlimited())
    assert failure.code is MoveItErrorCode.FAILURE
    assert "s at least, more than the limit of 1800 s: raise the velocity and acceleration scaling" in failure.message
    assert failure.details["least_s"] > MAX_DURATION_S


@pytest.mark.parametrize("blocked", BLOCKED_LINES)
@pytest.mark.parametrize("method", [VIA_POINT, "RRTConnect"])
def test_a_searched_motion_goes_around_within_the_limits(
    monkeypatch, task_between, collision, rate_limits, joint_space, at_home, blocked, method
):
    if method != VIA_POINT:
        monkeypatch.setattr("planners.motions.motion.via_point", lambda *_: None)
    motion = find_motion(task_between(*blocked, optimization_time_s=0.012), unlimited())
    assert motion.method == method
    assert_from_rest_to_rest(motion.trajectory, *blocked)
    assert_keeps_rates(motion.trajectory, rate_limits)
    assert_keeps_positions(motion.trajectory, joint_space.lower_rad, joint_space.upper_rad)
    assert_touches_nothing(motion.trajectory, collision, at_home)
    assert certify(joint_space, motion.trajectory) is None


def test_optimisation_makes_motions_shorter(task_between):
    times_s = (0.0, 0.012, 0.06)
    durations_s = [
        np.mean(
            [
                find_motion(
                    task_between(*blocked, optimization_time_s=time_s, seed=seed), unlimited()
                ).trajectory.duration_s
                for blocked in BLOCKED_LINES
                for seed in (0, 100, 200)
            ]
        )
        for time_s in times_s
    ]
    assert durations_s == sorted(durations_s, reverse=True)
    assert durations_s[1] < 0.9 * durations_s[0]


def work(task):
    """Return the checks that a motion takes."""
    before = task.space.checks
    assert isinstance(find_motion(task, unlimited()), Motion)
    return task.space.checks - before


@pytest.fixture
def task_over_a_wall(task_between, collision):
    collision.set_scene(scene(thing(Box((0.3, 0.02, 0.3)), 0.3, 0.0, 0.15)))
    yield partial(task_between, [-0.6, 0.4, 0.0, 0.3, 0.0], [0.6, 0.4, 0.0, 0.3, 0.0])
    collision.set_scene(scene())


@pytest.mark.parametrize("blocked", BLOCKED_LINES)
def test_a_motion_that_takes_the_least_time_is_shortened_no_further(task_between, blocked):
    task = task_between(*blocked, optimization_time_s=1.0)
    assert work(task) < 0.1 * NOMINAL_CHECKS_PER_S
    assert find_motion(task, unlimited()).trajectory.duration_s == pytest.approx(task.least_s, abs=0.005)


def test_where_the_shortest_motion_touches_between_two_checks_its_earlier_parts_stay(monkeypatch, task_over_a_wall):
    task, certified = task_over_a_wall(attempts=1), []

    def touches_first(space, trajectory):
        certified.append(trajectory.duration_s)
        return Contact(0.0, ()) if len(certified) == 1 else certify(space, trajectory)

    unshortened = find_motion(task, unlimited()).trajectory
    monkeypatch.setattr("planners.motions.motion.certify", touches_first)
    found = find_motion(replace(task, optimization_time_s=0.016), unlimited()).trajectory
    assert certified[0] < found.duration_s < 0.95 * unshortened.duration_s
    assert certify(task.space, found) is None


def test_the_work_that_is_asked_for_is_spent_and_little_more(task_over_a_wall):
    first = work(task_over_a_wall(optimization_time_s=0.0))
    for time_s in (0.1, 0.5):
        spent = work(task_over_a_wall(optimization_time_s=time_s))
        assert time_s * NOMINAL_CHECKS_PER_S <= spent <= time_s * NOMINAL_CHECKS_PER_S + first + CHECKS_A_CERTIFICATE


def test_the_best_motion_takes_all_the_time_that_is_allowed_and_is_no_longer(task_over_a_wall, collision, at_home):
    task = task_over_a_wall(optimization_time_s=np.inf, attempts=1)
    clock = Budget(lambda: task.space.checks / NOMINAL_CHECKS_PER_S, 1.0, never)
    best = find_motion(task, clock)
    assert 1.0 <= clock.spent_s <= 1.0 + CHECKS_A_CERTIFICATE / NOMINAL_CHECKS_PER_S
    assert_touches_nothing(best.trajectory, collision, at_home)
    short = find_motion(replace(task, optimization_time_s=0.024), unlimited())
    assert best.trajectory.duration_s <= short.trajectory.duration_s


def test_a_request_that_is_cancelled_while_its_motion_is_shortened_has_none(task_over_a_wall):
    task = task_over_a_wall(optimization_time_s=np.inf)
    first = work(replace(task, optimization_time_s=0.0))
    last = task.space.checks + 10 * first
    budget = Budget(lambda: 0.0, 1.0, lambda: task.space.checks >= last)
    find_motion(task, budget)
    assert budget.failure().code is MoveItErrorCode.PREEMPTED
    assert task.space.checks <= last + first


def test_same_seed_gives_the_same_motion_whatever_the_clock_says(task_between):
    ticking = iter(np.arange(0.0, 100.0, 1e-4))
    budgets = unlimited(), Budget(lambda: float(next(ticking)), 50.0, never)
    first, again = (
        find_motion(task_between(*BLOCKED_LINES[1], optimization_time_s=0.02, seed=7), budget).trajectory
        for budget in budgets
    )
    np.testing.assert_array_equal(first.positions_rad, again.positions_rad)
    np.testing.assert_array_equal(first.time_s, again.time_s)


def test_a_search_is_named_as_moveit_spells_it(task_between):
    motion = find_motion(task_between(*BLOCKED_LINES[1], planner_id="geometric::RRTkConfigDefault"), unlimited())
    assert motion.method == "RRT"


def test_an_unknown_search_is_a_bug_of_the_caller(task_between):
    with pytest.raises(ValueError, match="AORRTC"):
        find_motion(task_between(*BLOCKED_LINES[1], planner_id="AORRTC"), unlimited())


@pytest.mark.parametrize("line", [(HOME, READY), *BLOCKED_LINES])
def test_a_moving_start_is_taken_over_smoothly(task_between, collision, rate_limits, at_home, line):
    velocity = 0.3 * np.array([1.0, -1.0, 0.5, 1.0, -1.0]) * rate_limits.velocity_rad_s
    motion = find_motion(task_between(*line, velocity=velocity, optimization_time_s=0.012), unlimited())
    assert isinstance(motion, Motion)
    np.testing.assert_array_equal(motion.trajectory.positions_rad[[0, -1]], np.array(line))
    np.testing.assert_array_equal(motion.trajectory.velocities_rad_s[[0, -1]], [velocity, HOME])
    assert_keeps_rates(motion.trajectory, rate_limits)
    assert_touches_nothing(motion.trajectory, collision, at_home)


def test_an_arm_too_fast_to_stop_is_refused_at_once(task_between, joint_space, rate_limits):
    start = READY.copy()
    start[0] = joint_space.upper_rad[0] - 0.01
    velocity = np.array([rate_limits.velocity_rad_s[0], 0.0, 0.0, 0.0, 0.0])
    failure = find_motion(task_between(start, READY, velocity=velocity), unlimited())
    assert isinstance(failure, PlanningFailure)
    assert failure.code is MoveItErrorCode.START_STATE_INVALID
    assert "joint limits" in failure.message


def test_a_moving_start_with_jerk_limits_is_left_without_a_step(task_between, rate_limits):
    limits = RateLimits(rate_limits.velocity_rad_s, rate_limits.acceleration_rad_s2, np.full(5, 60.0))
    velocity = 0.3 * rate_limits.velocity_rad_s
    trajectory = find_motion(task_between(HOME, READY, velocity=velocity, limits=limits), unlimited()).trajectory
    np.testing.assert_allclose(trajectory.positions_rad[0], HOME, atol=1e-12)
    np.testing.assert_array_equal(trajectory.velocities_rad_s[0], velocity)
    np.testing.assert_allclose(trajectory.sample(1e-6)[2], np.zeros(5), atol=1e-2)
    assert_keeps_rates(trajectory, limits)
    accelerations = np.array([trajectory.sample(t)[2] for t in np.arange(0.0, trajectory.duration_s, 0.001)])
    assert np.abs(np.diff(accelerations, axis=0)).max() <= 0.001 * 60.0 * 1.001


def test_a_search_goes_on_until_it_is_given_up_for_another_after_many_checks(task_between, monkeypatch):
    turns = []

    class Vain:
        def __init__(self, _query, _name, seed):
            self.seed = seed

        def run(self, _should_stop):
            turns.append(self.seed)
            task.space.checks += 1000

    monkeypatch.setattr(motion, "TreeSearch", Vain)
    monkeypatch.setattr(motion, "CHECKS_A_SEARCH", 3000)
    start, goal = BLOCKED_LINES[0]
    # Before any other search than RRT-Connect no via points are tried.
    task = task_between(start, goal, planner_id="RRT")
    failure = find_motion(task, Budget(lambda: float(len(turns)), 12.0, never))
    assert failure.code is MoveItErrorCode.TIMED_OUT
    assert turns == [0, 0, 0, 3, 3, 3, 6, 6, 6, 9, 9, 9]


def test_a_search_ends_when_its_time_is_up_or_nobody_waits_for_it(task_between):
    clock = iter(np.arange(0.0, 10.0, 0.5))
    late = find_motion(task_between(*BLOCKED_LINES[0]), Budget(lambda: float(next(clock)), 1.0, never))
    assert late.code is MoveItErrorCode.TIMED_OUT
    stopped = find_motion(task_between(*BLOCKED_LINES[0]), Budget(lambda: 0.0, 1.0, lambda: True))
    assert stopped.code is MoveItErrorCode.PREEMPTED

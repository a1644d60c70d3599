from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from planners.budget import Budget
from planners.geometry.certificate import Contact, certify
from planners.motions import motion
from planners.motions.curve import TICK_S, Curve, least_time_s, polyline
from planners.motions.motion import Motion, MotionTask, find_motion, smooth
from planners.motions.path import NOMINAL_CHECKS_PER_S
from planners.motions.path_timing import MAX_DURATION_S
from planners.problem import VIA_POINT, RateLimits
from planners.problem import MoveItErrorCode as Code
from planners.scene import Box
from tests.planners import invariants
from tests.planners.scenes import thing

NAMES = ("a", "b")
LIMITS = RateLimits(np.array([3.0, 2.0]), np.array([10.0, 6.0]))
DETOUR = np.array([[0.0, 0.0], [1.0, -0.5], [1.2, 0.8], [0.4, 1.0]])


def anywhere(piece):
    return True


def outside_the_disc(piece):
    """Nothing may come nearer than 0.4 to a point beside the detour."""
    points = piece.at(np.linspace(0, piece.duration_ticks, 60))[0]
    return bool(np.all(np.linalg.norm(points - (0.6, 0.4), axis=1) > 0.4))


def shortened(free=anywhere, seed=0):
    return smooth(polyline(DETOUR, LIMITS), LIMITS, anywhere, free, np.random.default_rng(seed), invariants.never)[-1]


def test_a_shortened_curve_keeps_ends_and_limits_consists_of_free_pieces_and_nearly_reaches_the_least_time():
    detour = polyline(DETOUR, LIMITS)
    assert outside_the_disc(detour)
    for seed in range(5):
        curve = shortened(outside_the_disc, seed)
        trajectory = curve.sampled(NAMES)
        invariants.assert_from_rest_to_rest(trajectory, DETOUR[0], DETOUR[-1])
        invariants.assert_keeps_rates(trajectory, LIMITS)
        assert outside_the_disc(curve)
        assert curve.duration_ticks < 0.8 * detour.duration_ticks
    least_s = least_time_s(DETOUR[0], np.zeros(2), DETOUR[-1], np.zeros(2), LIMITS)
    assert TICK_S * shortened().duration_ticks < 1.03 * least_s


CHECKS_A_CERTIFICATE = 3000  # of a motion that is found just before the time is over, and of longer ones if it touches

HOME = np.zeros(5)
READY = np.array([0.0, -0.5, 0.5, 0.0, 0.0])


def found(task, clock=lambda: 0.0, allowed_s=1.0, should_stop=invariants.never):
    return find_motion(task, Budget(clock, allowed_s, should_stop))


@pytest.fixture
def task_between(joint_space, arm, rate_limits):
    def task(start, *goals, velocity=HOME, limits=rate_limits, **options):
        goals = [np.array(goal) for goal in goals]
        return MotionTask(joint_space, arm.joints, limits, np.array(start), np.array(velocity), goals, **options)

    return task


def test_the_first_goal_with_a_free_line_is_taken_and_a_search_named_as_moveit_spells_it(task_between):
    start, behind = invariants.BLOCKED_LINES[0]
    motion = found(task_between(start, behind, HOME, READY))
    assert motion.goal == 1
    np.testing.assert_array_equal(motion.trajectory.positions_rad[-1], HOME)
    assert found(task_between(*invariants.BLOCKED_LINES[1], planner_id="geometric::RRTkConfigDefault")).method == "RRT"
    # An unknown one is a bug of the caller.
    with pytest.raises(ValueError, match="AORRTC"):
        found(task_between(*invariants.BLOCKED_LINES[1], planner_id="AORRTC"))


def test_a_motion_too_long_or_of_an_arm_too_fast_to_stop_is_refused(task_between, joint_space, rate_limits):
    for scaling in (1e-6, 1e-12):
        slow = replace(rate_limits, velocity_rad_s=scaling * rate_limits.velocity_rad_s)
        failure = found(task_between(HOME, READY, limits=slow))
        assert failure.code is Code.FAILURE
        assert "s at least, more than the limit of 1800 s: raise the velocity and acceleration sca" in failure.message
        assert failure.details["least_s"] > MAX_DURATION_S
    start = READY.copy()
    start[0] = joint_space.upper_rad[0] - 0.01
    velocity = np.array([rate_limits.velocity_rad_s[0], 0.0, 0.0, 0.0, 0.0])
    failure = found(task_between(start, READY, velocity=velocity))
    assert failure.code is Code.START_STATE_INVALID
    assert "joint limits" in failure.message


@pytest.mark.parametrize("blocked", invariants.BLOCKED_LINES)
@pytest.mark.parametrize("method", [VIA_POINT, "RRTConnect"])
def test_a_searched_motion_goes_around_within_the_limits(
    monkeypatch, task_between, collision, rate_limits, joint_space, at_home, blocked, method
):
    if method != VIA_POINT:
        monkeypatch.setattr(motion, "via_point", lambda *_: None)
    way = found(task_between(*blocked, optimization_time_s=0.012))
    assert way.method == method
    invariants.assert_from_rest_to_rest(way.trajectory, *blocked)
    invariants.assert_keeps_rates(way.trajectory, rate_limits)
    invariants.assert_keeps_positions(way.trajectory, joint_space.lower_rad, joint_space.upper_rad)
    invariants.assert_touches_nothing(way.trajectory, collision, at_home)
    assert certify(joint_space, way.trajectory) is None


def test_optimisation_makes_motions_shorter(task_between):
    def mean_s(time_s):
        tasks = (
            task_between(*blocked, optimization_time_s=time_s, seed=seed)
            for blocked in invariants.BLOCKED_LINES
            for seed in (0, 100, 200)
        )
        return np.mean([found(task).trajectory.duration_s for task in tasks])

    none_s, little_s, more_s = map(mean_s, (0.0, 0.012, 0.06))
    assert none_s >= little_s >= more_s
    assert little_s < 0.9 * none_s


def work(task):
    """Return the checks that a motion takes."""
    before = task.space.checks
    assert isinstance(found(task), Motion)
    return task.space.checks - before


@pytest.fixture
def task_over_a_wall(request, collision, put):
    put(collision, thing(Box((0.3, 0.02, 0.3)), 0.3, 0.0, 0.15))
    # A joint space is of the scene that is there when it is made.
    return partial(request.getfixturevalue("task_between"), [-0.6, 0.4, 0.0, 0.3, 0.0], [0.6, 0.4, 0.0, 0.3, 0.0])


@pytest.mark.parametrize("blocked", invariants.BLOCKED_LINES)
def test_a_motion_that_takes_the_least_time_is_shortened_no_further(task_between, blocked):
    task = task_between(*blocked, optimization_time_s=1.0)
    assert work(task) < 0.1 * NOMINAL_CHECKS_PER_S
    assert found(task).trajectory.duration_s == pytest.approx(task.least_s, abs=0.005)


def test_no_other_path_is_searched_for_in_fewer_checks_than_the_last_one_took(monkeypatch, task_over_a_wall):
    task, begun = task_over_a_wall(), []

    def as_found(curve, *_):
        begun.append(task.space.checks)
        return [curve]

    monkeypatch.setattr(motion, "smooth", as_found)
    before, alone = task.space.checks, work(task)
    path_s = (begun[0] - before) / NOMINAL_CHECKS_PER_S
    assert work(replace(task, optimization_time_s=0.5 * path_s)) == alone
    assert work(replace(task, optimization_time_s=3.0 * path_s)) > alone


def test_where_the_shortest_motion_touches_between_two_checks_its_earlier_parts_stay(monkeypatch, task_over_a_wall):
    task, certified = task_over_a_wall(attempts=1), []

    def touches_first(space, trajectory):
        certified.append(trajectory.duration_s)
        return Contact(0.0, ()) if len(certified) == 1 else certify(space, trajectory)

    unshortened = found(task).trajectory
    monkeypatch.setattr(motion, "certify", touches_first)
    shorter = found(replace(task, optimization_time_s=0.016)).trajectory
    assert certified[0] < shorter.duration_s < 0.95 * unshortened.duration_s
    assert certify(task.space, shorter) is None


def test_of_ever_shorter_motions_the_last_that_is_free_is_found_in_few_trials(monkeypatch, task_over_a_wall):
    task, searched, tried, free_from = task_over_a_wall(), [], [], 0

    def ever_quicker(curve, *_):
        stages = (Curve(curve.ticks * k, curve.positions_rad, curve.velocities_rad_s / k) for k in range(12, 0, -1))
        searched.append(list(stages))
        return searched[-1]

    def touches_later(space, trajectory):
        stage = [TICK_S * each.duration_ticks for each in searched[-1]].index(pytest.approx(trajectory.duration_s))
        tried.append(stage)
        return certify(space, trajectory) if stage <= free_from or len(searched) > 1 else Contact(0.0, ())

    monkeypatch.setattr(motion, "smooth", ever_quicker)
    monkeypatch.setattr(motion, "certify", touches_later)
    for free_from in range(12):
        searched.clear()
        tried.clear()
        assert found(task).trajectory.duration_s == pytest.approx(TICK_S * searched[0][free_from].duration_ticks)
        assert len(tried) <= 6
    searched.clear()
    tried.clear()
    free_from = -1
    found(task)
    assert tried == [11, 0, 11], "where the first touches, another is searched for"


def test_a_path_that_touches_between_the_checks_of_its_search_is_not_shortened(monkeypatch, task_over_a_wall):
    task, searched = task_over_a_wall(), []
    through_the_wall = np.array([task.start, 0.5 * (task.start + task.goals[0]), task.goals[0]])
    found_first = iter([through_the_wall])

    def watched(curve, *others):
        searched.append(curve)
        return smooth(curve, *others)

    monkeypatch.setattr(motion, "via_point", lambda *_: next(found_first, None))
    monkeypatch.setattr(motion, "smooth", watched)
    assert found(task).method != VIA_POINT
    assert len(searched) == 1


def test_the_work_asked_for_is_spent_and_by_the_best_motion_all_the_time(task_over_a_wall, collision, at_home):
    first = work(task_over_a_wall(optimization_time_s=0.0))
    for time_s in (0.1, 0.3):
        spent = work(task_over_a_wall(optimization_time_s=time_s))
        assert time_s * NOMINAL_CHECKS_PER_S <= spent <= time_s * NOMINAL_CHECKS_PER_S + first + CHECKS_A_CERTIFICATE
    task = task_over_a_wall(optimization_time_s=np.inf, attempts=1)
    clock = Budget(lambda: task.space.checks / NOMINAL_CHECKS_PER_S, 0.4, invariants.never)
    best = find_motion(task, clock)
    assert 0.4 <= clock.spent_s <= 0.4 + CHECKS_A_CERTIFICATE / NOMINAL_CHECKS_PER_S
    invariants.assert_touches_nothing(best.trajectory, collision, at_home)
    short = found(replace(task, optimization_time_s=0.024))
    assert best.trajectory.duration_s <= short.trajectory.duration_s
    # A request that is cancelled while its motion is shortened has none.
    task = task_over_a_wall(optimization_time_s=np.inf)
    last = task.space.checks + 10 * first
    budget = Budget(lambda: 0.0, 1.0, lambda: task.space.checks >= last)
    find_motion(task, budget)
    assert budget.failure().code is Code.PREEMPTED
    assert task.space.checks <= last + first


def test_same_seed_gives_the_same_motion_whatever_the_clock_says(task_between):
    ticking, task = iter(np.arange(0.0, 100.0, 1e-4)), partial(task_between, *invariants.BLOCKED_LINES[1])
    first = found(task(optimization_time_s=0.02, seed=7)).trajectory
    again = found(task(optimization_time_s=0.02, seed=7), lambda: float(next(ticking)), 50.0).trajectory
    np.testing.assert_array_equal(first.positions_rad, again.positions_rad)
    np.testing.assert_array_equal(first.time_s, again.time_s)


@pytest.mark.parametrize("line", [(HOME, READY), *invariants.BLOCKED_LINES])
def test_a_moving_start_is_taken_over_smoothly(task_between, collision, rate_limits, at_home, line):
    velocity = 0.3 * np.array([1.0, -1.0, 0.5, 1.0, -1.0]) * rate_limits.velocity_rad_s
    trajectory = found(task_between(*line, velocity=velocity, optimization_time_s=0.012)).trajectory
    np.testing.assert_array_equal(trajectory.positions_rad[[0, -1]], np.array(line))
    np.testing.assert_array_equal(trajectory.velocities_rad_s[[0, -1]], [velocity, HOME])
    invariants.assert_keeps_rates(trajectory, rate_limits)
    invariants.assert_touches_nothing(trajectory, collision, at_home)
    # With jerk limits it is left without a step.
    limits = replace(rate_limits, jerk_rad_s3=np.full(5, 60.0))
    velocity = 0.3 * rate_limits.velocity_rad_s
    trajectory = found(task_between(HOME, READY, velocity=velocity, limits=limits)).trajectory
    np.testing.assert_allclose(trajectory.positions_rad[0], HOME, atol=1e-12)
    np.testing.assert_array_equal(trajectory.velocities_rad_s[0], velocity)
    np.testing.assert_allclose(trajectory.sample(1e-6)[2], np.zeros(5), atol=1e-2)
    invariants.assert_keeps_rates(trajectory, limits)
    accelerations = np.array([trajectory.sample(t)[2] for t in np.arange(0.0, trajectory.duration_s, 0.001)])
    assert np.abs(np.diff(accelerations, axis=0)).max() <= 0.001 * 60.0 * 1.001


def test_a_search_goes_on_until_it_is_given_up_for_another_its_time_is_up_or_nobody_waits(task_between, monkeypatch):
    clock, task = iter(np.arange(0.0, 10.0, 0.5)), task_between(*invariants.BLOCKED_LINES[0])
    assert found(task, lambda: float(next(clock))).code is Code.TIMED_OUT
    assert found(task, should_stop=lambda: True).code is Code.PREEMPTED
    turns = []

    class Vain:
        def __init__(self, _query, _name, seed):
            self.seed = seed

        def run(self, _should_stop):
            turns.append(self.seed)
            task.space.checks += 1000

    monkeypatch.setattr(motion, "TreeSearch", Vain)
    monkeypatch.setattr(motion, "CHECKS_A_SEARCH", 3000)
    # Before any other search than RRT-Connect no via points are tried.
    task = task_between(*invariants.BLOCKED_LINES[0], planner_id="RRT")
    assert found(task, lambda: float(len(turns)), 12.0).code is Code.TIMED_OUT
    assert turns == [0, 0, 0, 3, 3, 3, 6, 6, 6, 9, 9, 9]

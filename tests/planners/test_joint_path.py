"""Paths of the joints that are given: their timing, their limits, and what is in their way."""

from dataclasses import replace

import numpy as np
import pytest

from planners.joint_path import LIMIT_TOLERANCE_RAD
from planners.motions.spline import NaturalSpline
from planners.problem import JointPathProblem, MoveItErrorCode, Plan, PlanningFailure, RateLimits, RecheckQuestion
from planners.scene import Box
from robot.trajectory import Trajectory
from tests.planners.invariants import assert_from_rest_to_rest, assert_keeps_rates, assert_well_formed
from tests.planners.scenes import thing, tip_positions_m

JOINTS = ("shoulder_pan", "elbow_flex", "gripper")


def problem(at_home, lasts_s=4.0, reach_rad=0.5, seed=0, speed=1.0):
    """A smooth path of joints of two groups, ends included at rest as taught ones are."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, lasts_s + 0.05, 0.1)
    waves = rng.uniform(-1.0, 1.0, (3, 3)) * reach_rad
    share = 0.5 - 0.5 * np.cos(np.pi * np.clip(time_s / lasts_s, 0.0, 1.0))
    points = sum(np.sin((k + 1) * np.pi * share)[:, None] * waves[k] / (k + 1) for k in range(3))
    return JointPathProblem(at_home, JOINTS, time_s, 0.5 + points * [1.0, 0.5, 0.5], speed)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("speed", [0.3, 1.0, 2.0])
def test_every_place_of_a_path_is_passed_from_rest_to_rest_within_the_limits(planner, robot, at_home, seed, speed):
    asked = problem(at_home, lasts_s=1.5, seed=seed, speed=speed)
    answer = planner.answer(asked)
    assert isinstance(answer, Plan), answer
    assert_well_formed(answer.trajectory)
    assert_from_rest_to_rest(answer.trajectory, asked.positions_rad[0], asked.positions_rad[-1])
    joints = [robot.joints[name] for name in JOINTS]
    rates = ([getattr(joint, rate) for joint in joints] for rate in ("max_velocity", "max_acceleration"))
    assert_keeps_rates(answer.trajectory, RateLimits(*map(np.array, rates)))
    assert answer.trajectory.joint_names == JOINTS
    fine = NaturalSpline(asked.time_s, asked.positions_rad)(np.linspace(0.0, asked.time_s[-1], 5000))
    away = [np.abs(fine - point).max(axis=1).min() for point in answer.trajectory.positions_rad]
    assert max(away) < 1e-3


@pytest.mark.parametrize(("speed", "lasts_s"), [(1.0, 20.0), (0.5, 40.0), (2.0, 10.0)])
def test_a_slow_path_keeps_its_timing_at_every_speed(planner, at_home, speed, lasts_s):
    asked = problem(at_home, lasts_s=20.0, reach_rad=0.3, speed=speed)
    motion = planner.answer(asked).trajectory
    assert motion.duration_s == pytest.approx(lasts_s, rel=0.02)
    halfway = NaturalSpline(asked.time_s, asked.positions_rad)(np.array([10.0]))[0]
    assert np.abs(motion.sample(motion.duration_s / 2.0)[0] - halfway).max() < 0.01


def test_a_path_through_something_is_refused_with_when_and_what(planner, collision, at_home, put):
    asked = problem(at_home)
    place = dict(zip(JOINTS, asked.positions_rad[len(asked.positions_rad) // 2], strict=True))
    place_q = np.array([place.get(name, 0.0) for name in collision.joint_names])
    place_m = tip_positions_m(collision, [place_q], "gripper_frame_link")[0].tolist()
    put(planner, thing(Box((0.03, 0.03, 0.03)), *place_m, name="crate"))
    refused = planner.answer(asked)
    assert isinstance(refused, PlanningFailure)
    assert refused.code is MoveItErrorCode.INVALID_MOTION_PLAN
    assert "crate" in refused.message
    assert 0.0 < refused.details["contact_s"] < asked.time_s[-1]


def test_a_path_that_begins_in_contact_or_goes_beyond_a_limit_is_refused_with_the_joint(planner, robot, at_home):
    folded = at_home | {"shoulder_lift": -1.7, "wrist_flex": 1.2}
    asked = JointPathProblem(folded, ("elbow_flex",), np.array([0.0, 1.0]), np.array([[1.69], [0.5]]))
    assert planner.answer(asked).details["contact_s"] == 0.0
    points = np.array([[0.0], [robot.joints["elbow_flex"].upper + 2.0 * LIMIT_TOLERANCE_RAD], [0.0]])
    refused = planner.answer(JointPathProblem(at_home, ("elbow_flex",), np.array([0.0, 2.0, 4.0]), points))
    assert "joint 'elbow_flex' would be at" in refused.message


def test_a_path_that_is_none_is_refused(planner, at_home):
    for change, says in (
        ({"joint_names": ("knee", "elbow_flex", "gripper")}, "knee"),
        ({"joint_names": ("gripper", "elbow_flex", "gripper")}, "each once"),
        ({"speed": 0.0}, "speed must be above 0, not 0"),
        ({"speed": float("inf")}, "speed"),
        ({"time_s": np.zeros(41)}, "times that increase"),
        ({"time_s": np.zeros(1), "positions_rad": np.zeros((1, 3))}, "2 points or more"),
        ({"positions_rad": np.full((41, 3), np.nan)}, "finite"),
        ({"positions_rad": np.full((41, 3), 0.1)}, "stands still"),
        ({"start_rad": {}}, ""),
    ):
        refused = planner.answer(replace(problem(at_home), **change))
        assert isinstance(refused, PlanningFailure), says
        assert says in refused.message


def test_the_rest_of_a_motion_of_joints_of_two_groups_is_checked_again(planner, at_home):
    motion = planner.answer(problem(at_home)).trajectory
    others = {name: value for name, value in at_home.items() if name not in motion.joint_names}
    assert planner.answer(RecheckQuestion("", motion, others, 0.0)).contact is None
    still = np.zeros((1, 1))
    strange = Trajectory(("knee",), np.zeros(1), still, still, still)
    assert isinstance(planner.answer(RecheckQuestion("", strange, others, 0.0)), PlanningFailure)

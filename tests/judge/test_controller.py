"""The controller's motions, stops and grips in physics beside the light emulation, whose claims they confirm."""

import numpy as np
import pytest

from planners.goals import JointGoal
from planners.problem import Plan, PlanningProblem
from robot.messages import GuardLimits, Outcome
from robot.trajectory import Trajectory
from tests.helpers.arm_rig import NAMES
from tests.helpers.motions import smooth_move
from tests.judge.physical_arm import ArmInWorld, Played, planner
from tests.robot.physics.test_world import AROUND, BLOCK

GRIPPER = NAMES.index("gripper")

# Targets: far, and loaded by the whole stretched arm.
TARGETS = (
    {"shoulder_pan": 1.0, "shoulder_lift": 0.8, "elbow_flex": -0.5},
    {"shoulder_lift": 0.9, "elbow_flex": -0.9, "wrist_roll": 1.0},
)


def planned(start_rad: dict[str, float], speed: float = 1.0, **goal_rad: float) -> Trajectory:
    plan = planner().plan(PlanningProblem("arm", start_rad, JointGoal(goal_rad), velocity_scaling=speed))
    assert isinstance(plan, Plan)
    return plan.trajectory


def error_rad(motion: Played) -> np.ndarray:
    """Following error of each tick, shape (ticks, joints) [rad]."""
    return np.subtract(motion.goal_rad, motion.position_rad)


@pytest.mark.parametrize("target", TARGETS, ids=["far", "stretched"])
def test_following_error_droop_and_settling_are_near_the_light_emulations(target: dict[str, float]) -> None:
    light, physical = (ArmInWorld(physics=physics) for physics in (False, True))
    trajectory = planned(light.goals_rad, **target)
    motions = [arm.play(trajectory) for arm in (light, physical)]
    assert [each.outcome for each in motions] == [Outcome.REACHED] * 2
    largest_rad = [np.abs(error_rad(each)).max(axis=0) for each in motions]
    assert largest_rad[1] == pytest.approx(largest_rad[0], abs=0.05)
    assert motions[1].position_rad[-1] == pytest.approx(motions[0].position_rad[-1], abs=0.006)
    ticks = [len(each.position_rad) for each in motions]
    assert ticks[1] == pytest.approx(ticks[0], abs=30)


@pytest.mark.parametrize(("after_s", "speed"), [(0.3, 1.0), (0.6, 0.2)])
def test_a_stop_ends_where_the_light_emulation_stops(after_s: float, speed: float) -> None:
    light, physical = (ArmInWorld(physics=physics) for physics in (False, True))
    trajectory = planned(light.goals_rad, speed, shoulder_pan=1.5, shoulder_lift=0.6)
    motions = [arm.play(trajectory, stop_after_s=after_s) for arm in (light, physical)]
    assert [each.outcome for each in motions] == [Outcome.STOPPED] * 2
    stop = round(after_s / 0.01)
    way_rad = [np.subtract(each.position_rad[-1], each.position_rad[stop]) for each in motions]
    assert abs(way_rad[0]).max() > 0.02 * speed
    assert way_rad[1] == pytest.approx(way_rad[0], abs=0.03)
    for each, way in zip(motions, way_rad, strict=True):
        assert (np.ptp(np.array(each.position_rad[stop:]), axis=0) - abs(way)).max() < 0.02, "an overshoot"


def test_a_grip_ends_well_holds_the_block_and_is_as_strong_as_it_is_allowed_to_be() -> None:
    depth_m, load = [], []
    for share in (0.3, 1.0):
        arm = ArmInWorld(BLOCK, **AROUND)
        closing = smooth_move({"gripper": (arm.goals_rad["gripper"], -0.1)}, 1.2)
        motion = arm.play(closing, gripping=True, torque_share=share)
        assert motion.outcome is Outcome.GRIPPED, motion.message
        assert arm.world.moved_bodies(every=True).bodies[0].held
        depth_m.append(max(depth for pair, depth in motion.depth_m.items() if "object/block" in pair))
        load.append(abs(float(arm.state.load[GRIPPER])))
    # Of 25 mm between the fingers, whose contacts are as soft as rubber.
    assert depth_m[0] < depth_m[1] < 0.004, "a block that is crushed"
    limit = GuardLimits().gripper_torque_limit
    assert load[0] == pytest.approx(0.3 * limit, abs=0.01)
    assert load[0] < load[1] <= limit

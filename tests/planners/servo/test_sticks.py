"""Sticks moved at random above a table, whose distance is kept whatever the other joints do."""

import time
from dataclasses import replace

import numpy as np
import pytest

from planners.geometry.collision import CollisionModel
from planners.pipeline import Planner
from planners.scene import Box
from planners.servo.question import JointVelocities, ServoLimits, TipTwist
from robot.description import model
from robot.description.model import RobotModel
from robot.description.robot_folder import built_in
from tests.helpers.resources import in_proportion
from tests.helpers.robots import SEVEN_JOINT_SRDF, SEVEN_JOINT_URDF
from tests.planners.scenes import thing
from tests.planners.servo.steering import SteeredArm, least_distance_m

LIMITS = ServoLimits()
HOLD_S, TRIAL_S = 0.4, 3.2

FETCH_RAD = {"shoulder_lift_joint": 0.3, "elbow_flex_joint": 0.8, "wrist_flex_joint": 0.6, "torso_lift_joint": 0.2}
# An arm with its tip, where it starts [rad], how high the table is [m], and seeds of sticks.
OTHERS = {
    # Its joints speed up twice as fast as the SO-101's. If acceleration took 0.06 s to its limit, these seeds would
    # drive it into the table.
    "koch": (built_in("koch_v1_1").model, "gripper_frame_link", {}, -0.01, (4, 37)),
    "seven": (model.parse(SEVEN_JOINT_URDF, SEVEN_JOINT_SRDF), "tool", {"a2": 0.5, "a4": 1.2, "a6": 0.8}, 0.0, (4,)),
    "fetch": (built_in("fetch").model, "gripper_link", FETCH_RAD, 0.12, (4,)),
}


@pytest.fixture
def table(planner: Planner, changing: CollisionModel, put) -> CollisionModel:
    for part in (planner, changing):
        put(part, thing(Box((1.0, 1.0, 0.04)), 0.3, 0.0, -0.03))
    return changing


def stick(turns: np.ndarray, ways: np.ndarray):
    """A stick that is held for a while, then moved to another place, shape (places, 3) each."""

    def command(at_s: float) -> TipTwist:
        number = round(at_s / HOLD_S - 0.5) % len(turns)
        linear, angular = ways[number] * LIMITS.linear_m_s, turns[number] * LIMITS.angular_rad_s
        return TipTwist(tuple(linear.tolist()), tuple(angular.tolist()))

    return command


def random_stick(seed: int):
    """A stick that points downwards, more or less, and turns at random."""
    turns, ways = np.random.default_rng(seed).normal(size=(2, round(TRIAL_S / HOLD_S), 3))
    turns, ways = (drawn / np.linalg.norm(drawn, axis=1, keepdims=True) for drawn in (turns, ways))
    ways[:, 2] = -np.abs(ways[:, 2])
    return stick(turns, ways)


REVERSED = stick(np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]), np.array([[0.0, 0.0, -1.0]] * 2))


@pytest.mark.parametrize("seed", [None, *range(in_proportion(4))])
def test_random_sticks_and_a_turn_that_is_reversed_on_the_way_down_keep_the_distance(planner, robot, table, seed):
    arm = SteeredArm(planner, robot)
    arm.steer(REVERSED if seed is None else random_stick(seed), TRIAL_S)
    assert least_distance_m(arm, table) > LIMITS.scene_distance_m


@pytest.mark.parametrize("name", OTHERS)
def test_random_sticks_keep_the_distance_on_other_arms(name: str, put) -> None:
    robot, tip, start_rad, table_m, seeds = OTHERS[name]
    planner, collision = Planner(robot, time.process_time), CollisionModel(robot)
    for part in (planner, collision):
        put(part, thing(Box((2.0, 2.0, 0.04)), 0.5, 0.0, table_m - 0.02))
    for seed in seeds:
        arm = SteeredArm(planner, robot, start_rad, tip=tip)
        arm.steer(random_stick(seed), TRIAL_S)
        assert least_distance_m(arm, collision) > LIMITS.scene_distance_m, seed


START = {"shoulder_pan": 1.5, "shoulder_lift": 0.6, "elbow_flex": -0.6}


def with_brakes(robot: RobotModel, acceleration_rad_s2: float) -> RobotModel:
    """The robot with another acceleration limit of all joints, at least as fast as the SO-101's servos."""
    joints = {
        name: replace(joint, max_velocity=2.5, max_acceleration=acceleration_rad_s2) if joint.max_velocity else joint
        for name, joint in robot.joints.items()
    }
    # With its hulls alone it is loaded in no time.
    return replace(robot, joints=joints, parts={}, surfaces={})


@pytest.mark.parametrize(("acceleration_rad_s2", "period_s"), [(1.0, 0.06), (6.0, 0.02)])
def test_a_fast_joint_stops_before_a_wall(robot: RobotModel, put, acceleration_rad_s2: float, period_s: float) -> None:
    robot = with_brakes(robot, acceleration_rad_s2)
    planner, collision = Planner(robot, time.process_time), CollisionModel(robot)
    for part in (planner, collision):
        put(part, thing(Box((1.0, 0.02, 1.0)), 0.0, 0.26, 0.3))
    arm = SteeredArm(planner, robot, START, period_s=period_s)
    answer = arm.steer(JointVelocities({"shoulder_pan": -2.5}), 4.0)
    assert LIMITS.scene_distance_m < least_distance_m(arm, collision) < 0.05
    assert "near each other" in answer.message

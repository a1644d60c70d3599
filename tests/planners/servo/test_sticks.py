"""Sticks moved at random above a table, whose distance is kept whatever the other joints do."""

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from planners.geometry.collision import CollisionModel
from planners.pipeline import Planner
from planners.scene import Box
from planners.servo.question import JointVelocities, ServoLimits, TipTwist
from robot.description import model, robot_folder
from robot.description.model import RobotModel
from tests.helpers.resources import in_proportion
from tests.helpers.robots import SEVEN_JOINT_SRDF, SEVEN_JOINT_URDF
from tests.planners.scenes import scene, thing
from tests.planners.servo.steering import SteeredArm, least_distance_m

LIMITS = ServoLimits()
HOLD_S, TRIAL_S = 0.4, 3.2

# With acceleration that takes 0.06 s to its limit, these drive the Koch into the table.
SEEDS = (4, 37)


class OtherArm(NamedTuple):
    """An arm with its tip, where it starts [rad], and how high the table is [m]."""

    robot: RobotModel
    tip: str
    start_rad: Mapping[str, float]
    table_m: float


OTHERS = {
    # Its joints speed up twice as fast as the SO-101's.
    "koch": OtherArm(robot_folder.built_in("koch_v1_1").model, "gripper_frame_link", {}, -0.01),
    "seven": OtherArm(model.parse(SEVEN_JOINT_URDF, SEVEN_JOINT_SRDF), "tool", {"a2": 0.5, "a4": 1.2, "a6": 0.8}, 0.0),
    "fetch": OtherArm(
        robot_folder.built_in("fetch").model,
        "gripper_link",
        {"shoulder_lift_joint": 0.3, "elbow_flex_joint": 0.8, "wrist_flex_joint": 0.6, "torso_lift_joint": 0.2},
        0.12,
    ),
}


@pytest.fixture
def table(planner: Planner, changing: CollisionModel, put) -> CollisionModel:
    for part in (planner, changing):
        put(part, thing(Box((1.0, 1.0, 0.04)), 0.3, 0.0, -0.03))
    return changing


def stick(turns: list[tuple[float, float, float]], downwards: list[tuple[float, float, float]]):
    """A stick that is held for a while, then moved to another place."""

    def command(at_s: float) -> TipTwist:
        number = round(at_s / HOLD_S - 0.5) % len(turns)
        linear = np.array(downwards[number]) * LIMITS.linear_m_s
        angular = np.array(turns[number]) * LIMITS.angular_rad_s
        return TipTwist((linear[0], linear[1], linear[2]), (angular[0], angular[1], angular[2]))

    return command


def test_a_turn_that_is_reversed_on_the_way_down_keeps_the_distance(planner, robot, table) -> None:
    arm = SteeredArm(planner, robot)
    arm.steer(stick([(0.0, 1.0, 0.0), (0.0, -1.0, 0.0)], [(0.0, 0.0, -1.0)] * 2), TRIAL_S)
    assert least_distance_m(arm, table) > LIMITS.scene_distance_m


def random_stick(seed: int):
    """A stick that points downwards, more or less, and turns at random."""
    random = np.random.default_rng(seed)
    count = round(TRIAL_S / HOLD_S)
    drawn = random.normal(size=(2, count, 3))
    drawn /= np.linalg.norm(drawn, axis=2, keepdims=True)
    drawn[1, :, 2] = -np.abs(drawn[1, :, 2])
    return stick([tuple(turn) for turn in drawn[0]], [tuple(way) for way in drawn[1]])


@pytest.mark.parametrize("seed", range(in_proportion(4)))
def test_random_sticks_keep_the_distance(planner, robot, table, seed: int) -> None:
    arm = SteeredArm(planner, robot)
    arm.steer(random_stick(seed), TRIAL_S)
    assert least_distance_m(arm, table) > LIMITS.scene_distance_m


@pytest.mark.parametrize("name", OTHERS)
def test_random_sticks_keep_the_distance_on_other_arms(name: str, put) -> None:
    other = OTHERS[name]
    planner, collision = Planner(other.robot, time.process_time), CollisionModel(other.robot)
    for part in (planner, collision):
        put(part, thing(Box((2.0, 2.0, 0.04)), 0.5, 0.0, other.table_m - 0.02))
    seeds = SEEDS if name == "koch" else SEEDS[:1]
    for seed in seeds:
        arm = SteeredArm(planner, other.robot, other.start_rad, tip=other.tip)
        arm.steer(random_stick(seed), TRIAL_S)
        assert least_distance_m(arm, collision) > LIMITS.scene_distance_m, seed


BESIDE = scene(thing(Box((1.0, 0.02, 1.0)), 0.0, 0.26, 0.3))
START = {"shoulder_pan": 1.5, "shoulder_lift": 0.6, "elbow_flex": -0.6}


def with_brakes(robot: RobotModel, acceleration_rad_s2: float) -> RobotModel:
    """The robot with another acceleration limit of all joints, at least as fast as the SO-101's servos."""
    joints = {
        name: replace(joint, max_velocity=2.5, max_acceleration=acceleration_rad_s2) if joint.max_velocity else joint
        for name, joint in robot.joints.items()
    }
    return replace(robot, joints=joints)


@pytest.mark.parametrize(("acceleration_rad_s2", "period_s"), [(1.0, 0.06), (6.0, 0.02)])
def test_a_fast_joint_stops_before_a_wall(robot: RobotModel, acceleration_rad_s2: float, period_s: float) -> None:
    robot = with_brakes(robot, acceleration_rad_s2)
    planner, collision = Planner(robot, time.process_time), CollisionModel(robot)
    assert planner.set_scene(BESIDE) is None
    collision.set_scene(BESIDE)
    arm = SteeredArm(planner, robot, START, period_s=period_s)
    answer = arm.steer(JointVelocities({"shoulder_pan": -2.5}), 4.0)
    assert ServoLimits().scene_distance_m < least_distance_m(arm, collision) < 0.05
    assert "near each other" in answer.message

"""A wall in the way of a fast joint: the arm stands before it, with whatever limits it has."""

from __future__ import annotations

from dataclasses import replace

import pytest

from planners.geometry.collision import CollisionModel
from planners.pipeline import Planner
from planners.scene import Box
from planners.servo.question import JointVelocities, ServoLimits
from robot.description.model import RobotModel
from tests.planners.scenes import scene, thing
from tests.planners.servo.steering import SteeredArm, least_distance_m

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
    planner, collision = Planner(robot), CollisionModel(robot)
    assert planner.set_scene(BESIDE) is None
    collision.set_scene(BESIDE)
    arm = SteeredArm(planner, robot, START, period_s=period_s)
    answer = arm.steer(JointVelocities({"shoulder_pan": -2.5}), 4.0)
    assert ServoLimits().scene_distance_m < least_distance_m(arm, collision) < 0.05
    assert "near each other" in answer.message

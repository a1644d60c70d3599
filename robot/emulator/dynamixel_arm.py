"""Emulated arm with Dynamixel servos: its servos at a pose, and its hardware source."""

from __future__ import annotations

from collections.abc import Callable

from robot.calibration import JointCalibration
from robot.description.limits import JointBounds
from robot.description.model import RobotModel
from robot.emulator.arm import EmulatedArm, start_pose_rad
from robot.emulator.dynamixel import DYNAMIXEL, DynamixelServo
from robot.emulator.plant import Plant
from robot.hardware.config import EmulatedDynamixelConfig
from robot.hardware.dynamixel.family import Dynamixel, model_of
from robot.messages import GuardLimits


def emulated_dynamixel_arm(
    robot: RobotModel,
    config: EmulatedDynamixelConfig,
    bounds: JointBounds,
    limits: GuardLimits,
    clock: Callable[[], float],
) -> EmulatedArm[DynamixelServo]:
    """Build the emulated Dynamixel servos of an arm."""
    joints = config.calibration.joints
    servos = [_servo(joint, start_rad) for joint, start_rad in zip(joints, start_pose_rad(config), strict=True)]
    return EmulatedArm(robot, config, Dynamixel(), servos, DYNAMIXEL, bounds, limits, clock, holds=config.driven)


def _servo(joint: JointCalibration, start_rad: float) -> DynamixelServo:
    plant = Plant(
        position_ticks=joint.ticks_from_rad(start_rad) - joint.homing_offset,
        lower_stop_ticks=joint.range_min - joint.homing_offset,
        upper_stop_ticks=joint.range_max - joint.homing_offset,
    )
    limits = joint.range_min, joint.range_max
    return DynamixelServo(joint.servo_id, model_of(joint), plant, limits, joint.homing_offset, joint=joint.joint)

"""Emulated arm with Dynamixel servos: its servos at a pose, and its hardware source."""

from __future__ import annotations

from collections.abc import Callable

from robot.calibration import JointCalibration
from robot.description.limits import JointBounds
from robot.description.model import RobotModel
from robot.emulator.arm import EmulatedArm, hold, start_pose_rad
from robot.emulator.dynamixel import DYNAMIXEL, DynamixelServo
from robot.emulator.plant import Plant
from robot.hardware.config import EmulatedDynamixelConfig
from robot.hardware.dynamixel.bus import Bus
from robot.hardware.dynamixel.hardware import DynamixelHardware
from robot.hardware.dynamixel.servo_map import model_of
from robot.hardware.interface import HardwareInterface
from robot.messages import GuardLimits


class EmulatedDynamixelArm(EmulatedArm[DynamixelServo]):
    """Emulated Dynamixel servos of an arm.

    Args:
        robot: description of the arm.
        config: calibration, faults and start of the servos.
        bounds: soft limits of the joints.
        guard_limits: torque limits.
        clock: time of the control loop [s].
    """

    def __init__(
        self,
        robot: RobotModel,
        config: EmulatedDynamixelConfig,
        bounds: JointBounds,
        guard_limits: GuardLimits,
        clock: Callable[[], float],
    ) -> None:
        self._config = config
        self._bounds = bounds
        self._guard_limits = guard_limits
        self._clock = clock
        joints = config.calibration.joints
        servos = [_servo(joint, start) for joint, start in zip(joints, start_pose_rad(config), strict=True)]
        if config.driven:
            hold(servos, config.calibration, guard_limits)
        super().__init__(robot, config, servos, DYNAMIXEL, clock)

    def _hardware(self) -> HardwareInterface:
        bus = Bus(self.port, self._clock)
        return DynamixelHardware(bus, self._config, self._bounds, self._guard_limits, self._clock)


def _servo(joint: JointCalibration, start_rad: float) -> DynamixelServo:
    plant = Plant(
        position_ticks=joint.ticks_from_rad(start_rad) - joint.homing_offset,
        lower_stop_ticks=joint.range_min - joint.homing_offset,
        upper_stop_ticks=joint.range_max - joint.homing_offset,
    )
    limits = joint.range_min, joint.range_max
    return DynamixelServo(joint.servo_id, model_of(joint), plant, limits, joint.homing_offset, joint=joint.joint)

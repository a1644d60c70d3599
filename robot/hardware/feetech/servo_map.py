"""Joints and servos side by side: arrays of radians on one hand, registers by servo id on the other."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from robot.calibration import Calibration, JointCalibration
from robot.description.limits import JointBounds
from robot.hardware.feetech.registers import GOAL_ADDRESS, Register, encode, goal_block
from robot.messages import GuardLimits
from robot.trajectory import Vector

# Goal_Velocity: leaves the servo room to catch up, and caps what a bad goal could do (2.8 rad/s).
VELOCITY_CAP_FACTOR = 1.3
VELOCITY_CAP_TICKS_S = 1800

# The register's largest value, 39 rad/s^2: smoothness comes from the trajectory, and any less adds lag.
SERVO_ACCELERATION = 254

PERMILLE = 1000

# Where the goal is in the block that is written to the servos.
GOAL_AT = Register.GOAL_POSITION - GOAL_ADDRESS


class ServoMap:
    """The servos of an arm.

    Args:
        calibration: joints, whose order is that of every array, and their servos.
        bounds: gives the velocity caps.
        limits: how hard the servos may push.

    Attributes:
        full_torque: register TORQUE_LIMIT of each servo that holds, shape (joints,) [0.1 %].
    """

    def __init__(self, calibration: Calibration, bounds: JointBounds, limits: GuardLimits | None = None) -> None:
        self.joints = calibration.joints
        self.names = tuple(joint.joint for joint in self.joints)
        self.ids = tuple(joint.servo_id for joint in self.joints)
        self.by_id = {joint.servo_id: joint for joint in self.joints}
        self.cap_ticks_s = {
            joint.servo_id: _velocity_cap(joint, float(speed))
            for joint, speed in zip(self.joints, bounds.max_velocity, strict=True)
        }
        self._offset_rad = [joint.rad_from_ticks(0.0) for joint in self.joints]
        self._rad_per_tick = [joint.rad_s_from_ticks_s(1.0) for joint in self.joints]
        blocks = {servo: goal_block(0, cap, SERVO_ACCELERATION) for servo, cap in self.cap_ticks_s.items()}
        self._around_goal = {servo: (block[:GOAL_AT], block[GOAL_AT + 2 :]) for servo, block in blocks.items()}
        limits = limits or GuardLimits()
        full, gripper = round(limits.torque_limit * PERMILLE), round(limits.gripper_torque_limit * PERMILLE)
        self.full_torque = np.array([gripper if joint.is_gripper else full for joint in self.joints])

    def label(self, servo_id: int) -> str:
        """Name a servo for people: its joint and its id."""
        return f"{self.by_id[servo_id].joint} (id {servo_id})"

    def goal_block(self, servo_id: int, goal_ticks: int) -> bytes:
        """Registers 41 to 47 of one servo for a goal [ticks]."""
        head, tail = self._around_goal[servo_id]
        return head + encode(Register.GOAL_POSITION, goal_ticks) + tail

    def goal_blocks(self, goal_rad: Vector) -> dict[int, bytes]:
        """Registers 41 to 47 of every servo for goals, shape (joints,) [rad]."""
        each = zip(self.ids, goal_rad.tolist(), self._offset_rad, self._rad_per_tick, strict=True)
        return {servo: self.goal_block(servo, round((goal - offset) / scale)) for servo, goal, offset, scale in each}

    def positions_rad(self, ticks: Iterable[int]) -> list[float]:
        """Positions [ticks] in the order of the joints as radians."""
        each = zip(ticks, self._offset_rad, self._rad_per_tick, strict=True)
        return [offset + position * scale for position, offset, scale in each]

    def velocities_rad_s(self, ticks_s: Iterable[int]) -> list[float]:
        """Velocities [ticks/s] in the order of the joints as rad/s."""
        return [speed * scale for speed, scale in zip(ticks_s, self._rad_per_tick, strict=True)]

    def rad_from_ticks(self, ticks: dict[int, int]) -> Vector:
        """Positions by servo id [ticks] as an array, shape (joints,) [rad]."""
        return np.array(self.positions_rad([ticks[servo] for servo in self.ids]))

    def ticks_range(self, bounds: JointBounds) -> dict[int, tuple[int, int]]:
        """Lowest and highest tick of each servo within the soft limits."""
        ranges = {}
        for joint, lower, upper in zip(self.joints, bounds.lower_rad, bounds.upper_rad, strict=True):
            ends = joint.ticks_from_rad(float(lower)), joint.ticks_from_rad(float(upper))
            ranges[joint.servo_id] = min(ends), max(ends)
        return ranges


def _velocity_cap(joint: JointCalibration, speed_rad_s: float) -> int:
    wanted = math.ceil(abs(joint.ticks_s_from_rad_s(speed_rad_s)) * VELOCITY_CAP_FACTOR)
    return min(VELOCITY_CAP_TICKS_S, wanted)

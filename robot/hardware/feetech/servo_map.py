"""Conversion between joints and servos: arrays of radians to registers by servo id, and back."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from robot.calibration import Calibration, JointCalibration
from robot.description.limits import FASTEST_TICKS_S, JointBounds
from robot.hardware.feetech.registers import GOAL_ADDRESS, Register, encode, goal_block
from robot.messages import GuardLimits
from robot.trajectory import Vector

# Register GOAL_VELOCITY: lets the servo catch up.
VELOCITY_CAP_FACTOR = 1.3

# The register's largest value, 39 rad/s^2: smoothness comes from the trajectory, and any less adds lag.
SERVO_ACCELERATION = 254

PERMILLE = 1000

# Offset of the goal in the block that is written to the servos.
GOAL_AT = Register.GOAL_POSITION - GOAL_ADDRESS


class ServoMap:
    """Servos of an arm, by joint.

    Args:
        calibration: joints, whose order is that of every array, and their servos.
        bounds: limits of the joints, of which the velocities become the servos' velocity caps.
        limits: torque limits; None for the defaults.

    Attributes:
        joints: calibration of each joint.
        names: name of each joint.
        ids: servo id of each joint.
        by_id: calibration by servo id.
        cap_ticks_s: velocity cap by servo id [ticks/s].
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
        self.full_torque = np.array([gripper if joint.servo.gripper else full for joint in self.joints])

    def limit_torque(self, max_torque: Vector) -> None:
        """Lower :attr:`full_torque` to what the servos are set to give.

        Args:
            max_torque: largest share of full duty, shape (joints,).
        """
        self.full_torque = np.minimum(self.full_torque, np.round(max_torque * PERMILLE).astype(int))

    def label(self, servo_id: int) -> str:
        """Return a servo's joint and id for people."""
        return f"{self.by_id[servo_id].joint} (id {servo_id})"

    def goal_block(self, servo_id: int, goal_ticks: int) -> bytes:
        """Build registers 41 to 47 of one servo for a goal [ticks]."""
        head, tail = self._around_goal[servo_id]
        return head + encode(Register.GOAL_POSITION, goal_ticks) + tail

    def goal_blocks(self, goal_rad: Vector) -> dict[int, bytes]:
        """Build registers 41 to 47 of every servo for goals, shape (joints,) [rad]."""
        each = zip(self.ids, goal_rad.tolist(), self._offset_rad, self._rad_per_tick, strict=True)
        return {servo: self.goal_block(servo, round((goal - offset) / scale)) for servo, goal, offset, scale in each}

    def positions_rad(self, ticks: Iterable[int]) -> list[float]:
        """Convert positions in the order of the joints from ticks to radians."""
        each = zip(ticks, self._offset_rad, self._rad_per_tick, strict=True)
        return [offset + position * scale for position, offset, scale in each]

    def velocities_rad_s(self, ticks_s: Iterable[int]) -> list[float]:
        """Convert velocities in the order of the joints from ticks/s to rad/s."""
        return [speed * scale for speed, scale in zip(ticks_s, self._rad_per_tick, strict=True)]

    def rad_from_ticks(self, ticks: dict[int, int]) -> Vector:
        """Convert positions by servo id [ticks] to an array, shape (joints,) [rad]."""
        return np.array(self.positions_rad([ticks[servo] for servo in self.ids]))

    def ticks_range(self, bounds: JointBounds) -> dict[int, tuple[int, int]]:
        """Return the lowest and highest tick of each servo within the soft limits, by id."""
        ranges = {}
        for joint, lower, upper in zip(self.joints, bounds.lower_rad, bounds.upper_rad, strict=True):
            ends = joint.ticks_from_rad(float(lower)), joint.ticks_from_rad(float(upper))
            ranges[joint.servo_id] = min(ends), max(ends)
        return ranges


def _velocity_cap(joint: JointCalibration, speed_rad_s: float) -> int:
    wanted = math.ceil(abs(joint.ticks_s_from_rad_s(speed_rad_s)) * VELOCITY_CAP_FACTOR)
    return min(FASTEST_TICKS_S, wanted)

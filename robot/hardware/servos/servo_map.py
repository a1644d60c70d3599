"""Conversion between joints and servos: arrays of radians to registers by servo id, and back.

A servo that counts turns forgets them when it loses its supply: its position may differ from the calibrated one by
whole turns. No joint turns further than half a turn from the middle of its calibrated range, so the turns are those
that bring a position nearest to that middle (:meth:`ServoMap.turns_ticks`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from robot.calibration import TICKS_PER_TURN, Calibration
from robot.description.limits import FASTEST_TICKS_S, JointBounds
from robot.hardware.servos.family import ServoFamily, label
from robot.messages import GuardLimits
from robot.trajectory import Vector

VELOCITY_CAP_FACTOR = 1.3  # a servo may be this much faster than its joint, so that it can catch up

# Distance of a joint's limits from the place half a turn from its middle, where its turns become ambiguous (18 deg).
SEAM_TICKS = 200


class ServoMap:
    """Servos of an arm in the calibration's order; the joints' greatest velocities become their velocity caps."""

    def __init__(
        self, family: ServoFamily, calibration: Calibration, bounds: JointBounds, limits: GuardLimits | None = None
    ) -> None:
        self.joints = calibration.joints
        self.names = tuple(joint.joint for joint in self.joints)
        self.ids = tuple(joint.servo_id for joint in self.joints)
        self.by_id = {joint.servo_id: joint for joint in self.joints}
        self.speed_ticks_s = {
            joint.servo_id: min(FASTEST_TICKS_S, abs(joint.ticks_s_from_rad_s(float(speed))) * VELOCITY_CAP_FACTOR)
            for joint, speed in zip(self.joints, bounds.max_velocity, strict=True)
        }
        self.full_torque = full_torque(calibration, limits or GuardLimits())  # shares of full duty, shape (joints,)
        self._encode, self._goal = family.registers.encode, family.registers.goal_position
        self._around_goal = {servo: family.around_goal(speed) for servo, speed in self.speed_ticks_s.items()}
        self._counts_turns = family.counts_turns
        self._middle_ticks = {joint.servo_id: (joint.range_min + joint.range_max) / 2.0 for joint in self.joints}
        self._offset_rad = [joint.rad_from_ticks(0.0) for joint in self.joints]
        self._rad_per_tick = [joint.rad_s_from_ticks_s(1.0) for joint in self.joints]
        self._sign = [math.copysign(1.0, scale) for scale in self._rad_per_tick]

    def limit_torque(self, max_torque: Vector) -> None:
        """Lower :attr:`full_torque` to the shares of full duty that the servos are set to give, shape (joints,)."""
        self.full_torque = np.minimum(self.full_torque, max_torque)

    def by_servo(self, values: Vector) -> dict[int, float]:
        """Return the values of an array, shape (joints,), by servo id."""
        return dict(zip(self.ids, values.tolist(), strict=True))

    def label(self, servo_id: int) -> str:
        """Return a servo's joint and id for people."""
        return label(self.by_id[servo_id])

    def turns_ticks(self, servo_id: int, present_ticks: int) -> int:
        """Return the whole turns that bring a servo's present position into its calibrated range [ticks]."""
        if not self._counts_turns:
            return 0
        return round((self._middle_ticks[servo_id] - present_ticks) / TICKS_PER_TURN) * TICKS_PER_TURN

    def certain_ticks(self, servo_id: int) -> tuple[int, int]:
        """Return the lowest and highest calibrated position at which a servo's turns are certain [ticks]."""
        middle, half = self._middle_ticks[servo_id], TICKS_PER_TURN // 2 - SEAM_TICKS
        return math.ceil(middle - half), math.floor(middle + half)

    def goal_block(self, servo_id: int, goal_ticks: int) -> bytes:
        """Build the block at the family's ``goal_address`` for a goal in the servo's own turns [ticks]."""
        head, tail = self._around_goal[servo_id]
        return head + self._encode(self._goal, goal_ticks) + tail

    def goal_blocks(self, goal_rad: Vector, turns_ticks: Mapping[int, int]) -> dict[int, bytes]:
        """Build all servos' blocks for goals, shape (joints,) [rad], less their turns by id [ticks]."""
        goals = self.goals_ticks(goal_rad)
        if turns_ticks:
            goals = {servo: ticks - turns_ticks.get(servo, 0) for servo, ticks in goals.items()}
        return {servo: self.goal_block(servo, ticks) for servo, ticks in goals.items()}

    def goals_ticks(self, goal_rad: Vector) -> dict[int, int]:
        """Convert goals, shape (joints,) [rad], to calibrated positions by servo id [ticks]."""
        each = zip(self.ids, goal_rad.tolist(), self._offset_rad, self._rad_per_tick, strict=True)
        return {servo: round((goal - offset) / scale) for servo, goal, offset, scale in each}

    def positions_rad(self, ticks: Iterable[float]) -> list[float]:
        """Convert calibrated positions in the order of the joints from ticks to radians."""
        each = zip(ticks, self._offset_rad, self._rad_per_tick, strict=True)
        return [offset + position * scale for position, offset, scale in each]

    def velocities_rad_s(self, ticks_s: Iterable[float]) -> list[float]:
        """Convert velocities in the order of the joints from ticks/s to rad/s."""
        return [speed * scale for speed, scale in zip(ticks_s, self._rad_per_tick, strict=True)]

    def signed(self, values: Iterable[float]) -> list[float]:
        """Give loads or currents of the servos' rotation, in the order of the joints, the joints' signs."""
        return [value * sign for value, sign in zip(values, self._sign, strict=True)]

    def rad_from_ticks(self, ticks: Mapping[int, int]) -> Vector:
        """Convert calibrated positions by servo id [ticks] to an array, shape (joints,) [rad]."""
        return np.array(self.positions_rad([ticks[servo] for servo in self.ids]))

    def ticks_range(self, bounds: JointBounds) -> dict[int, tuple[int, int]]:
        """Return the lowest and highest calibrated position of each servo within the soft limits, by id [ticks]."""
        ranges = {}
        for joint, lower, upper in zip(self.joints, bounds.lower_rad, bounds.upper_rad, strict=True):
            ends = joint.ticks_from_rad(float(lower)), joint.ticks_from_rad(float(upper))
            ranges[joint.servo_id] = min(ends), max(ends)
        return ranges


def full_torque(calibration: Calibration, limits: GuardLimits) -> Vector:
    """Return the share of full duty that each joint may use at most, shape (joints,)."""
    return np.array(
        [limits.gripper_torque_limit if joint.servo.gripper else limits.torque_limit for joint in calibration.joints]
    )

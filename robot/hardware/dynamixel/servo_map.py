"""Conversion between joints and servos: arrays of radians to registers by servo id, and back.

A servo in extended mode counts turns, and forgets them when it loses its supply: its position may differ from the
calibrated one by whole turns. No joint turns further than half a turn from the middle of its calibrated range, so the
turns are those that bring a position nearest to that middle (:meth:`ServoMap.turns_ticks`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from robot.calibration import TICKS_PER_TURN, Calibration, JointCalibration
from robot.description.limits import FASTEST_TICKS_S, JointBounds
from robot.errors import StartupError
from robot.hardware.dynamixel.registers import (
    FULL_PWM,
    MODELS,
    TICKS_S2_PER_ACCELERATION_UNIT,
    TICKS_S_PER_VELOCITY_UNIT,
    Model,
)
from robot.messages import GuardLimits
from robot.trajectory import Vector

# Register PROFILE_VELOCITY: lets the servo catch up.
VELOCITY_CAP_FACTOR = 1.3

# Register PROFILE_ACCELERATION, 39 rad/s^2: smoothness comes from the trajectory, and any less adds lag.
PROFILE_ACCELERATION = round(25400 / TICKS_S2_PER_ACCELERATION_UNIT)

# Distance of a joint's limits from the place half a turn from its middle, where its turns become ambiguous (18 deg).
SEAM_TICKS = 200


class ServoMap:
    """Servos of an arm, by joint.

    Args:
        calibration: joints, whose order is that of every array, and their servos.
        bounds: limits of the joints, of which the velocities become the servos' profile velocities.
        limits: torque limits; None for the defaults.

    Attributes:
        joints: calibration of each joint.
        names: name of each joint.
        ids: servo id of each joint.
        by_id: calibration by servo id.
        models: model by servo id.
        profile_velocity: register PROFILE_VELOCITY by servo id.
        full_torque: share of full duty that each joint may use at most, shape (joints,).
    """

    def __init__(self, calibration: Calibration, bounds: JointBounds, limits: GuardLimits | None = None) -> None:
        self.joints = calibration.joints
        self.names = tuple(joint.joint for joint in self.joints)
        self.ids = tuple(joint.servo_id for joint in self.joints)
        self.by_id = {joint.servo_id: joint for joint in self.joints}
        self.models: dict[int, Model] = {joint.servo_id: model_of(joint) for joint in self.joints}
        self.profile_velocity = {
            joint.servo_id: _profile_velocity(joint, float(speed))
            for joint, speed in zip(self.joints, bounds.max_velocity, strict=True)
        }
        limits = limits or GuardLimits()
        self.full_torque = np.array(
            [limits.gripper_torque_limit if joint.servo.gripper else limits.torque_limit for joint in self.joints]
        )
        self._full_share: dict[int, float] = dict(zip(self.ids, self.full_torque.tolist(), strict=True))
        self._middle_ticks = {joint.servo_id: (joint.range_min + joint.range_max) / 2.0 for joint in self.joints}
        self._rad_per_velocity_unit = [joint.rad_s_from_ticks_s(TICKS_S_PER_VELOCITY_UNIT) for joint in self.joints]
        # A positive duty turns the servo towards higher ticks.
        self._sign = [math.copysign(1.0, joint.rad_s_from_ticks_s(1.0)) for joint in self.joints]

    def label(self, servo_id: int) -> str:
        """Return a servo's joint and id for people."""
        return f"{self.by_id[servo_id].joint} (id {servo_id})"

    def full_share(self, servo_id: int) -> float:
        """Return the share of full duty that a servo may use at most."""
        return self._full_share[servo_id]

    def turns_ticks(self, servo_id: int, present_ticks: int) -> int:
        """Return the whole turns to add to a servo's positions for the calibrated ones [ticks].

        Args:
            servo_id: id of the servo.
            present_ticks: register PRESENT_POSITION.
        """
        return round((self._middle_ticks[servo_id] - present_ticks) / TICKS_PER_TURN) * TICKS_PER_TURN

    def calibrated_ticks(self, servo_id: int, present_ticks: int) -> int:
        """Return the calibrated position of a servo at a present position, without its turns [ticks]."""
        return present_ticks + self.turns_ticks(servo_id, present_ticks)

    def unambiguous_ticks(self, servo_id: int) -> tuple[int, int]:
        """Return the lowest and highest calibrated position at which a servo's turns are certain [ticks]."""
        middle, half = self._middle_ticks[servo_id], TICKS_PER_TURN // 2 - SEAM_TICKS
        return math.ceil(middle - half), math.floor(middle + half)

    def goals_ticks(self, goal_rad: Vector) -> dict[int, int]:
        """Convert goals, shape (joints,) [rad], to calibrated positions by servo id [ticks]."""
        each = zip(self.joints, goal_rad.tolist(), strict=True)
        return {joint.servo_id: joint.ticks_from_rad(goal) for joint, goal in each}

    def positions_rad(self, ticks: Iterable[float]) -> list[float]:
        """Convert calibrated positions in the order of the joints from ticks to radians."""
        return [joint.rad_from_ticks(position) for joint, position in zip(self.joints, ticks, strict=True)]

    def velocities_rad_s(self, units: Iterable[int]) -> list[float]:
        """Convert registers PRESENT_VELOCITY in the order of the joints to rad/s."""
        return [speed * scale for speed, scale in zip(units, self._rad_per_velocity_unit, strict=True)]

    def loads(self, pwm: Iterable[int]) -> list[float]:
        """Convert registers PRESENT_PWM in the order of the joints to shares of full duty, signed as the joints are."""
        return [duty * sign / FULL_PWM for duty, sign in zip(pwm, self._sign, strict=True)]

    def currents_a(self, ampere: Iterable[float]) -> list[float]:
        """Give currents in the order of the joints the joints' signs [A]."""
        return [current * sign for current, sign in zip(ampere, self._sign, strict=True)]

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


def model_of(joint: JointCalibration) -> Model:
    """Return the model of a joint's servo.

    Raises:
        StartupError: there is no such model.
    """
    model = MODELS.get(joint.servo.model)
    if model is None:
        raise StartupError(
            f"the servo of joint {joint.joint} is a {joint.servo.model!r} in the arm's robot.toml; known are "
            f"{', '.join(MODELS)}"
        )
    return model


def _profile_velocity(joint: JointCalibration, speed_rad_s: float) -> int:
    wanted = abs(joint.ticks_s_from_rad_s(speed_rad_s)) * VELOCITY_CAP_FACTOR
    return math.ceil(min(FASTEST_TICKS_S, wanted) / TICKS_S_PER_VELOCITY_UNIT)

"""Joints that emulated servos move in a physical world.

A servo's duty turns its joint as :class:`robot.emulator.plant.Plant` has it: friction in the gear carries most of a
weight, and the back-EMF brakes. The torque at the joint ends at the motor's stall torque, so a grip is no stronger than
a real one.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from robot.calibration import Calibration, JointCalibration
from robot.description.model import RobotModel
from robot.emulator.plant import (
    DROOP_TICKS_S_PER_PERMILLE,
    HAND_TICKS_S,
    NO_LOAD_TICKS_S,
    PUSH_TICKS_S_PER_PERMILLE,
    DrivenPlant,
)
from robot.emulator.servo import FULL_DUTY_PERMILLE, EmulatedServo
from robot.physics.arm_model import TIMESTEP_S
from robot.physics.world import World


class ServoJoint:
    """Joint of one servo: conversion between the plant's encoder ticks and the joint's position, and its torque."""

    def __init__(self, calibrated: JointCalibration, servo: EmulatedServo[Any]) -> None:
        before = servo.plant
        self.plant = servo.plant = DrivenPlant(before.position_ticks, before.lower_stop_ticks, before.upper_stop_ticks)
        self._calibrated = calibrated
        self._servo = servo
        self._gear_ticks = 0.0  # gear before the joint, from the middle of the backlash
        self.face()

    def face(self) -> None:
        """Follow the way in which the horn is mounted."""
        plant, calibrated = self.plant, self._calibrated
        ticks_per_rad = calibrated.ticks_s_from_rad_s(1.0)
        zero_ticks = self._servo.zero_ticks - calibrated.rad_from_ticks(0.0) * ticks_per_rad
        if self._servo.mirrored:
            ticks_per_rad, zero_ticks = -ticks_per_rad, plant.lower_stop_ticks + plant.upper_stop_ticks - zero_ticks
        self.ticks_per_rad, self.zero_ticks = ticks_per_rad, zero_ticks

    def rad(self, ticks: float) -> float:
        """Convert encoder ticks to a position [rad]."""
        return (ticks - self.zero_ticks) / self.ticks_per_rad

    @property
    def stops_rad(self) -> list[float]:
        """Mechanical stops, or an obstacle before one [rad]."""
        return sorted(self.rad(ticks) for ticks in self.plant.walls_ticks)

    def torque(self) -> tuple[float, float]:
        """Advance the motor by a time step; return the torque at the joint [Nm], and its damping [Nm s/rad]."""
        plant, servo = self.plant, self._servo
        plant.drive_motor(TIMESTEP_S, plant.drive)
        nm_per_permille = math.copysign(1.0 / servo.duty_permille_per_nm, self.ticks_per_rad)
        if plant.drive.torque_permille > 0.0:
            net_permille = plant.duty_permille - plant.velocity_ticks_s / NO_LOAD_TICKS_S * FULL_DUTY_PERMILLE
            most_nm = plant.drive.torque_permille / FULL_DUTY_PERMILLE * servo.stall_torque_nm
            # Within the backlash the gear turns as fast as nothing loads it, and pushes the joint from a flank on.
            way_ticks = net_permille / FULL_DUTY_PERMILLE * NO_LOAD_TICKS_S * TIMESTEP_S
            half_ticks = 0.5 * servo.backlash_ticks
            self._gear_ticks = max(-half_ticks, min(half_ticks, self._gear_ticks + way_ticks))
            push_nm = plant.push_permille * nm_per_permille
            if self._gear_ticks != math.copysign(half_ticks, net_permille):
                return push_nm, abs(self.ticks_per_rad * nm_per_permille) / PUSH_TICKS_S_PER_PERMILLE
            return push_nm + max(-most_nm, min(most_nm, net_permille * nm_per_permille)), 0.0
        eased = PUSH_TICKS_S_PER_PERMILLE / DROOP_TICKS_S_PER_PERMILLE
        damping = abs(self.ticks_per_rad * nm_per_permille) / DROOP_TICKS_S_PER_PERMILLE
        return plant.push_permille * eased * nm_per_permille, damping

    def follow(self, position_rad: float, velocity_rad_s: float) -> None:
        """Take position [rad] and velocity [rad/s] of the joint over into the encoder."""
        self.plant.position_ticks = self.zero_ticks + self.ticks_per_rad * position_rad
        self.plant.velocity_ticks_s = self.ticks_per_rad * velocity_rad_s


class ServoJoints:
    """Joints of an arm's servos, in the calibration's order."""

    def __init__(self, robot: RobotModel, calibration: Calibration, servos: Sequence[EmulatedServo[Any]]) -> None:
        self._joints = [ServoJoint(*each) for each in zip(calibration.joints, servos, strict=True)]
        names = [joint.joint for joint in calibration.joints]
        self.world = World(robot, names, self._encoder_rad())
        self._stops_rad: list[list[float]] = []

    def move(self, duration_s: float) -> None:
        """Move the joints for a time that passed [s]."""
        for joint in self._joints:
            joint.face()
        encoder_rad = self._encoder_rad()
        # A live command moved a joint by itself.
        if not np.allclose(encoder_rad, self.world.position_rad, rtol=0.0, atol=1e-9):
            self.world.place(encoder_rad)
        stops_rad = [joint.stops_rad for joint in self._joints]
        if stops_rad != self._stops_rad:
            self._stops_rad = stops_rad
            self.world.limit(*np.array(stops_rad).T)
        try:
            self.world.advance(duration_s, self._drive)
        finally:
            self._follow()

    def _encoder_rad(self) -> np.ndarray:
        return np.array([joint.rad(joint.plant.position_ticks) for joint in self._joints])

    def _drive(self) -> None:
        self._follow()
        torque_nm, damping = zip(*(joint.torque() for joint in self._joints), strict=True)
        self.world.push(np.array(torque_nm), np.array(damping))
        for index, joint in enumerate(self._joints):
            hand_ticks = joint.plant.hand_ticks
            if hand_ticks is not None:
                wanted = (hand_ticks - joint.plant.position_ticks) / TIMESTEP_S
                self.world.drag(index, max(-HAND_TICKS_S, min(HAND_TICKS_S, wanted)) / joint.ticks_per_rad)

    def _follow(self) -> None:
        world = self.world
        for joint, position, velocity in zip(
            self._joints, world.position_rad.tolist(), world.velocity_rad_s.tolist(), strict=True
        ):
            joint.follow(position, velocity)

"""Trajectories: joint positions over time, and the fastest motion of one joint from rest to rest."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate, chain, pairwise

import numpy as np
from numpy.typing import NDArray
from ruckig import ControlInterface, InputParameter, Ruckig, Synchronization
from ruckig import Trajectory as Profile

Vector = NDArray[np.float64]

# Bridges take a tick at least: without that ruckig found no profile for 161 of 20,000 drawn ones. Nearly all had joints
# at rest with a velocity by rounding, such as 1e-15 rad/s.
LEAST_BRIDGE_S = 0.01

LEAST_LIMIT = 1e-8  # limits below it are taken as it: ruckig finds no profile for some of them

# Acceleration reaches its limit within two ticks, in bridges and streams. Joints that reverse then follow their
# velocities so closely that what steering keeps away from stays away: with 0.06 s, random sticks drove a Koch v1.1 3 mm
# into a table that is kept 5 mm away (40 runs of 3.2 s, 10 of them nearer than 5 mm); with 0.02 s no run came nearer
# than 7.2 mm.
TIME_TO_FULL_ACCELERATION_S = 0.02


@dataclass(frozen=True)
class Trajectory:
    """Joint positions over time with continuous velocity."""

    joint_names: tuple[str, ...]  # joint of each column
    time_s: Vector  # shape (n,), n >= 1, strictly increasing from 0 [s]
    positions_rad: Vector  # shape (n, joints) [rad]
    velocities_rad_s: Vector  # shape (n, joints) [rad/s]
    accelerations_rad_s2: Vector  # shape (n, joints) [rad/s^2]

    @property
    def duration_s(self) -> float:
        return float(self.time_s[-1])

    @property
    def peak_speed_rad_s(self) -> Vector:
        """Greatest speed of each joint, also between the samples, shape (joints,) [rad/s]."""
        peaks = np.abs(self.velocities_rad_s).max(axis=0)
        span_s = np.diff(self.time_s)[:, None]
        m0, m1 = self.velocities_rad_s[:-1] * span_s, self.velocities_rad_s[1:] * span_s
        way = np.diff(self.positions_rad, axis=0)
        c2, c3 = 3.0 * way - 2.0 * m0 - m1, m0 + m1 - 2.0 * way
        # The velocity is a parabola between two samples: its vertex counts where it lies between them.
        curved = np.abs(c3) > 1e-12
        u = np.divide(-c2, 3.0 * c3, where=curved, out=np.zeros_like(c3))
        vertex = np.where(curved & (u > 0.0) & (u < 1.0), np.abs(m0 + u * c2) / span_s, 0.0)
        greatest: Vector = np.maximum(peaks, vertex.max(axis=0, initial=0.0))
        return greatest

    def of_joints(self, joint_names: tuple[str, ...]) -> Trajectory:
        """Return the same motion of some of its joints, in their order."""
        columns = [self.joint_names.index(name) for name in joint_names]
        arrays = self.positions_rad, self.velocities_rad_s, self.accelerations_rad_s2
        return Trajectory(joint_names, self.time_s, *(array[:, columns] for array in arrays))

    def then(self, motion: Trajectory) -> Trajectory:
        """Return this motion followed by one of the same joints, which begins where this one ends."""
        return Trajectory(
            self.joint_names,
            np.concatenate((self.time_s, motion.time_s[1:] + self.duration_s)),
            np.vstack((self.positions_rad, motion.positions_rad[1:])),
            np.vstack((self.velocities_rad_s, motion.velocities_rad_s[1:])),
            np.vstack((self.accelerations_rad_s2, motion.accelerations_rad_s2[1:])),
        )

    def sample(self, time_s: float) -> tuple[Vector, Vector, Vector]:
        """Interpolate by cubic Hermite polynomials: position, velocity and acceleration, each of shape (joints,)."""
        if time_s >= self.duration_s:
            return self.positions_rad[-1], self.velocities_rad_s[-1], self.accelerations_rad_s2[-1]
        if time_s <= 0.0:
            return self.positions_rad[0], self.velocities_rad_s[0], self.accelerations_rad_s2[0]
        i = int(np.searchsorted(self.time_s, time_s, side="right")) - 1
        span_s = self.time_s[i + 1] - self.time_s[i]
        u = (time_s - self.time_s[i]) / span_s
        p0, p1 = self.positions_rad[i], self.positions_rad[i + 1]
        m0, m1 = self.velocities_rad_s[i] * span_s, self.velocities_rad_s[i + 1] * span_s
        c2 = 3.0 * (p1 - p0) - 2.0 * m0 - m1
        c3 = 2.0 * (p0 - p1) + m0 + m1
        position = p0 + u * (m0 + u * (c2 + u * c3))
        velocity = (m0 + u * (2.0 * c2 + 3.0 * u * c3)) / span_s
        acceleration = (2.0 * c2 + 6.0 * u * c3) / span_s**2
        return position, velocity, acceleration


@dataclass(frozen=True)
class MotionLimits:
    """Limits of the joints of a motion, each of shape (joints,)."""

    velocity: Vector  # [rad/s]
    acceleration: Vector  # [rad/s^2]
    jerk: Vector  # [rad/s^3]


def bridge(
    joint_names: tuple[str, ...],
    start: tuple[Vector, Vector, Vector],
    end: tuple[Vector, Vector],
    limits: MotionLimits,
    least_s: float,
) -> Trajectory:
    """Plan the motion from one state of the joints to another within limits, in a time or as fast as the limits allow.

    The start has position, velocity and acceleration, the end position (NaN: at rest anywhere) and velocity. The
    profile is ruckig's; raises RuckigError where it finds none.
    """
    joints = len(joint_names)
    position, velocity, acceleration = start
    max_velocity, max_acceleration = limits.velocity, limits.acceleration
    given, profile = InputParameter(joints), Profile(joints)
    given.current_position, given.current_velocity = position.tolist(), velocity.tolist()
    given.current_acceleration = np.clip(acceleration, -max_acceleration, max_acceleration).tolist()
    stopping = np.isnan(end[0])
    given.target_position = np.where(stopping, position, end[0]).tolist()
    given.target_velocity = np.where(stopping, 0.0, np.clip(end[1], -max_velocity, max_velocity)).tolist()
    # A joint may be faster already: the limits may have changed since.
    given.max_velocity = np.maximum(max_velocity, np.abs(velocity)).tolist()
    given.max_acceleration = max_acceleration.tolist()
    given.max_jerk = limits.jerk.tolist()
    # Joints that come to rest do so by then, so that none goes on after the end.
    rests_s = np.abs(velocity) / max_acceleration + 2.0 * max_acceleration / limits.jerk
    given.minimum_duration = max(least_s, LEAST_BRIDGE_S, float(np.max(rests_s, where=stopping, initial=0.0)))
    interfaces = ControlInterface.Position, ControlInterface.Velocity
    given.per_dof_control_interface = [interfaces[int(each)] for each in stopping]
    given.per_dof_synchronization = [Synchronization.No if each else Synchronization.Time for each in stopping]
    Ruckig(joints).calculate(given, profile)
    return _of_profile(joint_names, profile)


def rest_to_rest(
    joint: str, start_rad: float, end_rad: float, max_velocity: float, max_acceleration: float
) -> Trajectory:
    """Plan the fastest motion of one joint from rest to rest: a trapezoid of its velocity."""
    given, profile = InputParameter(1), Profile(1)
    given.current_position, given.target_position = [start_rad], [end_rad]
    given.max_velocity, given.max_acceleration = [max(max_velocity, LEAST_LIMIT)], [max(max_acceleration, LEAST_LIMIT)]
    Ruckig(1).calculate(given, profile)
    return _of_profile((joint,), profile)


def _of_profile(joint_names: tuple[str, ...], profile: Profile) -> Trajectory:
    # Between the corners of all joints' profiles the positions are cubics; corners within a microsecond are one.
    ends = (accumulate((*each.brake.t, *each.t)) for each in profile.profiles[0])
    corners = sorted({0.0, *chain.from_iterable(ends)})
    kept = [corner for before, corner in pairwise((-1.0, *corners)) if corner - before > 1e-6]
    times_s = [*(corner for corner in kept if corner < profile.duration - 1e-6), profile.duration]
    times_s[0] = 0.0
    columns = (np.array(each) for each in zip(*map(profile.at_time, times_s), strict=True))
    return Trajectory(joint_names, np.array(times_s), *columns)

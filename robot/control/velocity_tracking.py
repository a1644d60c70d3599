"""Follows joint velocities that change at any time, with bounded acceleration and jerk, to the limits and no further.

A joint that is to move is sent to the limit ahead of it at the speed asked for: it is braked in time by itself, however
late the next wish comes. The profiles are ruckig's, the fastest within the bounds; each joint has its own.
"""

from __future__ import annotations

import numpy as np
from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from robot.limits import JointBounds
from robot.trajectory import Vector

# Acceleration grows to its limit within this time: motors and gears feel no knock, and a stick no delay.
TIME_TO_FULL_ACCELERATION_S = 0.06

# A slower wish is none: it is a servo's tick in two seconds.
LEAST_SPEED_RAD_S = 1e-3


class VelocityTracking:
    """Positions of some joints while they follow wishes.

    Args:
        bounds: limits of these joints, each of shape (joints,).
        position_rad: where they stand, at rest, shape (joints,) [rad].

    Attributes:
        position_rad: where they should be now, shape (joints,) [rad].
        velocity_rad_s: how fast they should be, shape (joints,) [rad/s].
    """

    def __init__(self, bounds: JointBounds, position_rad: Vector) -> None:
        joints = len(position_rad)
        self.position_rad, self.velocity_rad_s = position_rad.copy(), np.zeros(joints)
        self._acceleration_rad_s2 = np.zeros(joints)
        self._wished_rad_s = np.zeros(joints)
        # A joint that was switched on outside its limits may stay there, and come inside.
        self._lower_rad = np.minimum(bounds.lower_rad, position_rad)
        self._upper_rad = np.maximum(bounds.upper_rad, position_rad)
        self._max_velocity = bounds.max_velocity
        self._ruckig, self._input, self._profile = Ruckig(joints), InputParameter(joints), Trajectory(joints)
        self._input.synchronization = Synchronization.No
        self._input.max_acceleration = bounds.max_acceleration.tolist()
        self._input.max_jerk = (bounds.max_acceleration / TIME_TO_FULL_ACCELERATION_S).tolist()
        self._input.target_velocity = self._input.target_acceleration = [0.0] * joints
        self._since_s = 0.0
        self._plan()

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves and nothing is to move."""
        return not self._wished_rad_s.any() and self._since_s >= self._profile.duration

    def wish(self, velocity_rad_s: Vector) -> None:
        """Move so from now on; wishes above the velocity limits are cut to them.

        Args:
            velocity_rad_s: finite numbers, shape (joints,) [rad/s].
        """
        wished = np.clip(velocity_rad_s, -self._max_velocity, self._max_velocity)
        wished[np.abs(wished) < LEAST_SPEED_RAD_S] = 0.0
        if not np.array_equal(wished, self._wished_rad_s):
            self._wished_rad_s = wished
            self._plan()

    def advance(self, elapsed_s: float) -> Vector:
        """Let time pass; returns where the joints should be then, shape (joints,) [rad]."""
        self._since_s += elapsed_s
        position, velocity, acceleration = self._profile.at_time(self._since_s)
        self.position_rad, self.velocity_rad_s = np.array(position), np.array(velocity)
        self._acceleration_rad_s2 = np.array(acceleration)
        return self.position_rad

    def _plan(self) -> None:
        """Make the profiles from where the joints are now."""
        moving = self._wished_rad_s != 0.0
        given = self._input
        given.current_position = self.position_rad.tolist()
        given.current_velocity = self.velocity_rad_s.tolist()
        given.current_acceleration = self._acceleration_rad_s2.tolist()
        given.target_position = np.where(self._wished_rad_s > 0.0, self._upper_rad, self._lower_rad).tolist()
        # A joint that is to rest has no place to go to; its interface takes no notice of these two.
        given.max_velocity = np.where(moving, np.abs(self._wished_rad_s), self._max_velocity).tolist()
        interfaces = (ControlInterface.Velocity, ControlInterface.Position)
        given.per_dof_control_interface = [interfaces[int(each)] for each in moving]
        try:
            self._ruckig.calculate(given, self._profile)
        except RuckigError:
            # Its equations have no solution in a few corners of rounding; to brake has one always.
            given.per_dof_control_interface = [ControlInterface.Velocity] * len(moving)
            self._ruckig.calculate(given, self._profile)
        self._since_s = 0.0

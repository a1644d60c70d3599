"""Follows joint velocities that change at any time, with bounded acceleration and jerk, to the limits and no further.

A joint that is to move is sent to the limit ahead of it at the speed asked for: it is braked in time by itself, however
late the next wish comes. The profiles are ruckig's, the fastest within the bounds; each joint has its own.

One stream of velocities in progress: the joints' goals at each tick, and how it ends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from robot.description.limits import JointBounds
from robot.messages import Commanded, MotionEnded, Outcome, Stream
from robot.trajectory import Vector

# Acceleration grows to its limit within this time: motors and gears feel no knock, and a stick no delay.
TIME_TO_FULL_ACCELERATION_S = 0.06

# A slower wish is none: it is a servo's tick in two seconds.
LEAST_SPEED_RAD_S = 1e-3

# Ten ticks. A stream that is steered at 50 Hz may lose four setpoints in a row.
SETPOINT_LASTS_S = 0.1


class Streaming:
    """Joints that follow setpoints.

    Args:
        command: what was asked for, found acceptable.
        names: the arm's joints, order of the driver's arrays.
        bounds: limits of the joints.
        held_rad: where the arm holds, shape (joints,) [rad].

    Attributes:
        command: as given.
        columns: places of its joints in the driver's arrays.
        gripping: a stream never grips.
        fraction: a stream has no end to be near to.
        remaining_s: nor is it known when it ends.
    """

    gripping = False
    fraction = 0.0
    remaining_s = 0.0

    def __init__(self, command: Stream, names: tuple[str, ...], bounds: JointBounds, held_rad: Vector) -> None:
        self.command = command
        self.columns: NDArray[np.intp] = np.array([names.index(name) for name in command.joint_names])
        self._tracking = VelocityTracking(bounds.of_columns(self.columns), held_rad[self.columns])
        self._velocity_rad_s = np.zeros(len(self.columns))
        self._at_s = self._silence_s = 0.0
        self._ending = ""

    @property
    def motion_id(self) -> int:
        """The number its end is told under."""
        return self.command.motion_id

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints that follow."""
        return self.command.joint_names

    @property
    def finished(self) -> bool:
        """Whether the goals no longer move, and will not again."""
        return self._tracking.at_rest and (bool(self._ending) or self._silent)

    @property
    def commanded(self) -> Commanded:
        """Where the joints should be now."""
        return Commanded(self.motion_id, self._at_s, self._tracking.position_rad, self._tracking.velocity_rad_s)

    @property
    def _silent(self) -> bool:
        return self._silence_s > SETPOINT_LASTS_S

    def steer(self, velocity_rad_s: Vector) -> None:
        """Take a setpoint; one that is no set of finite numbers ends the stream."""
        self._silence_s = 0.0
        if velocity_rad_s.shape != self.columns.shape or not np.isfinite(velocity_rad_s).all():
            self._ending = self._ending or f"stopped: {velocity_rad_s.tolist()} are no velocities of these joints"
            return
        self._velocity_rad_s = velocity_rad_s

    def stop(self) -> None:
        """Begin to brake, for good."""
        self._ending = self._ending or "stopped"

    def advance(self, elapsed_s: float, rate: float, fastest: float) -> Vector:
        """Let time pass.

        Args:
            elapsed_s: how much [s].
            rate: share of the setpoints' speed to move at; a stream cannot go back, below 0 it waits.
            fastest: the greatest share allowed.

        Returns:
            The goals then, shape (joints,) [rad].
        """
        self._at_s += elapsed_s
        self._silence_s += elapsed_s
        resting = bool(self._ending) or self._silent
        self._tracking.wish(self._velocity_rad_s * (0.0 if resting else min(max(rate, 0.0), fastest)))
        return self._tracking.advance(elapsed_s)

    def ended(self, outcome: Outcome, message: str) -> MotionEnded:
        """Tell its end."""
        return MotionEnded(self.motion_id, outcome, message)

    def end(self, _goal_rad: Vector, _position_rad: Vector, _now_s: float) -> MotionEnded | None:
        """The regular end: at rest, and stopped or no longer steered; arguments as for a motion's."""
        if not self.finished:
            return None
        return self.ended(Outcome.STOPPED, self._ending or f"no setpoint came for {SETPOINT_LASTS_S:g} s")


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

"""Streams of joint velocities: the joints' goals at each tick, with bounded acceleration and jerk.

A joint with a target velocity is sent to the limit ahead of it at that speed, so that it brakes in time by itself
however late the next setpoint comes. The profiles are ruckig's, time-optimal within the bounds; each joint has its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from robot.description.limits import JointBounds
from robot.messages import Commanded, MotionEnded, Outcome, Stream
from robot.trajectory import TIME_TO_FULL_ACCELERATION_S, Vector

LEAST_SPEED_RAD_S = 1e-3  # slower targets count as rest: this is a servo's tick in two seconds

# Six ticks. A stream that is steered at 50 Hz may lose two setpoints in a row. With the braking, joints are at rest
# within 0.15 s of the moment at which the server stands still.
SETPOINT_LASTS_S = 0.06


class Streaming:
    """Stream in progress from where the arm holds, with the interface of :class:`robot.control.motion.Motion`."""

    fraction = 0.0
    remaining_s = 0.0
    rate = 1.0

    def __init__(
        self,
        command: Stream,
        names: tuple[str, ...],
        bounds: JointBounds,
        held_rad: Vector,
        speed_limit: float = 1.0,
    ) -> None:
        self.motion_id = command.motion_id
        self.joint_names = command.joint_names
        self.gripping = command.gripping
        self.columns: NDArray[np.intp] = np.array([names.index(name) for name in command.joint_names])
        self._max_velocity = bounds.max_velocity[self.columns]
        self._speed_limit = speed_limit
        self._tracking = VelocityTracking(bounds.of_columns(self.columns), held_rad[self.columns])
        self._velocity_rad_s = np.zeros(len(self.columns))
        self._at_s = self._silence_s = 0.0
        self._ending = ""

    @property
    def finished(self) -> bool:
        """True when the goals no longer move, and will not again."""
        return self._tracking.at_rest and (bool(self._ending) or self._silent)

    @property
    def commanded(self) -> Commanded:
        """Position and velocity goals of the joints now."""
        return Commanded(self.motion_id, self._at_s, self._tracking.position_rad, self._tracking.velocity_rad_s)

    @property
    def _silent(self) -> bool:
        # Ticks add up to a little more or less than their sum.
        return self._silence_s > SETPOINT_LASTS_S + 1e-9

    def steer(self, velocity_rad_s: Vector) -> None:
        """Take a setpoint, shape (joints,) [rad/s]; one of another shape, or not finite, ends the stream."""
        self._silence_s = 0.0
        if velocity_rad_s.shape != self.columns.shape or not np.isfinite(velocity_rad_s).all():
            self._ending = self._ending or f"stopped: {velocity_rad_s.tolist()} are no velocities of these joints"
            return
        self._velocity_rad_s = velocity_rad_s

    def limit_speed(self, share: float) -> None:
        """Let no joint be faster than a share of its velocity limit, above 0 to 1, from the next step on."""
        self._speed_limit = share

    def stop(self) -> None:
        """Begin to brake, for good."""
        self._ending = self._ending or "stopped"

    def step(self, elapsed_s: float, rate: float, fastest: float) -> Vector:
        """Advance at a share of the setpoints' speed, 0 below 0; return its joints' goals, shape (joints,) [rad]."""
        self._at_s += elapsed_s
        self._silence_s += elapsed_s
        resting = bool(self._ending) or self._silent
        target = self._velocity_rad_s * (0.0 if resting else min(max(rate, 0.0), fastest))
        # All joints slow down alike, so that the tip keeps its direction.
        peak_share = float(np.max(np.abs(target) / self._max_velocity, initial=0.0))
        self._tracking.set_target(target * (self._speed_limit / max(peak_share, self._speed_limit)))
        return self._tracking.advance(elapsed_s)

    def ended(self, outcome: Outcome, message: str) -> MotionEnded:
        """Return the stream's end."""
        return MotionEnded(self.motion_id, outcome, message)

    def end(self, _goal_rad: Vector, _position_rad: Vector, _now_s: float) -> MotionEnded | None:
        """Return the regular end, None while in progress: at rest, and stopped or without setpoints."""
        if not self.finished:
            return None
        if self._ending:
            return self.ended(Outcome.STOPPED, self._ending)
        return self.ended(Outcome.UNSTEERED, f"no setpoint came for {SETPOINT_LASTS_S:g} s")


class VelocityTracking:
    """Positions of joints that follow target velocities, from rest at some positions, shape (joints,) [rad]."""

    def __init__(self, bounds: JointBounds, position_rad: Vector) -> None:
        joints = len(position_rad)
        self.position_rad, self.velocity_rad_s = position_rad.copy(), np.zeros(joints)
        self._acceleration_rad_s2 = np.zeros(joints)
        self._target_rad_s = np.zeros(joints)
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
        """True when nothing moves and nothing is to move."""
        return not self._target_rad_s.any() and self._since_s >= self._profile.duration

    def set_target(self, velocity_rad_s: Vector) -> None:
        """Set finite target velocities, shape (joints,) [rad/s], clamped to the velocity limits."""
        target = np.clip(velocity_rad_s, -self._max_velocity, self._max_velocity)
        target[np.abs(target) < LEAST_SPEED_RAD_S] = 0.0
        if not np.array_equal(target, self._target_rad_s):
            self._target_rad_s = target
            self._plan()

    def advance(self, elapsed_s: float) -> Vector:
        """Advance by ``elapsed_s`` [s] and return the position goals, shape (joints,) [rad]."""
        self._since_s += elapsed_s
        position, velocity, acceleration = self._profile.at_time(self._since_s)
        self.position_rad, self.velocity_rad_s = np.array(position), np.array(velocity)
        self._acceleration_rad_s2 = np.array(acceleration)
        return self.position_rad

    def _plan(self) -> None:
        moving = self._target_rad_s != 0.0
        given = self._input
        given.current_position = self.position_rad.tolist()
        given.current_velocity = self.velocity_rad_s.tolist()
        given.current_acceleration = self._acceleration_rad_s2.tolist()
        given.target_position = np.where(self._target_rad_s > 0.0, self._upper_rad, self._lower_rad).tolist()
        # Ignored for a joint that is to rest: the velocity interface uses neither of these two.
        given.max_velocity = np.where(moving, np.abs(self._target_rad_s), self._max_velocity).tolist()
        interfaces = (ControlInterface.Velocity, ControlInterface.Position)
        given.per_dof_control_interface = [interfaces[int(each)] for each in moving]
        try:
            self._ruckig.calculate(given, self._profile)
        except RuckigError:
            # Rounding leaves its equations without a solution in rare cases; braking always has one.
            given.per_dof_control_interface = [ControlInterface.Velocity] * len(moving)
            self._ruckig.calculate(given, self._profile)
        self._since_s = 0.0

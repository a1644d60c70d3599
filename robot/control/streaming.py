"""One stream of velocities in progress: the joints' goals at each tick, and how it ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robot.control.velocity_tracking import VelocityTracking
from robot.limits import JointBounds
from robot.messages import Commanded, MotionEnded, Outcome, Stream
from robot.trajectory import Vector

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

"""One motion in progress: its goal at each tick, and how it ends when nothing goes wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robot.control.playback import Playback
from robot.guard_limits import GuardLimits
from robot.limits import JointBounds
from robot.messages import Execute, MotionEnded, Outcome
from robot.trajectory import Vector

SETTLED_TICKS = 3


class Motion:
    """A trajectory in progress.

    Args:
        command: what was asked for, found acceptable.
        names: the arm's joints, order of the driver's arrays.
        bounds: limits of the joints.
        limits: when its end is reached.

    Attributes:
        columns: places of its joints in the driver's arrays.
    """

    def __init__(self, command: Execute, names: tuple[str, ...], bounds: JointBounds, limits: GuardLimits) -> None:
        self.command = command
        self._limits = limits
        self.columns: NDArray[np.intp] = np.array([names.index(name) for name in command.trajectory.joint_names])
        self.playback = Playback(command.trajectory, bounds.max_acceleration[self.columns])
        self._end_reached_s: float | None = None
        self._settled_ticks = 0

    @property
    def motion_id(self) -> int:
        """The number its end is told under."""
        return self.command.motion_id

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints that move."""
        return self.command.trajectory.joint_names

    @property
    def gripping(self) -> bool:
        """Whether a stall on the way is a grip."""
        return self.command.gripping

    @property
    def finished(self) -> bool:
        """Whether the goal no longer moves."""
        return self.playback.finished

    @property
    def fraction(self) -> float:
        """Share of the motion that is done, 0..1."""
        return self.playback.fraction

    @property
    def remaining_s(self) -> float:
        """Time to the end of the trajectory [s]."""
        return self.playback.remaining_s

    def stop(self) -> None:
        """Begin to brake along the path."""
        self.playback.stop()

    def advance(self, elapsed_s: float, rate: float, fastest: float) -> Vector:
        """Let time pass.

        Args:
            elapsed_s: how much [s].
            rate: seconds of the motion to play a second, below 0 to go back.
            fastest: the greatest rate allowed.

        Returns:
            The goals of its joints then, shape (joints,) [rad].
        """
        self.playback.pace, self.playback.ceiling = rate, fastest
        return self.playback.advance(elapsed_s)

    def ended(self, outcome: Outcome, message: str) -> MotionEnded:
        """Tell its end."""
        return MotionEnded(self.motion_id, outcome, message)

    def end(self, goal_rad: Vector, position_rad: Vector, now_s: float) -> MotionEnded | None:
        """The regular end: stopped, or its end reached and its joints settled there.

        Args:
            goal_rad: goals of all joints [rad].
            position_rad: measured positions of all joints [rad].
            now_s: monotonic time [s].
        """
        playback = self.playback
        if not playback.finished:
            return None
        if not playback.completed:
            return self.ended(Outcome.STOPPED, f"stopped after {playback.fraction:.0%} of the motion")
        if self._end_reached_s is None:
            self._end_reached_s = now_s
        error = np.abs(position_rad - goal_rad)[self.columns]
        self._settled_ticks = self._settled_ticks + 1 if error.max() <= self._limits.goal_tolerance_rad else 0
        if self._settled_ticks >= SETTLED_TICKS:
            return self.ended(Outcome.REACHED, "the arm is there")
        if now_s - self._end_reached_s < self._limits.settle_timeout_s:
            return None
        return self._not_settled(error)

    def _not_settled(self, error: Vector) -> MotionEnded:
        worst = int(np.argmax(error))
        name = self.command.trajectory.joint_names[worst]
        if self.command.gripping:
            return self.ended(
                Outcome.GRIPPED, f"joint {name} holds something, {error[worst]:.3f} rad short of its goal"
            )
        message = (
            f"joint {name} is still {error[worst]:.3f} rad from its goal {self._limits.settle_timeout_s:g} s after "
            f"the end of the motion (tolerance {self._limits.goal_tolerance_rad:g} rad)"
        )
        return self.ended(Outcome.NOT_SETTLED, message)

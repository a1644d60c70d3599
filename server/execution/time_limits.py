"""Time limits of motions, at whatever speed they are played and however busy the machine is."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from planners.problem import MoveItErrorCode
from robot.arm_group import AnyArm
from robot.messages import Pace, PlaybackDirection
from server.errors import refused

# A slower motion counts as paused: at this share of its speed a motion of 3 s takes a minute.
MIN_SPEED_FACTOR = 0.05


@dataclass(frozen=True)
class TimeLimits:
    """Limits of the execution time of motions."""

    # Multiple of the planned duration; 2.2 is MoveIt's allowed_execution_duration_scaling of 1.1 at the half speed of a
    # hot arm.
    scaling: float = 2.2
    margin_s: float = 2.0  # time on top, in which the arm settles [s]
    paused_s: float = 600.0  # limit of the time that a goal's motions are paused or move backwards, in total [s]
    trajectory_s: float = 600.0  # limit of the planned duration of a goal's motions together [s]

    def allowed_s(self, duration_s: float) -> float:
        """Return the allowed execution time of a motion with a planned duration [s]."""
        return duration_s * self.scaling + self.margin_s

    def check_duration(self, duration_s: float, field: str, code: MoveItErrorCode, advice: str = "") -> None:
        """Check the planned duration of a goal's motions."""
        if not duration_s <= self.trajectory_s:
            limit_s = self.trajectory_s
            text = f"{field} is {duration_s:.6g} s, longer than goals.max_trajectory_duration_s = {limit_s:g}{advice}"
            raise refused(code, text, duration_s=duration_s, limit_s=limit_s)


class ArmClock:
    """Stopwatch on the slower of two clocks, the arm's and this machine's.

    A busy machine slows a simulated arm's clock down. A server that stood still itself receives all the arm's time at
    once, also the time before the arm got its order.
    """

    def __init__(self, arm: AnyArm, clock: Callable[[], float] = time.monotonic) -> None:
        self._arm = arm
        self._clock = clock
        self._began_s, self._began_by_arm_s = clock(), arm.clock_s
        # Greatest lag of the arm's clock so far; the time that it catches up later are states that came late.
        self._lag_s = 0.0
        self._total_s = 0.0

    def elapsed_s(self) -> float:
        """Return the time since the last call, or since the construction [s]."""
        here_s, by_arm_s = self._clock() - self._began_s, self._arm.clock_s - self._began_by_arm_s
        self._lag_s = max(self._lag_s, here_s - by_arm_s)
        before_s, self._total_s = self._total_s, max(here_s - self._lag_s, self._total_s)
        return self._total_s - before_s


class ExecutionDeadline:
    """Deadline of the motions of one goal, one after the other, counted in their own time."""

    def __init__(self, limits: TimeLimits | None = None) -> None:
        self.limits = limits or TimeLimits()
        self._allowed_s = self._used_s = self._paused_s = 0.0

    def begin(self, duration_s: float) -> None:
        """Begin a motion of a planned duration [s]; pauses of all motions count together."""
        self._allowed_s, self._used_s = self.limits.allowed_s(duration_s), 0.0

    def pass_time(self, elapsed_s: float, pace: Pace) -> None:
        """Count time."""
        if pace.direction is PlaybackDirection.FORWARD and pace.speed_factor >= MIN_SPEED_FACTOR:
            self._used_s += elapsed_s * pace.speed_factor
            return
        self._paused_s += elapsed_s
        if pace.direction is PlaybackDirection.BACK:
            # The arm has to repeat the part that it moves back.
            self._used_s = max(self._used_s - elapsed_s * pace.speed_factor, 0.0)

    @property
    def exceeded(self) -> str | None:
        """Sentence that names the exceeded limit; None while there is time left."""
        if self._used_s > self._allowed_s:
            return f"the arm did not end the motion within {self._allowed_s:.1f} s"
        if self._paused_s > self.limits.paused_s:
            paused_s, limit_s = self._paused_s, self.limits.paused_s
            return f"the motion was paused or going back for {paused_s:.0f} s (limit {limit_s:g} s)"
        return None

"""How long a motion may take before it is given up, at whatever pace it is played."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from robot.messages import Course, Pace

# A slower motion counts as paused: at this share of its speed a motion of 3 s takes a minute.
LEAST_SPEED_FACTOR = 0.05


@dataclass(frozen=True)
class Allowance:
    """What motions may take.

    Attributes:
        scaling: of the time that a motion takes as planned; 2.2 is MoveIt's 1.1 at the half speed of a hot arm.
        margin_s: time on top, in which the arm settles [s].
        paused_s: all the time that a goal may spend paused or going back, together [s].
    """

    scaling: float = 2.2
    margin_s: float = 2.0
    paused_s: float = 600.0

    def of(self, duration_s: float) -> float:
        """What a motion may take that takes ``duration_s`` as planned [s]."""
        return duration_s * self.scaling + self.margin_s


class TimedArm(Protocol):
    """The arm, as `robot.arm.Arm`."""

    @property
    def clock_s(self) -> float:
        """Time of the arm's control loop, as its latest state tells it [s]."""


class ArmTime:
    """Time that passes for an arm while something is waited for: that of its clock, and no more than passes here.

    A busy machine slows a simulated arm's clock down. A server that stood still itself hears of all the arm's time at
    once, also of what passed before the arm was told to do something.

    Args:
        arm: the arm.
        clock: monotonic time of this machine [s].
    """

    def __init__(self, arm: TimedArm, clock: Callable[[], float] = time.monotonic) -> None:
        self._arm = arm
        self._clock = clock
        self._began_s, self._began_by_arm_s = clock(), arm.clock_s
        # By how much the arm's clock has ever been behind; what it catches up later are states that came late.
        self._behind_s = 0.0
        self._told_s = 0.0

    def passed_s(self) -> float:
        """Return what has passed since this was last asked [s]."""
        here_s, by_arm_s = self._clock() - self._began_s, self._arm.clock_s - self._began_by_arm_s
        self._behind_s = max(self._behind_s, here_s - by_arm_s)
        told_s, self._told_s = self._told_s, max(here_s - self._behind_s, self._told_s)
        return self._told_s - told_s


class Patience:
    """Counts what time a motion has used of its allowance.

    Args:
        duration_s: what the motion takes as planned [s].
        allowance: what it may take.
    """

    def __init__(self, duration_s: float, allowance: Allowance) -> None:
        self._allowed_s = allowance.of(duration_s)
        self._may_pause_s = allowance.paused_s
        self._used_s = 0.0
        self._paused_s = 0.0

    def pass_time(self, elapsed_s: float, pace: Pace) -> None:
        """Let time pass.

        Args:
            elapsed_s: how much [s].
            pace: how the motion was played meanwhile; a slow one uses its allowance up as slowly.
        """
        if pace.course is Course.FORWARD and pace.speed_factor >= LEAST_SPEED_FACTOR:
            self._used_s += elapsed_s * pace.speed_factor
            return
        self._paused_s += elapsed_s
        if pace.course is Course.BACK:
            # What the arm goes back it has to come again.
            self._used_s = max(self._used_s - elapsed_s * pace.speed_factor, 0.0)

    @property
    def end(self) -> str | None:
        """Why the motion is to be given up; None while it may go on."""
        if self._used_s > self._allowed_s:
            return f"the arm did not end the motion within {self._allowed_s:.1f} s"
        if self._paused_s > self._may_pause_s:
            return f"the motion was paused or going back for {self._paused_s:.0f} s (limit {self._may_pause_s:g} s)"
        return None

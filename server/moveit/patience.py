"""How long a motion may take before it is given up, at whatever pace it is played."""

from __future__ import annotations

from dataclasses import dataclass

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

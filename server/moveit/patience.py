"""How long a motion may take before it is given up, at whatever pace it is played."""

from __future__ import annotations

from robot.messages import Course, Pace

# MoveIt's allowance for an execution, 1.1, at the half speed of an arm with a hot servo, plus the time the driver
# gives the arm to settle.
DURATION_FACTOR = 2.2
DURATION_MARGIN_S = 2.0

# Whoever pauses a motion to look at something is back within this time; nothing waits for ever. It holds for all the
# time that a goal spends paused or going back, together.
MAX_PAUSED_S = 600.0

# A slower motion counts as paused: at this share of its speed a motion of 3 s takes a minute.
LEAST_SPEED_FACTOR = 0.05


class Patience:
    """Counts what time a motion has used of its allowance.

    Args:
        duration_s: what the motion takes as planned [s].
    """

    def __init__(self, duration_s: float) -> None:
        self._allowed_s = duration_s * DURATION_FACTOR + DURATION_MARGIN_S
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
        if self._paused_s > MAX_PAUSED_S:
            return f"the motion was paused or going back for {self._paused_s:.0f} s (limit {MAX_PAUSED_S:g} s)"
        return None

"""Whether the server still lives: the servos have no watchdog, so the arm process is theirs."""

from __future__ import annotations


class Watchdog:
    """Notes when the server was last heard; pure, time passed in.

    Args:
        timeout_s: silence that counts as its death [s].
        now_s: monotonic time [s].
    """

    def __init__(self, timeout_s: float, now_s: float) -> None:
        self._timeout_s = timeout_s
        self._heard_s = now_s

    def hear(self, now_s: float) -> None:
        """Take note of a message, whatever it says."""
        self._heard_s = now_s

    def silence_s(self, now_s: float) -> float:
        """Time since the last message [s]."""
        return now_s - self._heard_s

    def barks(self, now_s: float) -> bool:
        """Whether the server has been silent for too long."""
        return self.silence_s(now_s) > self._timeout_s

"""Watchdog on the server: the servos have none, so the arm process is theirs."""

from __future__ import annotations


class Watchdog:
    """Time since the server was last heard; pure, time passed in.

    Args:
        timeout_s: silence that counts as its death [s].
        now_s: monotonic time [s].
    """

    def __init__(self, timeout_s: float, now_s: float) -> None:
        self._timeout_s = timeout_s
        self._heard_s = now_s

    def hear(self, now_s: float) -> None:
        """Note a message, whatever it says."""
        self._heard_s = now_s

    def silence_s(self, now_s: float) -> float:
        """Time since the last message [s]."""
        return now_s - self._heard_s

    def expired(self, now_s: float) -> bool:
        """Tell whether the server has been silent for too long."""
        return self.silence_s(now_s) > self._timeout_s

"""How often a client may do something."""

from __future__ import annotations


class Rate:
    """So much at once, and so much in the long run.

    Args:
        per_s: in the long run [1/s].
        burst: at once.
    """

    def __init__(self, per_s: float, burst: int) -> None:
        self.per_s = per_s
        self.burst = burst
        self._left = float(burst)
        self._counted_s = 0.0

    def take(self, now_s: float) -> bool:
        """Take one, if there is one left, at a monotonic time [s]."""
        self._left = min(float(self.burst), self._left + (now_s - self._counted_s) * self.per_s)
        self._counted_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True

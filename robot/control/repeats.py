"""A bound on lines of the log that say the same again and again: the first, second, fourth, eighth, … are written."""

from __future__ import annotations

# What has not happened for so long is told as the first time.
CALM_S = 600.0


class Repeats:
    """Count of one event.

    Attributes:
        count: how often it has happened since it was calm.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last_s = float("-inf")

    def due(self, now_s: float) -> bool:
        """Count the event once more; returns whether it is to be told.

        Args:
            now_s: monotonic time [s].
        """
        if now_s - self._last_s > CALM_S:
            self.count = 0
        self._last_s = now_s
        self.count += 1
        return self.count & (self.count - 1) == 0

    @property
    def note(self) -> str:
        """Text to append to the line; empty the first time."""
        return f" ({self.count} times so far)" if self.count > 1 else ""

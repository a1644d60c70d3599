"""Who steers: one client at a time, until it leaves or falls silent."""

from __future__ import annotations

from collections.abc import Callable

# A client that steers says so many times a second.
SILENCE_S = 1.0


class Ownership:
    """Who has the stick.

    Args:
        present: whether a client is still there.
    """

    def __init__(self, present: Callable[[object], bool]) -> None:
        self._present = present
        self._owner: object = None
        self._heard_s = 0.0

    def owner(self, now_s: float) -> object:
        """Who has it; None when nobody has.

        Args:
            now_s: monotonic time [s].
        """
        if self._owner is not None and (now_s - self._heard_s > SILENCE_S or not self._present(self._owner)):
            self._owner = None
        return self._owner

    def take(self, client: object, now_s: float) -> bool:
        """Take or keep the stick; returns whether it is the client's now."""
        owner = self.owner(now_s)
        if owner is not None and owner is not client:
            return False
        self._owner, self._heard_s = client, now_s
        return True

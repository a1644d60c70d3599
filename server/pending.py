"""Work that somebody waits for: it ends once, whoever ends it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

End = TypeVar("End")


class Pending(Generic[End]):
    """Base of calls and goals on their way.

    Attributes:
        ended: whether it has ended; another end goes nowhere.
    """

    def __init__(self) -> None:
        self.ended = False
        self._when_ended: list[Callable[[End], object]] = []

    def when_ended(self, callback: Callable[[End], object]) -> None:
        """Have this called with the end, in whatever way it comes; in order of asking."""
        self._when_ended.append(callback)

    def _end(self, end: End) -> None:
        if self.ended:
            return
        self.ended = True
        for callback in self._when_ended:
            callback(end)

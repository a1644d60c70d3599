"""Ring of the latest samples of some quantities, in one array."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


class SampleRing:
    """The latest samples of some quantities."""

    def __init__(self, capacity: int, columns: int) -> None:
        self._at_s = np.zeros(capacity)
        self._values = np.zeros((capacity, columns))
        self._count = 0

    def add(self, at_s: float, values: ArrayLike) -> None:
        """Add a sample, in the place of the oldest when there are as many as are kept.

        Args:
            values: shape (columns,).
        """
        place = self._count % len(self._at_s)
        self._at_s[place] = at_s
        self._values[place] = values
        self._count += 1

    def since(self, from_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times, shape (samples,), and values, shape (samples, columns), from a time on, oldest first."""
        kept = min(self._count, len(self._at_s))
        order = np.arange(self._count - kept, self._count) % len(self._at_s)
        order = order[self._at_s[order] >= from_s]
        return self._at_s[order], self._values[order]

"""A bound on the log: what one place in the program says again and again is left out beyond a rate.

Clients and machines decide how often something goes wrong, and a log must not fill the disk with it.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TypeAlias

# Of one place: lines at once, and in the long run [1/s]. A day of that is 200 MB.
BURST = 500
LINES_PER_S = 10.0

Place: TypeAlias = tuple[str, int]


class FloodFilter(logging.Filter):
    """Lets records through that are not too many; how many were left out is told with the next that is not.

    Args:
        clock: monotonic time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        # Lines that are left and when they were counted, and how many were left out; no more of them than the program
        # has calls of the log.
        self._shares: dict[Place, tuple[float, float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is told."""
        place, now_s = (record.pathname, record.lineno), self._clock()
        left, counted_s, left_out = self._shares.get(place, (float(BURST), now_s, 0))
        left = min(float(BURST), left + (now_s - counted_s) * LINES_PER_S)
        if left < 1.0:
            self._shares[place] = left, now_s, left_out + 1
            return False
        self._shares[place] = left - 1.0, now_s, 0
        record.left_out = left_out
        return True


def left_out_note(record: logging.LogRecord) -> str:
    """How many records like this one were left out before it; empty for none."""
    count = getattr(record, "left_out", 0)
    return f" ({count} more lines like this were left out before)" if count else ""

"""One client's share of the log: what it gets wrong is told, but no client can fill the disk with it."""

from __future__ import annotations

import logging

from server.access.rates import Rate

log = logging.getLogger("armbridge.gateway")

# Of one client: lines at once, and in the long run [1/s].
BURST = 50
LINES_PER_S = 1.0


class LogShare:
    """Writes lines, and leaves out what is too much; how many were left out is told with the next that is not."""

    def __init__(self) -> None:
        self._rate = Rate(LINES_PER_S, BURST)
        self._left_out = 0

    def write(self, now_s: float, level: int, text: str) -> None:
        """Write a line, unless there have been too many by now [s]."""
        if not self._rate.take(now_s):
            self._left_out += 1
            return
        left_out, self._left_out = self._left_out, 0
        more = f" ({left_out} more lines about this client were left out before)" if left_out else ""
        log.log(level, "%s%s", text, more)

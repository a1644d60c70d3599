"""Standstills of the machine, the server or an arm process: what moved the arm before one moves nothing afterwards.

The machine stands still behind a closed lid; a process in a frozen container, in a debugger, and by SIGSTOP or Ctrl-Z.
"""

import logging
import time
from collections.abc import Callable
from typing import TypeAlias

from robot.messages import ArmState
from server.execution.monitors import title_of
from server.features.context import ServerContext
from server.lifecycle import Feature

log = logging.getLogger("armbridge.arm")

LOOK_S = 0.1

# Shorter suspensions do not count: nobody has come near the arm meanwhile.
LEAST_S = 1.0

# Least and greatest value that a time may have [s].
Bounds: TypeAlias = tuple[float, float]


def suspended_s() -> Bounds:
    """Return bounds of the time that the machine has been suspended since its start [s]: clocks are read in a row."""
    # The monotonic clock stands still meanwhile, and the clock of the time since the start does not (clock_gettime(2)).
    before_s = time.monotonic()
    since_start_s = time.clock_gettime(time.CLOCK_BOOTTIME)
    return since_start_s - time.monotonic(), since_start_s - before_s


class Suspension(Feature):
    """Stops all arms when the machine was suspended, or the arm that a standstill has stopped.

    Hours later nobody expects that they go on. The arm process notices every standstill except the machine's, in which
    its clock stands still as well.
    """

    name = "suspension"

    def __init__(self, context: ServerContext, suspended: Callable[[], Bounds] = suspended_s) -> None:
        self._context, self._suspended = context, suspended
        self._arms = {each.name: each for each in context.arms}
        self._before_s = suspended()[1]

    async def start(self) -> None:
        self._timer = self._context.graph.call_later(LOOK_S, self._look)

    async def stop(self) -> None:
        self._timer.cancel()

    def on_state(self, arm: str, state: ArmState) -> None:
        # Once: the arm process has not received the stop that this one leads to.
        if state.halted and state.last_stop >= self._arms[arm].arm.last_stop:
            log.warning("%s; all motions of %s are stopped", state.halted, title_of(arm))
            self._arms[arm].stop(state.halted)

    def _look(self) -> None:
        self._timer = self._context.graph.call_later(LOOK_S, self._look)
        # Bounds, as a starved process may stand still between two clocks.
        least_s, greatest_s = self._suspended()
        if (length_s := least_s - self._before_s) >= LEAST_S:
            reason = f"the machine was suspended for {length_s:.0f} s"
            log.warning("%s; all motions are stopped", reason)
            self._before_s = greatest_s
            self._context.whole.stop(reason)
        self._before_s = min(self._before_s, greatest_s)

"""Running a sequence on a bus that nobody else uses, as the command line does."""

from __future__ import annotations

import time
from collections.abc import Callable

from robot.control.steps import Result, Steps


def run_to_end(steps: Steps[Result], wait: Callable[[float], None] = time.sleep) -> Result:
    """Carry out a sequence and return what it returns.

    Args:
        steps: the sequence; what it raises is raised.
        wait: waits for so long [s].
    """
    while True:
        try:
            wait_s = next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result
        wait(wait_s)

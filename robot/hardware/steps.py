"""Sequences that share the hardware with the 100 Hz tick: each step is one transaction, or a wait.

A sequence is a generator. It yields before every transaction, so that nothing holds up a tick or an emergency stop
for longer than one of them, and the number it yields is how long it wants to wait first [s].
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import TypeAlias, TypeVar

Result = TypeVar("Result")
Steps: TypeAlias = Generator[float, None, Result]


def run_to_end(steps: Steps[Result], wait: Callable[[float], None] = time.sleep) -> Result:
    """Carry out a sequence on hardware that nobody else uses, as the command line does; returns what it returns.

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

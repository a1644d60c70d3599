"""Running a sequence of steps without a loop around it."""

from __future__ import annotations

from typing import TypeVar

from robot.hardware.interface import Steps

Result = TypeVar("Result")


def run(steps: Steps[Result]) -> Result:
    """Take every step at once, without the waits in between; returns what the sequence returns."""
    while True:
        try:
            next(steps)
        except StopIteration as done:
            result: Result = done.value
            return result

"""Steps of planned motions whose problems tests build."""

from collections.abc import Callable
from dataclasses import dataclass

from server.execution.motions import MotionStep, Positions, Problem


@dataclass(frozen=True)
class StepOf(MotionStep):
    """Step with a function that builds its problem."""

    build: Callable[[Positions], Problem]

    def problem(self, start_rad: Positions) -> Problem:
        return self.build(start_rad)

"""Steps of planned motions whose problems tests build."""

from collections.abc import Callable
from dataclasses import dataclass

from server.execution.motions import Positions, Problem, Step


@dataclass(frozen=True)
class StepOf(Step):
    """Step with a function that builds its problem."""

    build: Callable[[Positions], Problem]

    def problem(self, start_rad: Positions) -> Problem:
        return self.build(start_rad)

"""Result of one run."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Result:
    """One run.

    Attributes:
        population: state in which the servos were found.
        violations: one sentence each; empty in a good run.
        outcomes: number of motions by how they ended.
        faults: codes of the faults that the arm reported.
        writes: number of writes to the servos.
        states: number of states that the arm sent.
    """

    seed: int
    happening: str
    population: str
    violations: list[str] = field(default_factory=list)
    outcomes: dict[str, int] = field(default_factory=dict)
    faults: set[str] = field(default_factory=set)
    writes: int = 0
    states: int = 0

    def count(self, outcome: str) -> None:
        """Count the outcome of a motion."""
        self.outcomes[outcome] = self.outcomes.get(outcome, 0) + 1

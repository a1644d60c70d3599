"""What one run found."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Result:
    """One run.

    Attributes:
        violations: a sentence each; none in a good run.
        outcomes: how motions ended, and how often.
        faults: codes of the faults that the arm told of.
        writes: writes that the servos took.
        states: states that the arm told.
    """

    seed: int
    happening: str
    violations: list[str] = field(default_factory=list)
    outcomes: dict[str, int] = field(default_factory=dict)
    faults: set[str] = field(default_factory=set)
    writes: int = 0
    states: int = 0

    def count(self, outcome: str) -> None:
        """Take note of how a motion ended."""
        self.outcomes[outcome] = self.outcomes.get(outcome, 0) + 1

"""What may be asked of the arm's group: motions to plan, and motions that are given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from planners.problem import CartesianProblem, PlanningFailure, PlanningProblem
from planners.scene import Scene
from robot.trajectory import Trajectory

# Position of every movable joint [rad].
Positions: TypeAlias = Mapping[str, float]

# Makes a problem for a start; when a goal's turn comes the arm may hold elsewhere than when the goal came.
Step: TypeAlias = Callable[[Positions], PlanningProblem | CartesianProblem | PlanningFailure]


@dataclass(frozen=True)
class PlannedMotion:
    """Motions to plan and then to carry out, one after the other.

    Attributes:
        steps: each makes its problem from where the one before ends.
        scene: the scene to plan in, for where the arm is; None for the present one.
        attempts: how often is planned at most, when there is no motion or the scene gets in its way.
        delay_s: pause before another attempt [s].
        warnings: what was left out of account, a sentence each.
        confirm: whether somebody is to confirm the plan before the arm moves.
    """

    steps: tuple[Step, ...]
    scene: Callable[[Positions], Scene | PlanningFailure] | None = None
    attempts: int = 1
    delay_s: float = 0.0
    warnings: tuple[str, ...] = ()
    confirm: bool = False


@dataclass(frozen=True)
class GivenMotion:
    """A motion that somebody else has planned.

    Attributes:
        trajectory: makes it for where the arm holds, or says why it cannot be made.
    """

    trajectory: Callable[[Positions], Trajectory | PlanningFailure]


Motion: TypeAlias = PlannedMotion | GivenMotion

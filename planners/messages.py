"""What the server and a planner process say to each other."""

from __future__ import annotations

import signal
from dataclasses import dataclass

from planners.problem import Plan, PlanningFailure, PlanningProblem
from robot.model import RobotModel

# Asks a worker to give up the problem in hand; it answers PREEMPTED.
CANCEL_SIGNAL = signal.SIGUSR1


@dataclass(frozen=True)
class LoadRobot:
    """First message to a worker: the arm to plan for."""

    robot: RobotModel


@dataclass(frozen=True)
class Loaded:
    """The worker is ready for problems, ``startup_s`` after its interpreter started."""

    startup_s: float


@dataclass(frozen=True)
class LoadFailed:
    """The worker cannot plan for this robot."""

    reason: str


@dataclass(frozen=True)
class Solve:
    """One problem; the number comes back with the answer."""

    number: int
    problem: PlanningProblem


@dataclass(frozen=True)
class Solved:
    """The answer to a problem."""

    number: int
    answer: Plan | PlanningFailure

"""What is free on the way to a goal where something would touch."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from planners.goals import JointGoal, PositionGoal
from planners.pool import PlannerPool
from planners.problem import (
    CartesianProblem,
    IkAnswer,
    IkQuestion,
    MoveItErrorCode,
    PlanningFailure,
    PlanningProblem,
    StateAnswer,
    StateQuestion,
)
from planners.scene import Scene
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel

# Shares of the way that are looked at, the farthest first: nearer to the goal than the last makes no difference to see.
SHARES = (0.95, 0.9, 0.8, 0.7, 0.6, 0.5, 0.3)

# For each point of the tip; a refusal is not to wait longer than a tenth of a second for what would work instead.
LOOK_S = 0.01


class Alternatives:
    """Finds what would work instead.

    Args:
        robot: the arm.
        pool: answers questions.
    """

    def __init__(self, robot: RobotModel, pool: PlannerPool) -> None:
        self._robot = robot
        self._forward = ForwardPlacements(robot)
        self._pool = pool

    async def added(
        self, failure: PlanningFailure, problem: PlanningProblem | CartesianProblem | None, scene: Scene
    ) -> PlanningFailure:
        """The failure, with the last free place before the goal as ``free_rad`` or ``free_m``, when there is one.

        Args:
            failure: why a problem has no plan.
            problem: the problem.
            scene: where it was planned.
        """
        if failure.code is not MoveItErrorCode.GOAL_IN_COLLISION or not isinstance(problem, PlanningProblem):
            return failure
        found: dict[str, Any] = {}
        if isinstance(problem.goal, JointGoal):
            found = await self._joints(problem, problem.goal, scene)
        elif isinstance(problem.goal, PositionGoal):
            found = await self._point(problem, problem.goal, scene)
        return replace(failure, details={**failure.details, **found})

    async def _joints(self, problem: PlanningProblem, goal: JointGoal, scene: Scene) -> dict[str, Any]:
        start_rad = problem.start_rad
        for share in SHARES:
            free_rad = {
                name: start_rad[name] + share * (end_rad - start_rad[name])
                for name, end_rad in goal.positions_rad.items()
            }
            answer = await self._pool.ask(StateQuestion(problem.group, {**start_rad, **free_rad}), scene)
            if isinstance(answer, StateAnswer) and answer.valid:
                return {"free_rad": {name: round(value, 4) for name, value in free_rad.items()}}
        return {}

    async def _point(self, problem: PlanningProblem, goal: PositionGoal, scene: Scene) -> dict[str, Any]:
        tip_m = self._forward.transforms(problem.start_rad)[goal.link][:3, 3].tolist()
        for share in SHARES:
            x, y, z = (tip + share * (end - tip) for tip, end in zip(tip_m, goal.position_m, strict=True))
            nearer = replace(goal, position_m=(x, y, z))
            question = IkQuestion(problem.group, problem.start_rad, nearer, allowed_time_s=LOOK_S)
            if isinstance(await self._pool.ask(question, scene), IkAnswer):
                return {"free_m": [round(x, 4), round(y, 4), round(z, 4)]}
        return {}

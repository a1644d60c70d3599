"""Goals that cannot be planned: files for ``armbridge plan``, and free places on the way to them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from planners.files import problem_file
from planners.goals import JointGoal, PoseGoal, PositionGoal
from planners.pool import PlannerPool
from planners.problem import (
    CartesianProblem,
    IkAnswer,
    IkQuestion,
    JointPathProblem,
    MoveItErrorCode,
    PlanningFailure,
    PlanningProblem,
    StateAnswer,
    StateQuestion,
)
from planners.scene import Scene
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.files import FileSeries

log = logging.getLogger("armbridge.failed_goals")

# A disk that takes longer keeps the file to itself; the goal's answer does not wait for it.
WRITING_TIMEOUT_S = 2.0

PREFIX = "goal-"

# Checked shares of the way, the farthest first: a place nearer to the start than the last is no help.
SHARES = (0.95, 0.9, 0.8, 0.7, 0.6, 0.5, 0.3)

# For each point of the tip: a rejection is to wait for its alternative no longer than a tenth of a second.
CHECK_TIMEOUT_S = 0.01


class FailedGoals:
    """Directory of problem files, which several servers may share.

    Args:
        directory: created with the first file.
        robot: the arm that was planned for.
        wall_clock: seconds since 1970, for the names.
        max_files: limit of files, of up to 3 MB each with a scene of 10 000 objects; the oldest make room for new ones.
    """

    def __init__(self, directory: Path, robot: RobotModel, wall_clock: Callable[[], float], max_files: int) -> None:
        self._directory = directory
        self._files = FileSeries(directory, PREFIX, ".json", max_files)
        self._robot = robot
        self._wall_clock = wall_clock

    async def save(self, problem: PlanningProblem, scene: Scene, failure: PlanningFailure) -> None:
        """Write a problem file; errors are only logged."""
        now = datetime.fromtimestamp(self._wall_clock(), UTC)
        name = f"{now:%Y%m%dT%H%M%S.%fZ}-{failure.code.name}"

        def content(stem: str) -> bytes:
            return problem_file.text(stem, problem, scene, self._robot, failure).encode()

        try:
            writing = asyncio.to_thread(self._files.add, name, content)
            path = await asyncio.wait_for(writing, WRITING_TIMEOUT_S)
        except TimeoutError:
            log.warning("a failed goal is not saved in %s within %g s", self._directory, WRITING_TIMEOUT_S)
        except OSError as error:
            log.warning("a failed goal is not saved in %s: %s", self._directory, error)
        else:
            log.info("the failed goal is saved: armbridge plan --all %s", path)


class Alternatives:
    """Search for free places on the way to a goal in collision.

    Args:
        robot: the arm.
        pool: the planners.
    """

    def __init__(self, robot: RobotModel, pool: PlannerPool) -> None:
        self._robot = robot
        self._forward = ForwardPlacements(robot)
        self._pool = pool

    async def add_to(
        self,
        failure: PlanningFailure,
        problem: PlanningProblem | CartesianProblem | JointPathProblem | None,
        scene: Scene,
    ) -> PlanningFailure:
        """Add the last free place before the goal to a failure, if there is one: its detail ``free_rad`` or ``free_m``.

        Args:
            failure: the reason why a problem has no plan.
            problem: the problem.
            scene: in which it was planned.
        """
        if failure.code is not MoveItErrorCode.GOAL_IN_COLLISION or not isinstance(problem, PlanningProblem):
            return failure
        found: dict[str, Any] = {}
        if isinstance(problem.goal, JointGoal):
            found = await self._joints(problem, problem.goal, scene)
        elif isinstance(problem.goal, PositionGoal | PoseGoal):
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

    async def _point(self, problem: PlanningProblem, goal: PositionGoal | PoseGoal, scene: Scene) -> dict[str, Any]:
        goal_m = goal.position_m if isinstance(goal, PositionGoal) else goal.pose.position_m
        tip_m = self._forward.transforms(problem.start_rad)[goal.link][:3, 3].tolist()
        for share in SHARES:
            x, y, z = (tip + share * (end - tip) for tip, end in zip(tip_m, goal_m, strict=True))
            nearer = _at(goal, (x, y, z))
            question = IkQuestion(problem.group, problem.start_rad, nearer, allowed_time_s=CHECK_TIMEOUT_S)
            if isinstance(await self._pool.ask(question, scene), IkAnswer):
                return {"free_m": [round(x, 4), round(y, 4), round(z, 4)]}
        return {}


def _at(goal: PositionGoal | PoseGoal, position_m: tuple[float, float, float]) -> PositionGoal | PoseGoal:
    """Return a goal at another point [m]."""
    if isinstance(goal, PositionGoal):
        return replace(goal, position_m=position_m)
    return replace(goal, pose=replace(goal.pose, position_m=position_m))

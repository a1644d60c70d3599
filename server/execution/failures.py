"""Goals that cannot be planned: files for ``armbridge plan``, and the nearest ones that can."""

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
    MoveItErrorCode,
    NearestGoalAnswer,
    NearestGoalQuestion,
    PlanningFailure,
    PlanningProblem,
)
from planners.scene import Scene
from robot.description.model import RobotModel
from robot.files import FileSeries
from server.execution.motions import Problem

log = logging.getLogger("armbridge.failed_goals")

# A disk that takes longer keeps the file to itself; the goal's answer does not wait for it.
WRITING_TIMEOUT_S = 2.0

PREFIX = "goal-"


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


# Goals that have no plan for a reason that another goal nearby may not have.
SUGGESTED_FOR = (MoveItErrorCode.GOAL_IN_COLLISION, MoveItErrorCode.NO_IK_SOLUTION)


async def with_nearest_goal(
    failure: PlanningFailure, problem: Problem | None, scene: Scene, pool: PlannerPool
) -> PlanningFailure:
    """Add the nearest goal that works to a failure, if one was found: its detail ``free_rad`` or ``free_m``.

    Args:
        failure: the reason why a problem has no plan.
        problem: the problem.
        scene: in which it was planned.
        pool: the planners.
    """
    if failure.code not in SUGGESTED_FOR or not isinstance(problem, PlanningProblem):
        return failure
    answer = await pool.ask(NearestGoalQuestion(problem), scene)
    found: dict[str, Any] = {}
    match answer:
        case NearestGoalAnswer(JointGoal(positions_rad)):
            found = {"free_rad": dict(positions_rad)}
        case NearestGoalAnswer(PositionGoal() as goal):
            found = {"free_m": list(goal.position_m)}
        case NearestGoalAnswer(PoseGoal() as goal):
            found = {"free_m": list(goal.pose.position_m)}
    return replace(failure, details={**failure.details, **found})

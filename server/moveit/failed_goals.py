"""Keeps goals that could not be planned, as problem files that ``armbridge plan`` plans again."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from planners.files import problem_file
from planners.problem import PlanningFailure, PlanningProblem
from planners.scene import Scene
from robot.description.model import RobotModel

log = logging.getLogger("armbridge.failed_goals")

# A disk that takes longer keeps the file to itself; the goal's answer does not wait for it.
WRITING_TIMEOUT_S = 2.0

PREFIX = "goal-"


class FailedGoals:
    """A directory of problem files.

    Args:
        directory: where they go; made when it is not there.
        robot: the arm that was planned for.
        wall_clock: seconds since 1970, for the names.
        max_files: how many are kept, of up to 3 MB with a scene of 10 000 objects; the oldest make room for new ones.
    """

    def __init__(self, directory: Path, robot: RobotModel, wall_clock: Callable[[], float], max_files: int) -> None:
        self._directory = directory
        self._robot = robot
        self._wall_clock = wall_clock
        self._max_files = max_files

    async def save(self, problem: PlanningProblem, scene: Scene, failure: PlanningFailure) -> None:
        """Write one; what goes wrong in that is only logged."""
        now = datetime.fromtimestamp(self._wall_clock(), UTC)
        path = self._directory / f"{PREFIX}{now:%Y%m%dT%H%M%S.%fZ}-{failure.code.name}.json"
        try:
            writing = asyncio.to_thread(self._write, path, problem, scene, failure)
            await asyncio.wait_for(writing, WRITING_TIMEOUT_S)
        except TimeoutError:
            log.warning("a failed goal is not saved in %s within %g s", path, WRITING_TIMEOUT_S)
        except OSError as error:
            log.warning("a failed goal is not saved in %s: %s", path, error)
        else:
            log.info("the failed goal is saved: armbridge plan --all %s", path)

    def _write(self, path: Path, problem: PlanningProblem, scene: Scene, failure: PlanningFailure) -> None:
        self._directory.mkdir(parents=True, exist_ok=True)
        problem_file.write(path, problem, scene, self._robot, failure)
        saved = sorted(self._directory.glob(f"{PREFIX}*.json"))
        for oldest in saved[: -self._max_files]:
            oldest.unlink(missing_ok=True)

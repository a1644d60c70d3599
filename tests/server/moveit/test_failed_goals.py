from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from planners.files import problem_file
from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Box, Pose, Scene, SceneObject
from robot.description import model
from server.moveit.failed_goals import FailedGoals
from tests.helpers.requests import EASY

IN_THE_WAY = Scene(1, (SceneObject("box", ((Box((0.1, 0.1, 0.1)), Pose()),), Pose((0.2, 0.0, 0.1))),))
FAILURE = PlanningFailure(MoveItErrorCode.GOAL_IN_COLLISION, "the goal touches the box")

KEPT = 5


@pytest.fixture
def failed_goals(tmp_path: Path) -> FailedGoals:
    return FailedGoals(tmp_path / "failed", model.builtin(), itertools.count(1_800_000_000).__next__, KEPT)


async def test_a_saved_goal_reads_as_it_was_asked(failed_goals: FailedGoals, tmp_path: Path) -> None:
    await failed_goals.save(EASY, IN_THE_WAY, FAILURE)
    (path,) = (tmp_path / "failed").iterdir()
    assert path.name == "goal-20270115T080000.000000Z-GOAL_IN_COLLISION.json"
    saved = problem_file.read(path, model.builtin())
    assert saved.problems[0].problem.goal == EASY.goal
    assert saved.scene.objects == IN_THE_WAY.objects


async def test_the_newest_files_are_kept(failed_goals: FailedGoals, tmp_path: Path) -> None:
    (tmp_path / "failed").mkdir()
    (tmp_path / "failed" / "notes.json").write_text("of the user")
    for _ in range(KEPT + 3):
        await failed_goals.save(EASY, Scene(), FAILURE)
    names = sorted(path.name for path in (tmp_path / "failed").iterdir())
    assert len(names) == KEPT + 1
    assert names[0].startswith("goal-20270115T080003")
    assert names[-1] == "notes.json"


async def test_a_directory_that_cannot_be_written_is_only_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("")
    await FailedGoals(tmp_path / "file", model.builtin(), lambda: 0.0, KEPT).save(EASY, Scene(), FAILURE)
    assert "is not saved" in caplog.text

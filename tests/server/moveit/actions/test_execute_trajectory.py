from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from server.moveit.actions.move_group import EXECUTE_ACTION, ExecuteTrajectory
from server.moveit.motions import GivenMotion
from tests.helpers.action_desk import ActionDesk
from tests.helpers.moveit_services import ROBOT
from tests.helpers.played_arm import settle


@pytest.fixture
async def desk() -> AsyncIterator[ActionDesk]:
    made = ActionDesk()
    ExecuteTrajectory(made.graph, ROBOT, made.arm, made.queue).open()  # type: ignore[arg-type]
    yield made
    await made.close()


def trajectory(position_rad: float) -> dict[str, object]:
    point = {"positions": [position_rad], "time_from_start": {"sec": 2}}
    return {"joint_trajectory": {"joint_names": ["elbow_flex"], "points": [point]}}


async def test_a_trajectory_is_played_and_answered(desk: ActionDesk) -> None:
    await desk.send(EXECUTE_ACTION, trajectory=trajectory(0.5))
    assert isinstance(desk.asked[0], GivenMotion)
    desk.finish()
    await settle()
    assert desk.results[0].values["error_code"]["val"] == 1


async def test_a_cancel_ends_it(desk: ActionDesk) -> None:
    goal = await desk.send(EXECUTE_ACTION, trajectory=trajectory(0.5))
    assert goal is not None
    goal.cancel()
    await settle()
    assert desk.results[0].values["error_code"]["val"] == -7


async def test_a_trajectory_without_points_is_done_at_once(desk: ActionDesk) -> None:
    await desk.send(EXECUTE_ACTION)
    assert desk.results[0].values["error_code"]["val"] == 1
    assert desk.asked == []


async def test_a_wrong_trajectory_is_answered_and_what_moves_goes_on(desk: ActionDesk) -> None:
    await desk.send(EXECUTE_ACTION, trajectory=trajectory(0.5))
    await desk.send(EXECUTE_ACTION, trajectory=trajectory(9.0))
    assert [result.values["error_code"]["val"] for result in desk.results] == [-2]
    assert "elbow_flex" in desk.results[0].values["error_code"]["message"]
    assert len(desk.asked) == 1


async def test_joints_of_another_kind_are_ignored_and_told(desk: ActionDesk, caplog: pytest.LogCaptureFixture) -> None:
    await desk.send(EXECUTE_ACTION, trajectory={"multi_dof_joint_trajectory": {"points": [{}]}})
    assert "multi_dof_joint_trajectory is ignored" in caplog.text

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from server.action_goals import GoalStatus
from server.moveit.actions.move_group import MOVE_ACTIONS, SEQUENCE_ACTION, PlanningActions
from server.moveit.motions import PlannedMotion
from tests.helpers.action_desk import ActionDesk
from tests.helpers.moveit_requests import joint
from tests.helpers.played_arm import settle


@pytest.fixture
async def desk() -> AsyncIterator[ActionDesk]:
    made = ActionDesk()
    PlanningActions(made.graph, made.context, made.queue).open()
    yield made
    await made.close()


def to(position_rad: float) -> dict[str, Any]:
    constraint = {"joint_constraints": [joint("shoulder_pan", position_rad)]}
    return {"group_name": "arm", "goal_constraints": [constraint]}


def codes(desk: ActionDesk) -> list[int]:
    return [result.values["error_code"]["val"] for result in desk.results]


@pytest.mark.parametrize("name", MOVE_ACTIONS)
async def test_a_goal_is_carried_out_under_both_names(desk: ActionDesk, name: str) -> None:
    await desk.send(name, request=to(0.3))
    desk.finish()
    await settle()
    assert codes(desk) == [1]


async def test_a_goal_that_cannot_be_asked_for_is_answered_while_another_moves(desk: ActionDesk) -> None:
    await desk.send("/move_group", request=to(0.3))
    await desk.send("/move_group", request={"group_name": "leg"})
    await desk.send("/move_group", request=to(0.3), planning_options={"replan_delay": -1.0})
    assert codes(desk) == [-15, 99999]
    assert len(desk.asked) == 1


async def test_a_plan_alone_does_not_disturb_what_moves(desk: ActionDesk) -> None:
    await desk.send("/move_group", request=to(0.3))
    await desk.send("/move_group", request=to(0.5), planning_options={"plan_only": True})
    assert codes(desk) == [1]
    assert len(desk.asked) == 1
    assert [message["state"] for message in desk.feedback] == ["PLANNING", "IDLE"]
    assert desk.results[0].values["planned_trajectory"]["joint_trajectory"]["points"]


async def test_a_plan_alone_can_be_cancelled(desk: ActionDesk, monkeypatch: pytest.MonkeyPatch) -> None:
    async def never(*_request: object) -> None:
        await asyncio.Event().wait()

    monkeypatch.setattr(desk.pool, "ask", never)
    goal = await desk.send("/move_group", request=to(0.5), planning_options={"plan_only": True})
    assert goal is not None
    goal.cancel()
    await settle()
    assert codes(desk) == [-7]
    assert desk.results[0].status == GoalStatus.CANCELED


async def test_a_bug_in_planning_is_answered(
    desk: ActionDesk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def broken(*_request: object) -> None:
        raise ValueError("broken")

    monkeypatch.setattr(desk.pool, "ask", broken)
    await desk.send("/move_group", request=to(0.5), planning_options={"plan_only": True})
    assert codes(desk) == [99999]
    assert "broken" in caplog.text


async def test_a_sequence_is_one_motion_of_several_steps(desk: ActionDesk) -> None:
    items = [{"req": to(0.3)}, {"req": to(0.5)}]
    await desk.send(SEQUENCE_ACTION, request={"items": items})
    assert isinstance(desk.asked[0], PlannedMotion)
    assert len(desk.asked[0].steps) == 2
    desk.finish()
    await settle()
    assert desk.results[0].values["response"]["error_code"]["val"] == 1


async def test_a_blend_radius_is_refused_with_a_reason(desk: ActionDesk) -> None:
    items = [{"req": to(0.3), "blend_radius": 0.05}, {"req": to(0.5)}]
    await desk.send(SEQUENCE_ACTION, request={"items": items})
    assert "blend_radius must be 0 m, not 0.05" in desk.results[0].values["response"]["error_code"]["message"]
    assert desk.asked == []

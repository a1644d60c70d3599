from __future__ import annotations

from typing import Any

import pytest

from planners.problem import MoveItErrorCode
from tests.helpers.moveit_requests import ball, joint
from tests.helpers.moveit_services import ServiceRig


async def planned(rig: ServiceRig, *items: Any) -> Any:
    return (await rig.call("/plan_sequence_path", request={"items": list(items)}))["response"]


def to(position: float, **item: Any) -> Any:
    return {"req": {"goal_constraints": [{"joint_constraints": [joint("elbow_flex", position)]}]}, **item}


def ends(motion: Any) -> tuple[Any, Any]:
    points = motion["joint_trajectory"]["points"]
    return points[0]["positions"], points[-1]["positions"]


@pytest.fixture
def rig() -> ServiceRig:
    return ServiceRig()


async def test_each_motion_begins_where_the_one_before_ends(rig: ServiceRig) -> None:
    response = await planned(rig, to(0.3), to(0.6), to(0.1))
    assert response["error_code"]["val"] == MoveItErrorCode.SUCCESS
    motions = [ends(motion) for motion in response["planned_trajectories"]]
    assert [last for _, last in motions[:-1]] == [pytest.approx(first) for first, _ in motions[1:]]


async def test_the_motions_before_the_one_that_fails_are_told_with_its_place(rig: ServiceRig) -> None:
    far = {"req": {"goal_constraints": [{"position_constraints": [ball(0.9, 0.0, 0.2)]}]}}
    response = await planned(rig, to(0.3), far)
    assert response["error_code"]["val"] == MoveItErrorCode.NO_IK_SOLUTION
    assert "items[1]" in response["error_code"]["message"]
    assert len(response["planned_trajectories"]) == 1


@pytest.mark.parametrize("items", [[], [to(0.3, blend_radius=0.05), to(0.6)]])
async def test_a_sequence_that_cannot_be_is_refused(rig: ServiceRig, items) -> None:
    response = await planned(rig, *items)
    assert response["error_code"]["val"] == MoveItErrorCode.INVALID_MOTION_PLAN
    assert not response["planned_trajectories"]

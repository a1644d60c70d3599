from __future__ import annotations

import pytest

from planners.problem import PLANNER_IDS
from tests.helpers.moveit_services import ServiceRig


@pytest.fixture
def rig() -> ServiceRig:
    return ServiceRig()


async def params(rig: ServiceRig, **fields):
    told = (await rig.call("/get_planner_params", **fields))["params"]
    return dict(zip(told["keys"], told["values"], strict=True))


async def test_every_planner_is_told_under_its_pipeline(rig: ServiceRig) -> None:
    told = (await rig.call("/query_planner_interface"))["planner_interfaces"]
    by_pipeline = {one["pipeline_id"]: one["planner_ids"] for one in told}
    assert by_pipeline["ompl"] == list(PLANNER_IDS)
    assert by_pipeline["pilz_industrial_motion_planner"] == ["PTP", "LIN", "CIRC"]


async def test_what_is_set_is_told(rig: ServiceRig) -> None:
    wanted = {"keys": ["num_planning_attempts", "range"], "values": ["3", "0.1"]}
    await rig.call("/set_planner_params", group="arm", params=wanted)
    told = await params(rig, group="arm")
    assert (told["num_planning_attempts"], told["range"]) == ("3", "0.1")


async def test_a_parameter_that_changes_nothing_says_so(rig: ServiceRig) -> None:
    await rig.call("/set_planner_params", params={"keys": ["range"], "values": ["0.1"]})
    told = (await rig.call("/get_planner_params"))["params"]
    described = dict(zip(told["keys"], told["descriptions"], strict=True))
    assert described["range"]
    assert not described["planner_id"]


BAD = {
    "value": ({"params": {"keys": ["num_planning_attempts"], "values": ["many"]}}, "num_planning_attempts"),
    "lists": ({"params": {"keys": ["range"], "values": []}}, "1 entries"),
    "group": ({"group": "manipulator"}, "'manipulator'"),
    "pipeline": ({"pipeline_id": "chomp"}, "'chomp'"),
}


@pytest.mark.parametrize(("fields", "words"), BAD.values(), ids=BAD.keys())
async def test_what_cannot_be_set_fails_with_a_sentence(rig: ServiceRig, fields, words) -> None:
    ok, said = await rig.outcome("/set_planner_params", **fields)
    assert not ok
    assert words in said


async def test_what_failed_to_be_set_changed_nothing(rig: ServiceRig) -> None:
    before = await params(rig)
    await rig.outcome("/set_planner_params", params={"keys": ["range", "planner_id"], "values": ["1", "CHOMP"]})
    assert await params(rig) == before

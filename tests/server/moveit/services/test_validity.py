from __future__ import annotations

from typing import Any

import pytest

from tests.helpers.moveit_requests import HOME, ball, joint, point, turned
from tests.helpers.moveit_services import ServiceRig

FOLDED = {"shoulder_lift": -1.7, "elbow_flex": 1.6, "wrist_flex": 1.6}


@pytest.fixture
def rig() -> ServiceRig:
    return ServiceRig()


async def check(rig: ServiceRig, positions=None, **fields: Any) -> Any:
    positions = positions or {}
    joints = {"name": list(positions), "position": list(positions.values())}
    return await rig.call("/check_state_validity", robot_state={"joint_state": joints}, **fields)


async def test_a_free_state_is_valid(rig: ServiceRig) -> None:
    answer = await check(rig, HOME)
    assert answer["valid"]
    assert answer["contacts"] == answer["constraint_result"] == []


async def test_contacts_are_told_with_bodies_depth_and_place(rig: ServiceRig) -> None:
    answer = await check(rig, FOLDED)
    deepest = answer["contacts"][0]
    assert not answer["valid"]
    assert {deepest["contact_body_1"], deepest["contact_body_2"]} == {"shoulder_link", "gripper_link"}
    assert deepest["depth"] > 0.01
    assert 0.0 < deepest["position"]["z"] < 0.2
    assert (deepest["body_type_1"], deepest["body_type_2"]) == (0, 0)


async def test_contacts_are_shown(rig: ServiceRig) -> None:
    shown = rig.listen("/display_contacts", "visualization_msgs/MarkerArray")
    answer = await check(rig, FOLDED)
    assert len(shown[-1]["markers"]) == 1 + len(answer["contacts"])


async def test_things_are_told_from_links(rig: ServiceRig) -> None:
    box = {"primitives": [{"type": 1, "dimensions": [0.1] * 3}], "primitive_poses": [point(0.39, 0.0, 0.22)]}
    scene = {"is_diff": True, "world": {"collision_objects": [{"id": "crate", **box}]}}
    rig.scene_state.apply_diff(rig.graph.interfaces.complete("moveit_msgs/msg/PlanningScene", scene), HOME)
    contact = (await check(rig))["contacts"][0]
    types = {contact["contact_body_1"]: contact["body_type_1"], contact["contact_body_2"]: contact["body_type_2"]}
    assert types["crate"] == 1


async def test_a_state_beyond_the_limits_is_not_valid(rig: ServiceRig, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "armbridge")
    assert not (await check(rig, {"elbow_flex": 2.0}))["valid"]
    assert any("elbow_flex" in record.getMessage() for record in caplog.records)


async def test_each_constraint_has_its_result(rig: ServiceRig) -> None:
    constraints = {
        "joint_constraints": [
            joint("elbow_flex", 0.0, 0.1, 0.1),
            joint("wrist_roll", 0.5, 0.1, 0.2),
            joint("wrist_flex", -0.5, 0.1, 0.2),
        ],
        "position_constraints": [ball(0.39136, 0.0, 0.22647, 0.01)],
        "orientation_constraints": [turned(0.1)],
    }
    answer = await check(rig, HOME, constraints=constraints)
    held, below, above, position, orientation = answer["constraint_result"]
    assert not answer["valid"]
    assert (held["result"], held["distance"]) == (True, 0.0)
    assert below["result"] is above["result"] is False
    assert below["distance"] == pytest.approx(0.3)
    assert above["distance"] == pytest.approx(0.4)
    assert position["result"]
    assert not orientation["result"]
    assert orientation["distance"] > 1.0


@pytest.mark.parametrize(
    "fields", [{"group_name": "manipulator"}, {"constraints": {"joint_constraints": [joint("knee", 0.0)]}}]
)
async def test_what_cannot_be_asked_about_is_not_valid_and_the_log_says_why(rig, caplog, fields) -> None:
    assert not (await check(rig, **fields))["valid"]
    assert any("/check_state_validity" in record.getMessage() for record in caplog.records)

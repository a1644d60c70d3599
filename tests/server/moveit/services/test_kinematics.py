"""``/compute_ik``, ``/compute_fk`` and ``/check_state_validity``."""

from __future__ import annotations

from typing import Any

import pytest

from planners.problem import MoveItErrorCode
from server.moveit.requests.planning_problems import MAX_LINKS, _goal_of_links
from tests.helpers.fake_arm import HOME
from tests.helpers.moveit import SEVEN, TIP, ServiceRig, ball, context, joint, message, point, turned

AT = point(0.25, 0.05, 0.2, w=1.0)


async def ik(rig: ServiceRig, pose=AT, frame="", **fields: Any) -> Any:
    stamped = {"header": {"frame_id": frame}, "pose": pose}
    return await rig.call("/compute_ik", ik_request={"pose_stamped": stamped, **fields})


async def tip_m(rig: ServiceRig, solution: Any, link: str = TIP) -> tuple[float, ...]:
    (told,) = (await rig.call("/compute_fk", fk_link_names=[link], robot_state=solution))["pose_stamped"]
    return tuple(told["pose"]["position"][axis] for axis in "xyz")


async def test_forward_kinematics_leads_back_to_the_pose(rig: ServiceRig) -> None:
    answer = await ik(rig)
    assert answer["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert await tip_m(rig, answer["solution"]) == pytest.approx((0.25, 0.05, 0.2), abs=2e-4)


async def test_five_joints_take_the_nearest_orientation_and_tell_how_far_it_is_off(rig: ServiceRig) -> None:
    assert "degrees off" in (await ik(rig))["error_code"]["message"]


async def test_a_pose_in_a_moving_frame_is_placed_by_the_seed(rig: ServiceRig) -> None:
    seed = {"joint_state": {"name": ["shoulder_pan"], "position": [0.5]}}
    there = await tip_m(rig, seed)
    answer = await ik(rig, point(0.0, 0.0, 0.0, w=1.0), TIP, robot_state=seed)
    assert await tip_m(rig, answer["solution"]) == pytest.approx(there, abs=2e-4)


async def test_several_links_are_placed_together(rig: ServiceRig) -> None:
    seed = {"joint_state": {"name": ["elbow_flex"], "position": [0.4]}}
    links = ["lower_arm_link", TIP]
    poses = [{"header": {}, "pose": point(*await tip_m(rig, seed, link), w=1.0)} for link in links]
    answer = await rig.call("/compute_ik", ik_request={"ik_link_names": links, "pose_stamped_vector": poses})
    assert answer["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert await tip_m(rig, answer["solution"], links[0]) == pytest.approx(await tip_m(rig, seed, links[0]), abs=3e-4)


def test_seven_joints_keep_the_orientations_of_several_links() -> None:
    stamped = message("geometry_msgs/PoseStamped", pose=AT)
    goal = _goal_of_links(["hand", "tool"], [stamped, stamped], context(SEVEN))
    assert [one.link for one in goal.constraints.orientations] == ["hand", "tool"]
    assert all(len(one.tolerance_rad) == 3 for one in goal.constraints.orientations)


async def test_a_seed_beyond_its_limits_is_no_obstacle(rig: ServiceRig) -> None:
    seed = {"joint_state": {"name": ["elbow_flex"], "position": [3.0]}}
    assert (await ik(rig, robot_state=seed))["error_code"]["val"] == MoveItErrorCode.SUCCESS


BAD = {
    "out of reach": ({"pose": point(0.9, 0.0, 0.2)}, -31, "nearest point it can reach"),
    "unknown group": ({"group_name": "manipulator"}, -15, "'manipulator'"),
    "unknown link": ({"ik_link_name": "hand"}, -18, "'hand'"),
    "unknown frame": ({"frame": "moon"}, -21, "'moon'"),
    "no number": ({"pose": point(float("nan"), 0.0, 0.2)}, -16, "position.x"),
    "unlike lists": ({"ik_link_names": [TIP, "wrist_link"]}, -16, "2 entries and pose_stamped_vector 0"),
    "unknown joint": ({"robot_state": {"joint_state": {"name": ["knee"], "position": [0.0]}}}, -17, "'knee'"),
}


@pytest.mark.parametrize(("fields", "code", "words"), BAD.values(), ids=BAD.keys())
async def test_a_pose_without_solution_has_its_code_and_message(rig: ServiceRig, fields, code, words) -> None:
    answer = await ik(rig, **fields)
    assert answer["error_code"]["val"] == code
    assert words in answer["error_code"]["message"]


async def test_a_solution_in_contact_counts_unless_contacts_are_to_be_avoided(rig: ServiceRig) -> None:
    inside = point(0.0, 0.0, 0.2, w=1.0)
    touching, free = await ik(rig, inside), await ik(rig, inside, avoid_collisions=True)
    assert touching["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert free["error_code"]["val"] == MoveItErrorCode.NO_IK_SOLUTION
    assert "these would touch" in free["error_code"]["message"]


async def test_a_timeout_with_a_second_of_nanoseconds_is_refused_by_name(rig: ServiceRig) -> None:
    refused = await ik(rig, timeout={"sec": 0, "nanosec": 1_000_000_000})
    assert "ik_request.timeout.nanosec must be below 1000000000, not 1000000000" in refused["error_code"]["message"]


async def test_poses_are_in_the_requested_frame(rig: ServiceRig) -> None:
    answer = await rig.call("/compute_fk", header={"frame_id": TIP}, fk_link_names=[TIP])
    (told,) = answer["pose_stamped"]
    assert told["header"]["frame_id"] == TIP
    assert list(told["pose"]["position"].values()) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


async def test_more_links_than_any_robot_has_are_refused_before_they_cost_anything(rig: ServiceRig) -> None:
    names = [TIP] * (MAX_LINKS + 1)
    asked = await rig.outcome("/compute_fk", fk_link_names=names)
    sought = await rig.outcome("/compute_ik", ik_request={"ik_link_names": names})
    for (ok, sentence), field in ((asked, "fk_link_names"), (sought, "ik_request.ik_link_names")):
        assert not ok
        assert f"field {field}: wanted at most {MAX_LINKS} elements in all, got {MAX_LINKS + 1}" in sentence


FOLDED = {"shoulder_lift": -1.7, "elbow_flex": 1.6, "wrist_flex": 1.6}


async def check(rig: ServiceRig, positions=None, **fields: Any) -> Any:
    positions = positions or {}
    joints = {"name": list(positions), "position": list(positions.values())}
    return await rig.call("/check_state_validity", robot_state={"joint_state": joints}, **fields)


async def test_contacts_have_bodies_depth_and_position(rig: ServiceRig) -> None:
    answer = await check(rig, FOLDED)
    deepest = answer["contacts"][0]
    assert not answer["valid"]
    assert {deepest["contact_body_1"], deepest["contact_body_2"]} == {"shoulder_link", "gripper_link"}
    assert deepest["depth"] > 0.01
    assert 0.0 < deepest["position"]["z"] < 0.2
    assert (deepest["body_type_1"], deepest["body_type_2"]) == (0, 0)


async def test_objects_and_links_have_different_body_types(rig: ServiceRig) -> None:
    box = {"primitives": [{"type": 1, "dimensions": [0.1] * 3}], "primitive_poses": [point(0.39, 0.0, 0.22)]}
    scene = {"is_diff": True, "world": {"collision_objects": [{"id": "crate", **box}]}}
    rig.scene_state.apply_diff(rig.graph.message_types.complete("moveit_msgs/msg/PlanningScene", scene), HOME)
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
async def test_a_rejected_state_is_not_valid_and_the_reason_is_logged(rig, caplog, fields) -> None:
    assert not (await check(rig, **fields))["valid"]
    assert any("/check_state_validity" in record.getMessage() for record in caplog.records)

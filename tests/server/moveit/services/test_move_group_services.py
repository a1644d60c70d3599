"""Services of MoveIt that plan, and those that describe planners and groups."""

import math
from typing import Any

import pytest

from planners.problem import PLANNER_IDS, MoveItErrorCode
from robot.description import model
from server.moveit.requests.planning_problems import MAX_LINKS, PILZ
from server.moveit.services.move_group_services import SERVICES, group_urdf
from tests.helpers.fake_arm import HOME
from tests.helpers.graph import called
from tests.helpers.messages import made_up
from tests.helpers.moveit import (
    REGISTRY,
    ROBOT,
    TIP,
    ServiceRig,
    ball,
    box,
    diff,
    joint,
    point,
    pose,
    turned,
)


async def test_every_service_answers_empty_requests_and_nonsense_also_of_an_unread_arm(rig: ServiceRig) -> None:
    for known in (True, False):
        for name, offer in SERVICES.items():
            assert rig.graph.services.names.type_of(name) == f"moveit_msgs/srv/{offer.type_name}"
            ok, values = await rig.outcome(name)
            assert ok, (name, known, values)
            for seed in range(5):
                request = made_up(REGISTRY, f"moveit_msgs/srv/{offer.type_name}_Request", seed + 5 * known)
                _, values = await rig.outcome(name, **request)
                assert "inside the server" not in str(values), (name, seed)
        rig.arm.lose_positions()


# Shoulder and gripper overlap by centimetres.
FOLDED = {"shoulder_lift": -1.7, "elbow_flex": 1.6, "wrist_flex": 1.6}
REACHABLE = {"position_constraints": [ball(0.3, 0.0, 0.2)]}
ELBOW = {"joint_constraints": [joint("elbow_flex", 0.5)]}


async def planned(rig: ServiceRig, *goals: Any, **fields: Any) -> Any:
    request = {"goal_constraints": list(goals or [ELBOW]), **fields}
    return (await rig.call("/plan_kinematic_path", motion_plan_request=request))["motion_plan_response"]


def points(response: Any) -> list[Any]:
    return response["trajectory"]["joint_trajectory"]["points"]


def start_state(positions):
    return {"joint_state": {"name": list(positions), "position": list(positions.values())}}


def put_crate(rig: ServiceRig, x: float, y: float, z: float) -> None:
    crate = box("crate", at=pose(x, y, z), primitives=[{"type": 1, "dimensions": [0.1] * 3}])
    rig.scene_state.apply_diff(diff(world={"collision_objects": [crate]}), HOME)


async def test_a_motion_leads_from_the_start_to_the_goal_and_the_pipeline_state_shows_it(rig: ServiceRig) -> None:
    heard = rig.listen("/pipeline_state", "moveit_msgs/PipelineState")
    paths = rig.listen("/display_planned_path", "moveit_msgs/DisplayTrajectory")
    response = await planned(rig, start_state=start_state({"wrist_roll": 0.2}))
    assert response["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert response["group_name"] == "arm"
    first, last = points(response)[0]["positions"], points(response)[-1]["positions"]
    names = response["trajectory"]["joint_trajectory"]["joint_names"]
    assert dict(zip(names, first, strict=True))["wrist_roll"] == pytest.approx(0.2)
    assert dict(zip(names, last, strict=True))["elbow_flex"] == pytest.approx(0.5)
    assert response["trajectory_start"]["joint_state"]["position"][-2] == pytest.approx(0.2)
    assert heard[-1]["request"]["start_state"]["joint_state"]["name"] == ["wrist_roll"]
    assert heard[-1]["response"]["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert (paths[-1]["model_id"], paths[-1]["trajectory"]) == (ROBOT.name, [response["trajectory"]])
    assert paths[-1]["trajectory_start"] == response["trajectory_start"]


async def test_warnings_are_in_the_message_of_a_success(rig: ServiceRig) -> None:
    code = (await planned(rig, start_state=start_state({"elbow_flex": -1.72}), planner_id="CHOMP"))["error_code"]
    assert code["val"] == MoveItErrorCode.SUCCESS
    assert "elbow_flex" in code["message"]
    assert "'CHOMP'" in code["message"]


FAR = {"position_constraints": [ball(0.8, 0.0, 0.2)]}
IN_THE_CRATE = {"position_constraints": [ball(0.0, 0.35, 0.2)]}
LINE = {"pipeline_id": PILZ, "planner_id": "LIN"}
ON_THE_MOON = {"position_constraints": [ball(0.3, 0.0, 0.2, header={"frame_id": "moon"})]}
UNPLANNABLE = [
    (ELBOW, {"group_name": "manipulator"}, -15, "'manipulator'"),
    (ELBOW, {"pipeline_id": "chomp"}, 99999, "'chomp'"),
    ({"joint_constraints": [joint("elbow_flex", 3.0)]}, {}, -16, "-1.69 to 1.69"),
    (ON_THE_MOON, {}, -21, "'moon'"),
    (FAR, {}, -31, "nearest point it can reach"),
    (REACHABLE | {"orientation_constraints": [turned(0.1)]}, {}, -31, "not in the orientation asked for"),
    (ELBOW, {"start_state": start_state({"elbow_flex": -2.0})}, -26, "'elbow_flex'"),
    (ELBOW, {"start_state": start_state(FOLDED)}, -10, "shoulder_link and gripper_link"),
    ({"joint_constraints": [joint(*each) for each in FOLDED.items()]}, {}, -12, "the nearest configuration that was"),
    (ELBOW, {"path_constraints": {"position_constraints": [ball(0.2, 0.2, 0.2)]}}, -11, TIP),
    (REACHABLE, {"allowed_planning_time": 1e-6}, -6, "allowed"),
]


@pytest.mark.parametrize(("goal", "fields", "code", "words"), UNPLANNABLE)
async def test_a_failed_plan_has_its_code_and_message(rig, goal, fields, code, words) -> None:
    response = await planned(rig, goal, **fields)
    assert response["error_code"]["val"] == code
    assert words in response["error_code"]["message"]
    assert not points(response)


async def test_a_goal_in_collision_names_the_object_and_shows_the_contact(rig: ServiceRig) -> None:
    shown = rig.listen("/display_contacts", "visualization_msgs/MarkerArray")
    put_crate(rig, 0.0, 0.35, 0.2)
    code = (await planned(rig, IN_THE_CRATE))["error_code"]
    assert code["val"] == MoveItErrorCode.GOAL_IN_COLLISION
    assert "crate" in code["message"]
    # Contacts are spheres, in place of those before.
    clear, *balls = shown[-1]["markers"]
    assert (clear["action"], balls[-1]["type"], balls[-1]["header"]["frame_id"]) == (3, 2, ROBOT.root_link)
    assert "crate" in balls[-1]["ns"]
    assert math.dist(balls[-1]["pose"]["position"].values(), (0.0, 0.35, 0.2)) < 0.1


@pytest.mark.parametrize("service", ["/plan_kinematic_path", "/plan_sequence_path"])
@pytest.mark.parametrize(
    ("goal", "fields", "code", "words"),
    [(FAR, LINE, -31, "the same path to ("), (IN_THE_CRATE, {}, -12, "the nearest point that was found, (")],
)
async def test_a_failed_plan_says_what_would_work(rig: ServiceRig, service: str, goal, fields, code, words) -> None:
    put_crate(rig, 0.0, 0.35, 0.2)
    if service == "/plan_kinematic_path":
        response = await planned(rig, goal, **fields)
    else:
        response = await planned_sequence(rig, {"req": {"goal_constraints": [goal], **fields}})
    assert response["error_code"]["val"] == code
    assert f"what would work: {words}" in response["error_code"]["message"]


async def planned_sequence(rig: ServiceRig, *items: Any) -> Any:
    return (await rig.call("/plan_sequence_path", request={"items": list(items)}))["response"]


def to(position: float) -> Any:
    return {"req": {"goal_constraints": [{"joint_constraints": [joint("elbow_flex", position)]}]}}


async def test_the_motions_before_a_failed_item_are_in_the_response(rig: ServiceRig) -> None:
    response = await planned_sequence(rig, to(0.3), {"req": {"goal_constraints": [FAR]}})
    assert response["error_code"]["val"] == MoveItErrorCode.NO_IK_SOLUTION
    assert "items[1]" in response["error_code"]["message"]
    assert len(response["planned_trajectories"]) == 1


async def test_every_planner_is_listed_and_the_parameters_that_were_set_are_returned(rig: ServiceRig) -> None:
    told = (await rig.call("/query_planner_interface"))["planner_interfaces"]
    by_pipeline = {one["pipeline_id"]: one["planner_ids"] for one in told}
    assert by_pipeline["ompl"] == list(PLANNER_IDS)
    assert by_pipeline["pilz_industrial_motion_planner"] == ["PTP", "LIN", "CIRC"]
    wanted = {"keys": ["num_planning_attempts", "range"], "values": ["3", "0.1"]}
    await rig.call("/set_planner_params", group="arm", params=wanted)
    params = (await rig.call("/get_planner_params", group="arm"))["params"]
    shown = {key: (value, text) for key, value, text in zip(*(params[field] for field in params), strict=True)}
    assert (shown["num_planning_attempts"], shown["range"]) == (("3", ""), ("0.1", "kept, changes nothing"))


async def test_a_bad_parameter_fails_with_a_message_and_changes_nothing(rig: ServiceRig) -> None:
    for fields, words in (
        ({"params": {"keys": ["range", "num_planning_attempts"], "values": ["1", "many"]}}, "num_planning_attempts"),
        ({"params": {"keys": ["range"], "values": []}}, "1 entries"),
        ({"group": "manipulator"}, "'manipulator'"),
        ({"pipeline_id": "chomp"}, "'chomp'"),
    ):
        before = await rig.call("/get_planner_params")
        ok, said = await rig.outcome("/set_planner_params", **fields)
        assert not ok, fields
        assert words in said
        assert await rig.call("/get_planner_params") == before, fields


@pytest.mark.parametrize("name", ["arm", "gripper"])
def test_a_groups_urdf_is_a_robot_with_its_joints(name: str) -> None:
    group = ROBOT.groups[name]
    chain = f'<chain base_link="{group.base_link}" tip_link="{group.tip_link}"/>'
    srdf = f'<robot name="{name}"><group name="{name}">{chain}</group></robot>'
    part = model.parse(group_urdf(ROBOT, group), srdf)
    assert part.groups[name].joints == group.joints
    assert part.root_link == group.base_link


async def test_responses_are_complete_messages(rig: ServiceRig) -> None:
    requests: dict[str, dict[str, Any]] = {
        "/plan_kinematic_path": {"motion_plan_request": {"goal_constraints": [ELBOW]}},
        "/plan_sequence_path": {"request": {"items": [to(0.3)]}},
        "/compute_cartesian_path": {"waypoints": [{}], "max_step": 0.01},
        "/check_state_validity": {"robot_state": start_state(FOLDED)},
        "/compute_ik": {"ik_request": {"pose_stamped": {"pose": AT}}},
    }
    for service in SERVICES:
        response = await rig.call(service, **requests.get(service, {}))
        type_name = f"{rig.graph.services.names.type_of(service)}_Response"
        assert rig.graph.message_types.complete(type_name, response) == response


AT = point(0.25, 0.05, 0.2, w=1.0)


async def ik(rig: ServiceRig, pose=AT, frame="", **fields: Any) -> Any:
    stamped = {"header": {"frame_id": frame}, "pose": pose}
    return await rig.call("/compute_ik", ik_request={"pose_stamped": stamped, **fields})


async def tip_m(rig: ServiceRig, solution: Any) -> tuple[float, ...]:
    (told,) = (await rig.call("/compute_fk", fk_link_names=[TIP], robot_state=solution))["pose_stamped"]
    return tuple(told["pose"]["position"][axis] for axis in "xyz")


async def test_a_pose_is_reached_in_the_nearest_orientation_and_a_moving_frame(rig: ServiceRig) -> None:
    # A seed beyond its limits is no obstacle.
    answer = await ik(rig, robot_state=start_state({"elbow_flex": 3.0}))
    assert answer["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert "degrees off" in answer["error_code"]["message"]
    assert await tip_m(rig, answer["solution"]) == pytest.approx((0.25, 0.05, 0.2), abs=2e-4)
    seed = start_state({"shoulder_pan": 0.5})
    there = await tip_m(rig, seed)
    answer = await ik(rig, point(0.0, 0.0, 0.0, w=1.0), TIP, robot_state=seed)
    assert await tip_m(rig, answer["solution"]) == pytest.approx(there, abs=2e-4)


async def test_a_pose_without_solution_has_its_code_and_message(rig: ServiceRig) -> None:
    for fields, code, words in (
        ({"pose": point(0.9, 0.0, 0.2)}, -31, "nearest point it can reach"),
        ({"group_name": "manipulator"}, -15, "'manipulator'"),
        ({"ik_link_name": "hand"}, -18, "'hand'"),
        ({"frame": "moon"}, -21, "'moon'"),
        ({"pose": point(float("nan"), 0.0, 0.2)}, -16, "position.x"),
        ({"ik_link_names": [TIP, "wrist_link"]}, -16, "must have one entry at most, not 2 and 0"),
        ({"robot_state": start_state({"knee": 0.0})}, -17, "'knee'"),
        ({"timeout": {"nanosec": 10**9}}, -16, "ik_request.timeout.nanosec must be below 1000000000, not 1000000000"),
    ):
        answer = await ik(rig, **fields)
        assert answer["error_code"]["val"] == code
        assert words in answer["error_code"]["message"]


async def test_a_solution_in_contact_counts_unless_contacts_are_to_be_avoided(rig: ServiceRig) -> None:
    inside = point(0.0, 0.0, 0.2, w=1.0)
    touching, free = await ik(rig, inside), await ik(rig, inside, avoid_collisions=True)
    assert touching["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert free["error_code"]["val"] == MoveItErrorCode.NO_IK_SOLUTION
    assert "these would touch" in free["error_code"]["message"]


async def test_poses_are_in_the_requested_frame(rig: ServiceRig) -> None:
    answer = await rig.call("/compute_fk", header={"frame_id": TIP}, fk_link_names=[TIP])
    (told,) = answer["pose_stamped"]
    assert told["header"]["frame_id"] == TIP
    assert list(told["pose"]["position"].values()) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


async def test_more_links_than_any_robot_has_are_refused_before_they_cost_anything(rig: ServiceRig) -> None:
    names = [TIP] * (MAX_LINKS + 1)
    for service, request, field in (
        ("/compute_fk", {"fk_link_names": names}, "fk_link_names"),
        ("/compute_ik", {"ik_request": {"ik_link_names": names}}, "ik_request.ik_link_names"),
    ):
        ok, sentence = await rig.outcome(service, **request)
        assert not ok
        assert f"field {field}: wanted at most {MAX_LINKS} elements in all, got {MAX_LINKS + 1}" in sentence


async def check(rig: ServiceRig, positions=None, **fields: Any) -> Any:
    return await rig.call("/check_state_validity", robot_state=start_state(positions or {}), **fields)


async def test_contacts_have_bodies_depth_and_position(rig: ServiceRig) -> None:
    answer = await check(rig, FOLDED)
    deepest = answer["contacts"][0]
    assert not answer["valid"]
    assert {deepest["contact_body_1"], deepest["contact_body_2"]} == {"shoulder_link", "gripper_link"}
    assert deepest["depth"] > 0.01
    assert 0.0 < deepest["position"]["z"] < 0.2
    assert (deepest["body_type_1"], deepest["body_type_2"]) == (0, 0)
    # An object is of another type.
    put_crate(rig, 0.39, 0.0, 0.22)
    contact = (await check(rig))["contacts"][0]
    types = {contact["contact_body_1"]: contact["body_type_1"], contact["contact_body_2"]: contact["body_type_2"]}
    assert types["crate"] == 1


async def test_each_constraint_has_its_result(rig: ServiceRig) -> None:
    held_below_above = (("elbow_flex", 0.0, 0.1, 0.1), ("wrist_roll", 0.5, 0.1, 0.2), ("wrist_flex", -0.5, 0.1, 0.2))
    constraints = {
        "joint_constraints": [joint(*each) for each in held_below_above],
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
    ("fields", "words"),
    [
        ({"robot_state": start_state({"elbow_flex": 9.0})}, "elbow_flex"),
        ({"group_name": "manipulator"}, "'manipulator'"),
        ({"constraints": {"joint_constraints": [joint("knee", 0.0)]}}, "'knee'"),
    ],
)
async def test_a_rejected_state_is_not_valid_and_its_reason_is_told_and_logged(rig, caplog, fields, words) -> None:
    caplog.set_level("INFO", "armbridge")
    answer = await called(rig.graph, "/check_state_validity", **fields)
    assert answer.values["valid"] is False
    assert words in answer.reason
    assert any("/check_state_validity" in line.getMessage() and words in line.getMessage() for line in caplog.records)

"""The simple layer on a running server, by clients that know frames only."""

from __future__ import annotations

import json
import math
from typing import Any

from tests.helpers.arm_server import ArmClient, ServerOnBus, values_of
from tests.helpers.client import frame_client

JOINT_GOAL = ("/moveit_goal_joints", "sensor_msgs/JointState")
NAMED_GOAL = ("/moveit_goal_named", "std_msgs/String")
RESULT, STATUS = "/moveit_goal_result", "/moveit_goal_status"

# Backlash, droop and one tick of rounding.
ARRIVED_RAD = 0.06

# To the letter what the Unreal actor of the first setup sends: types in two parts, stamps of zero.
UNREAL_OPENS = (
    '{"op":"advertise","topic":"/moveit_goal_named","type":"std_msgs/String"}',
    '{"op":"advertise","topic":"/moveit_goal_joints","type":"sensor_msgs/JointState"}',
    '{"op":"advertise","topic":"/moveit_goal_pose","type":"geometry_msgs/PoseStamped"}',
    '{"op":"subscribe","topic":"/joint_states","type":"sensor_msgs/JointState"}',
)
UNREAL_NAMED = '{"op":"publish","topic":"/moveit_goal_named","msg":{"data":"ready"}}'
UNREAL_POSE_OUT_OF_REACH = (
    '{"op":"publish","topic":"/moveit_goal_pose","msg":{"header":{"stamp":{"sec":0,"nanosec":0},'
    '"frame_id":"base_link"},"pose":{"position":{"x":0.9,"y":0.0,"z":0.2},'
    '"orientation":{"x":0.0,"y":0.0,"z":0.0,"w":1.0}}}}'
)
UNREAL_JOINTS = (
    '{"op":"publish","topic":"/moveit_goal_joints","msg":{"header":{"stamp":{"sec":0,"nanosec":0},"frame_id":""},'
    '"name":["shoulder_pan","shoulder_lift","elbow_flex","wrist_flex","wrist_roll"],'
    '"position":[1.5,-0.5,0.5,0.2,0.0],"velocity":[],"effort":[]}}'
)


async def test_the_client_of_the_old_setup_moves_the_arm_is_refused_with_a_sentence_and_stopped(
    served: ServerOnBus,
    client: ArmClient,
) -> None:
    async with frame_client(f"{served.server.url}/?x=1") as unreal:
        for frame in UNREAL_OPENS:
            await unreal.send(frame)
        await unreal.subscribe(RESULT, "moveit_msgs/MoveItErrorCodes")
        await unreal.subscribe(STATUS, "diagnostic_msgs/DiagnosticStatus")
        await unreal.send(UNREAL_NAMED)
        assert (await unreal.wait_for(RESULT, bool))[0]["val"] == 1
        assert abs(unreal.messages("/joint_states")[-1]["position"][1] + 0.5) < ARRIVED_RAD

        await unreal.send(UNREAL_POSE_OUT_OF_REACH)
        refused = (await unreal.wait_for(RESULT, lambda all_: len(all_) == 2))[1]
        assert refused["val"] == -31
        assert "cannot reach (0.9, 0, 0.2) m" in refused["message"]
        assert values_of(unreal.messages(STATUS)[-1])["stamp"] == "0.000000000"

        suggested = json.loads(values_of(unreal.messages(STATUS)[-1])["suggested_goal"])
        await unreal.publish(suggested["topic"], suggested["msg"])
        assert (await unreal.wait_for(RESULT, lambda all_: len(all_) == 3))[2]["val"] == 1

        await unreal.send(UNREAL_JOINTS)
        await unreal.wait_for("/joint_states", lambda states: states[-1]["velocity"][0] > 0.3)
        await unreal.send({"op": "advertise", "topic": "/stop", "type": "std_msgs/Empty"})
        await unreal.send({"op": "publish", "topic": "/stop", "msg": {}})
        stopped = (await unreal.wait_for(RESULT, lambda all_: len(all_) == 4))[3]
        assert stopped["val"] == -7
        assert "/stop" in stopped["message"]
        assert unreal.messages("/joint_states")[-1]["position"][0] < 1.4


async def finished(client: ArmClient, count: int) -> dict[str, Any]:
    return (await client.until(RESULT, lambda all_: len(all_) >= count))[count - 1]


def last_pan_rad(shown: dict[str, Any]) -> float:
    """Where a displayed path ends."""
    path = shown["trajectory"][0]["joint_trajectory"]
    return float(path["points"][-1]["positions"][path["joint_names"].index("shoulder_pan")])


async def test_a_pose_that_was_saved_is_gone_to_by_its_name_after_it_was_confirmed(client: ArmClient) -> None:
    await client.goal(*JOINT_GOAL, {"name": ["shoulder_pan"], "position": [0.3]})
    assert (await finished(client, 1))["val"] == 1
    assert (await client.call("/save_robot_state", name="Beside the mug"))["success"]
    await client.goal(*JOINT_GOAL, {"name": ["shoulder_pan"], "position": [0.0]})
    await finished(client, 2)
    assert (await client.call("/moveit_goal_confirm_mode", data=True))["success"]
    try:
        await client.say("subscribe", topic=STATUS, type="diagnostic_msgs/DiagnosticStatus")
        await client.say("subscribe", topic="/display_planned_path", type="moveit_msgs/DisplayTrajectory")
        await client.goal(*NAMED_GOAL, {"data": "beside the mug"})
        await client.until(STATUS, lambda all_: values_of(all_[-1])["state"] == "planned")
        await client.until("/display_planned_path", lambda shown: abs(last_pan_rad(shown[-1]) - 0.3) < ARRIVED_RAD)
        assert abs(client.topics["/joint_states"][-1]["position"][0]) < ARRIVED_RAD
        await client.goal("/moveit_goal_confirm", "std_msgs/Bool", {"data": True})
        assert (await finished(client, 3))["val"] == 1
        assert abs(client.topics["/joint_states"][-1]["position"][0] - 0.3) < ARRIVED_RAD
    finally:
        await client.call("/moveit_goal_confirm_mode", data=False)


async def test_a_hundred_goals_are_checked_in_one_call(client: ArmClient) -> None:
    around = [
        {"pose": {"position": {"x": 0.25 * math.cos(turn / 16), "y": 0.25 * math.sin(turn / 16), "z": 0.2}}}
        for turn in range(-25, 25)
    ]
    far = [{"pose": {"position": {"x": 2.0, "y": 0.0, "z": 0.02 * turn}}} for turn in range(50)]
    results = (await client.call("/check_goals", poses=around + far))["results"]
    assert sum(result["reachable"] and result["free"] for result in results[:50]) >= 40
    assert not any(result["reachable"] for result in results[50:])
    assert all(result["position_error_m"] > 1.0 for result in results[50:])

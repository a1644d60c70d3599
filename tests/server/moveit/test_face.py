"""MoveIt's face over the wire: a whole server, as clients of both generations see it."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from typing import Any

from websockets.asyncio.client import connect

from protocol.registry import Registry
from robot.description.model import RobotModel, builtin, parse
from server.config import ArmSettings, GoalSettings, GuardSettings, Settings
from server.graph.topics import Graph
from server.moveit.face import MoveItFace
from server.moveit.parameters import MoveItParameters
from server.moveit.patience import Allowance
from tests.helpers import seven_joint_arm
from tests.helpers.arm_server import ArmClient
from tests.helpers.played_arm import PlayedArm
from tests.helpers.server import RunningServer
from tests.server.conftest import ServerOnBus

CANCELED, SUCCEEDED = 5, 4
MOVE, MOVE_TYPE = "/move_action", "moveit_msgs/action/MoveGroup"


def to(position_rad: float, scaling: float = 0.3, **options: Any) -> dict[str, Any]:
    """A goal as sparse as clients write it."""
    constraint = {"joint_constraints": [{"joint_name": "shoulder_pan", "position": position_rad}]}
    request = {"group_name": "arm", "max_velocity_scaling_factor": scaling, "goal_constraints": [constraint]}
    return {"request": request, "planning_options": options}


async def result(client: ArmClient, goal_id: str) -> tuple[int, int]:
    """Status and error code of a goal."""
    ended = await client.result(goal_id)
    return ended["status"], ended["values"]["error_code"]["val"]


async def test_goals_follow_one_another_and_the_last_one_is_reached(client: ArmClient) -> None:
    first = await client.send_goal(MOVE, MOVE_TYPE, to(0.8))
    await asyncio.sleep(0.4)
    second = await client.send_goal("/move_group", MOVE_TYPE, to(-0.2, 1.0))
    assert await result(client, first) == (CANCELED, -7)
    assert await result(client, second) == (SUCCEEDED, 1)


async def test_what_was_planned_can_be_executed_and_cancelled_on_its_way(client: ArmClient) -> None:
    goal = await client.send_goal(MOVE, MOVE_TYPE, to(0.9, plan_only=True))
    planned = (await client.result(goal))["values"]["planned_trajectory"]
    name = "/execute_trajectory"
    goal = await client.send_goal(name, "moveit_msgs/action/ExecuteTrajectory", {"trajectory": planned})
    await client.until_mode("moving")
    await client.say("cancel_action_goal", action=name, id=goal)
    assert await result(client, goal) == (CANCELED, -7)
    assert await client.until_mode("holding")


async def test_an_actionlib_client_of_ros_1_is_served_in_its_own_spelling(
    client: ArmClient, served: ServerOnBus
) -> None:
    running: RunningServer = served.server
    async with connect(running.url, max_size=None) as websocket:

        async def say(op: str, topic: str, **fields: Any) -> None:
            await websocket.send(json.dumps({"op": op, "topic": f"/move_group/{topic}", **fields}))

        async def hear(topic: str) -> Any:
            async with asyncio.timeout(10.0):
                while True:
                    operation = json.loads(await websocket.recv())
                    if operation.get("topic") == f"/move_group/{topic}":
                        return operation["msg"]

        await say("subscribe", "status", type="actionlib_msgs/GoalStatusArray")
        await say("subscribe", "result", type="moveit_msgs/MoveGroupActionResult")
        await say("advertise", "goal", type="moveit_msgs/MoveGroupActionGoal")
        # Clients send nothing before the server has shown that it is there.
        await hear("status")
        zero = {"secs": 0, "nsecs": 0}
        await say("publish", "goal", msg={"goal_id": {"id": "one", "stamp": zero}, "goal": to(0.3, 1.0)})
        told = await hear("result")
    assert told["status"]["goal_id"]["id"] == "one"
    assert told["status"]["goal_id"]["stamp"]["secs"] > 0
    assert (told["status"]["status"], told["result"]["error_code"]["val"]) == (3, 1)
    point = told["result"]["planned_trajectory"]["joint_trajectory"]["points"][-1]
    assert set(point["time_from_start"]) == {"secs", "nsecs"}


def test_what_is_set_reaches_its_place() -> None:
    settings = Settings(
        arm=ArmSettings(tf_rate_hz=10.0, guards=GuardSettings(gripper_torque_limit=0.3)),
        moveit=MoveItParameters(
            allowed_execution_duration_scaling=3.0, allowed_goal_duration_margin=4.0, publish_planning_scene_hz=2.0
        ),
        goals=GoalSettings(max_paused_s=5.0),
    )
    face = MoveItFace(Graph(Registry.load()), builtin(), settings, lambda _name, _value: None)
    gripper = face._gripper(PlayedArm(), builtin().joints["gripper"])  # type: ignore[arg-type]
    assert face._allowance() == gripper._allowance == Allowance(3.0, 4.0, 5.0)
    assert gripper._torque_limit == 0.3
    assert face._transforms._period_s == 0.1
    assert face._scene_interface._parameters.publish_planning_scene_hz == 2.0


def face_of(robot: RobotModel) -> MoveItFace:
    return MoveItFace(Graph(Registry.load()), robot, Settings(), lambda _name, _value: None)


def test_an_arm_has_a_gripper_only_where_that_joint_moves() -> None:
    with_gripper, without = builtin(), parse(seven_joint_arm.URDF, seven_joint_arm.SRDF)
    stiff = replace(with_gripper.joints["gripper"], type="fixed")
    assert face_of(with_gripper)._gripper_joint is with_gripper.joints["gripper"]
    assert face_of(without)._gripper_joint is None
    assert face_of(replace(with_gripper, joints={**with_gripper.joints, "gripper": stiff}))._gripper_joint is None

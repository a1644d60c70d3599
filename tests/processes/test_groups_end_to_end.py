"""Arms with several planning groups, served and moved over a real socket: a column with fingers, and a pair of arms."""

import itertools
import math
from collections.abc import AsyncIterator, Iterator
from typing import Any

import numpy as np
import pytest

from harness.clients import FrameClient, frame_client
from harness.server import RunningServer
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from server.moveit.messages import pose_of, write_pose
from tests.helpers.robots import LIFTED_GRIPPER, LIFTED_SRDF, LIFTED_URDF, PAIR_SRDF, PAIR_URDF, folder_arguments

LIFTED, PAIR = model.parse(LIFTED_URDF, LIFTED_SRDF), model.parse(PAIR_URDF, PAIR_SRDF)
BENT = dict(LIFTED.named_states["arm"]["bent"])

# What the lag of an ideal joint leaves over [rad, m].
ARRIVED = 0.005

# moveit.position_tolerance and orientation_tolerance, and what the lag leaves over.
POSITION_M, TURN_RAD = 0.012, 0.02

# Two clients of a test drive at once: one knows goal topics, the other actions.
SETTINGS = {"ARMBRIDGE_ACCESS__CONTROL": "shared"}

GROUP_TOPIC = "/moveit_goal_group"


@pytest.fixture(scope="module")
def lifted_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    arguments = folder_arguments(tmp_path_factory.mktemp("lifted"), LIFTED_URDF, LIFTED_SRDF, LIFTED_GRIPPER)
    with RunningServer(f"--port 0 {arguments}", SETTINGS) as running:
        yield running


@pytest.fixture(scope="module")
def pair_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    arguments = folder_arguments(tmp_path_factory.mktemp("pair"), PAIR_URDF, PAIR_SRDF)
    with RunningServer(f"--port 0 {arguments}", SETTINGS) as running:
        yield running


@pytest.fixture
async def lifted(lifted_server: RunningServer) -> AsyncIterator[FrameClient]:
    async with frame_client(lifted_server.url) as client:
        await opened(client)
        await select(client, "arm")
        yield client


@pytest.fixture
async def pair(pair_server: RunningServer) -> AsyncIterator[FrameClient]:
    async with frame_client(pair_server.url) as client:
        await opened(client)
        for side in ("left", "right"):
            await joints_goal(client, {f"{side}_{name}": 0.0 for name in BENT})
        yield client


async def opened(client: FrameClient) -> None:
    await client.open_goals()
    await client.subscribe("/joint_states", "sensor_msgs/JointState")
    await client.subscribe(GROUP_TOPIC, "std_msgs/String")
    await client.send({"op": "advertise", "topic": GROUP_TOPIC, "type": "std_msgs/String"})


async def select(client: FrameClient, group: str) -> None:
    await client.publish(GROUP_TOPIC, {"data": group})
    await client.until(GROUP_TOPIC, lambda told: told[-1]["data"] == group)


def joint_message(joints: dict[str, float]) -> dict[str, Any]:
    return {"name": list(joints), "position": list(joints.values())}


async def joints_goal(client: FrameClient, joints: dict[str, float]) -> dict[str, float]:
    """Send a goal of joints; returns where they are when it is reached."""
    result = await client.reach("/moveit_goal_joints", joint_message(joints))
    assert result["val"] == 1, result
    return await client.positions()


def pose_message(transform: Any) -> dict[str, Any]:
    """The geometry_msgs/PoseStamped of a transform in the column's root link."""
    return {"header": {"frame_id": "base"}, "pose": write_pose(pose_of(transform))}


def turn_rad(first: Any, second: Any) -> float:
    return math.acos(float(np.clip((np.trace(first[:3, :3].T @ second[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)))


async def test_a_named_goal_moves_the_selected_group(lifted: FrameClient) -> None:
    await select(lifted, "arm_with_torso")
    assert (await lifted.reach("/moveit_goal_named", {"data": "raised"}))["val"] == 1
    assert await lifted.positions() | {"lift": 0.2, **BENT} == pytest.approx(await lifted.positions(), abs=ARRIVED)
    await select(lifted, "arm")
    result = await lifted.reach("/moveit_goal_named", {"data": "raised"})
    assert "there is no named target 'raised'" in result["message"]


async def test_goals_of_joints_choose_their_group(lifted: FrameClient) -> None:
    joints = await joints_goal(lifted, {"lift": 0.05, "a1": 0.3})
    assert (joints["lift"], joints["a1"]) == pytest.approx((0.05, 0.3), abs=ARRIVED)
    joints = await joints_goal(lifted, {"left_finger_joint": 0.03, "right_finger_joint": 0.03})
    assert joints["left_finger_joint"] == pytest.approx(0.03, abs=ARRIVED)


@pytest.mark.parametrize("group", ["arm", "arm_with_torso"])
async def test_a_pose_goal_is_met_with_its_orientation(lifted: FrameClient, group: str) -> None:
    await select(lifted, group)
    at = await joints_goal(lifted, BENT)
    wanted = ForwardPlacements(LIFTED).transforms({**at, "a1": 0.4, "a2": 0.7, "a5": 0.5, "a6": 0.6})["tool"]
    result = await lifted.reach("/moveit_goal_pose", pose_message(wanted))
    assert result["val"] == 1, result
    reached = ForwardPlacements(LIFTED).transforms(await lifted.positions())["tool"]
    np.testing.assert_allclose(reached[:3, 3], wanted[:3, 3], atol=POSITION_M)
    assert turn_rad(reached, wanted) < TURN_RAD


def moving(client: FrameClient, joint: str) -> list[float]:
    """Times at which a joint was seen to move [s]."""
    states = client.messages("/joint_states")
    at = [(one["_at_s"], one["position"][one["name"].index(joint)]) for one in states]
    return [later for (_, before), (later, after) in itertools.pairwise(at) if abs(after - before) > 0.002]


async def results(client: FrameClient, seen: int, count: int) -> list[dict[str, Any]]:
    all_ = await client.until("/moveit_goal_result", lambda told: len(told) >= seen + count)
    return all_[seen:]


async def test_two_arms_move_at_the_same_time(pair: FrameClient) -> None:
    seen, states = len(pair.messages("/moveit_goal_result")), len(pair.messages("/joint_states"))
    await pair.publish("/moveit_goal_joints", joint_message({"left_a1": 1.2, "left_a2": 0.4}))
    await pair.publish("/moveit_goal_joints", joint_message({"right_a1": -1.2, "right_a2": 0.4}))
    assert [result["val"] for result in await results(pair, seen, 2)] == [1, 1]
    pair.topics["/joint_states"] = pair.messages("/joint_states")[states:]
    left, right = moving(pair, "left_a1"), moving(pair, "right_a1")
    together_s = min(left[-1], right[-1]) - max(left[0], right[0])
    assert together_s > 0.5 * (left[-1] - left[0])


async def test_a_goal_of_both_arms_moves_both(pair: FrameClient) -> None:
    joints = await joints_goal(pair, {"left_a1": 0.3, "right_a1": -0.3})
    assert (joints["left_a1"], joints["right_a1"]) == pytest.approx((0.3, -0.3), abs=ARRIVED)

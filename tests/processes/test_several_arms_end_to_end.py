"""Two arms in one server, each on its emulated bus: by name, together, past each other, and with a fault in one."""

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator
from typing import Any

import pytest

from harness.clients import ArmClient, arm_client, values_of
from harness.server import RunningServer
from harness.waiting import TIMEOUT_S
from tests.helpers.programs import run
from tests.helpers.robots import so101

RESULT = "/moveit_goal_result"
JOINTS = tuple(joint.name for joint in so101().movable_joints)
SUCCESS, INVALID_GROUP, CONTROL_FAILED = 1, -15, -4

# The tips meet between the arms when both reach forward and turn towards each other.
CONFIG = """
[server]
port = 0
[moveit]
max_velocity_scaling = 1.0
max_acceleration_scaling = 1.0
[arms.left]
on_exit = "park"
base_xyz_m = [0.0, 0.25, 0.0]
[arms.right]
on_exit = "park"
base_xyz_m = [0.0, -0.25, 0.0]
"""


@pytest.fixture
async def client(server: RunningServer) -> AsyncIterator[ArmClient]:
    async with arm_client(server.url) as one:
        for arm in ("left", "right"):
            await one.subscribe(f"/{arm}{RESULT}", "moveit_msgs/MoveItErrorCodes")
            await one.subscribe(f"/{arm}/arm/state", "diagnostic_msgs/DiagnosticStatus")
        yield one
        if server.process.poll() is None:
            assert (await one.call("/arm/stop"))["success"]
            await one.call("/arm/release_control")


async def moved(client: ArmClient, arm: str, topic: str, type_name: str, msg: dict[str, Any]) -> dict[str, Any]:
    """Send a goal to an arm by its name; returns the result."""
    heard = len(client.messages(f"/{arm}{RESULT}"))
    await client.goal(f"/{arm}{topic}", type_name, msg)
    return (await client.until(f"/{arm}{RESULT}", lambda results: len(results) > heard))[-1]


async def to_named(client: ArmClient, arm: str, name: str) -> dict[str, Any]:
    return await moved(client, arm, "/moveit_goal_named", "std_msgs/String", {"data": name})


async def to_joints(client: ArmClient, arm: str, **positions: float) -> dict[str, Any]:
    msg = {"name": list(positions), "position": list(positions.values())}
    return await moved(client, arm, "/moveit_goal_joints", "sensor_msgs/JointState", msg)


async def both_go(client: ArmClient, name: str) -> dict[str, Any]:
    """Send a goal to the group of both arms; returns its answer."""
    return await client.call("/moveit_goal", group="both_arms", named=name)


async def until_mode(client: ArmClient, mode: str, *arms: str) -> str:
    """Wait until arms are in a mode; returns the sentence of the last."""
    for arm in arms:
        states = await client.until(f"{arm}/arm/state", lambda states: values_of(states[-1])["mode"] == mode)
    return str(states[-1]["message"])


async def test_joint_states_have_all_joints_in_one_message_and_each_arm_its_own(client: ArmClient) -> None:
    assert set(await client.positions()) == {f"{arm}_{joint}" for arm in ("left", "right") for joint in JOINTS}
    await client.subscribe("/left/joint_states", "sensor_msgs/JointState")
    assert (await client.until("/left/joint_states", bool))[-1]["name"] == [f"left_{joint}" for joint in JOINTS]


async def test_an_arm_is_moved_by_its_name_and_the_other_stays(client: ArmClient) -> None:
    before = await client.positions()
    assert (await to_named(client, "left", "ready"))["val"] == SUCCESS
    assert (await to_joints(client, "left", elbow_flex=0.3))["val"] == SUCCESS
    after = await client.positions()
    assert (after["left_elbow_flex"], after["left_shoulder_lift"]) == pytest.approx((0.3, -0.5), abs=0.06)
    assert all(after[f"right_{joint}"] == pytest.approx(before[f"right_{joint}"], abs=0.02) for joint in JOINTS)
    result = await to_joints(client, "left", right_shoulder_pan=0.2)
    assert (result["val"], result["message"]) == (INVALID_GROUP, "group right_arm moves other arms than left")


async def test_both_arms_move_together_as_one_group(client: ArmClient) -> None:
    answer = await both_go(client, "rest")
    assert (answer["code_name"], answer["message"]) == ("SUCCESS", "the arm is there")
    rest = so101().named_states["arm"]["rest"]
    now = await client.positions()
    for arm in ("left", "right"):
        assert all(now[f"{arm}_{joint}"] == pytest.approx(value, abs=0.06) for joint, value in rest.items())


async def test_a_motion_of_both_arms_is_refused_by_the_name_of_the_relaxed_one(client: ArmClient) -> None:
    assert (await client.call("/right/arm/relax"))["success"]
    answer = await both_go(client, "home")
    sentence = "the arm right is relaxed: enable it by the service /right/arm/enable first"
    assert (answer["code_name"], answer["message"]) == ("CONTROL_FAILED", sentence)
    relaxed = "the arm is relaxed; {}/arm/enable makes it hold"
    assert await until_mode(client, "relaxed", "/right") == relaxed.format("/right")
    assert await until_mode(client, "relaxed", "") == relaxed.format("") + ": right: relaxed"
    # The other arm moves, and is paused, meanwhile.
    await client.goal("/arm/speed_factor", "std_msgs/Float64", {"data": 0.1})
    left = asyncio.create_task(to_joints(client, "left", wrist_roll=0.7))
    await until_mode(client, "moving", "/left")
    paused = await client.call("/left/arm/pause")
    assert paused["message"] == "the arm comes to rest on its path; /left/arm/resume lets it go on"
    assert (await client.call("/arm/resume"))["success"]
    await client.goal("/arm/speed_factor", "std_msgs/Float64", {"data": 1.0})
    assert (await left)["val"] == SUCCESS
    assert (await client.call("/right/arm/enable"))["success"]


async def test_all_arms_are_parked_one_after_the_other(client: ArmClient) -> None:
    await both_go(client, "home")
    there = "the arm is at its rest pose 'rest', and relaxed"
    assert await client.call("/arm/park") == {"success": True, "message": f"left: {there}; right: {there}"}
    assert (await client.call("/arm/enable"))["success"]


async def test_a_stop_of_one_arm_lets_the_other_go_on(client: ArmClient) -> None:
    await both_go(client, "home")
    await until_mode(client, "holding", "/left", "/right")
    await client.goal("/arm/speed_factor", "std_msgs/Float64", {"data": 0.1})
    left = asyncio.create_task(to_joints(client, "left", wrist_roll=-1.5))
    right = asyncio.create_task(to_joints(client, "right", wrist_roll=-0.8))
    await until_mode(client, "moving", "/left", "/right")
    assert (await client.call("/left/arm/stop"))["success"]
    assert (await left)["message"].startswith("stopped by /left/arm/stop")
    await client.goal("/arm/speed_factor", "std_msgs/Float64", {"data": 1.0})
    assert (await right)["val"] == SUCCESS


async def test_a_fault_of_one_arm_is_named_and_the_other_moves_on(client: ArmClient) -> None:
    assert (await client.call("/left/arm/emergency_stop"))["success"]
    await until_mode(client, "fault", "/left")
    assert (await to_named(client, "left", "ready"))["val"] == CONTROL_FAILED
    assert (await to_named(client, "right", "ready"))["val"] == SUCCESS
    assert (await client.call("/left/arm/reset_fault"))["success"]
    assert (await client.call("/left/arm/enable"))["success"]
    assert (await to_named(client, "left", "ready"))["val"] == SUCCESS


async def test_an_emergency_stop_means_all_arms(client: ArmClient) -> None:
    await client.goal("/emergency_stop", "std_msgs/Empty", {})
    await until_mode(client, "fault", "/left", "/right")
    # Each arm first sees that its torque is off.
    async with asyncio.timeout(TIMEOUT_S):
        while not (await client.call("/arm/reset_fault"))["success"]:
            await asyncio.sleep(0.05)
    assert (await client.call("/arm/enable"))["success"]
    await until_mode(client, "holding", "/left", "/right")


async def test_an_arm_process_that_dies_leaves_the_other_arm_moving(server: RunningServer, client: ArmClient) -> None:
    for name in ("left", "right"):
        assert any(f" armbridge.arm: {name}: the simulated arm is ready" in line for line in server.lines), server.lines
    ready = next(line for line in server.lines if "armbridge is ready" in line)
    os.kill(int(ready.split("left arm simulated (process ")[1].split(",")[0]), signal.SIGKILL)
    await until_mode(client, "disconnected", "/left")
    assert (await to_joints(client, "right", wrist_roll=0.5))["val"] == SUCCESS
    await until_mode(client, "holding", "/left")
    assert (await to_joints(client, "left", wrist_roll=0.5))["val"] == SUCCESS


def test_one_of_several_arms_is_verified_at_a_terminal(server: RunningServer) -> None:
    named = run(sys.executable, "-m", "server.cli", "verify", "--url", server.url, "--arm", "left", input="")
    assert "Move? Enter: move." in named.stderr


async def test_arms_that_are_parked_at_the_end_go_to_rest_one_after_the_other(
    server: RunningServer, client: ArmClient
) -> None:
    for arm in ("left", "right"):
        assert (await to_named(client, arm, "ready"))["val"] == SUCCESS
    code, _ = await asyncio.to_thread(server.end, signal.SIGTERM)
    assert code == 0
    parking = [line.split("armbridge.arm: ")[1].split(", in ")[0] for line in server.lines if ": parking: " in line]
    parked = ("moves to its rest pose", "is at its rest pose, and is relaxed")
    assert parking == [f"{arm}: parking: the arm {does}" for arm in ("left", "right") for does in parked], server.lines

"""The world of a running server with physics, over a real socket: pause, steps, placed and dropped objects."""

import asyncio
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator

import pytest

from harness.clients import ArmClient, FrameClient, arm_client, goal_is
from harness.server import ROOT, RunningServer
from harness.waiting import TIMEOUT_S

COLORS = [f"cube_{color}" for color in ("red", "green", "blue", "yellow")]
STANDS_STILL = "the arm does not move: its time stands still, and it brakes when time passes"
CUBE = {"id": "cube", "primitives": [{"type": 1, "dimensions": [0.03, 0.03, 0.03]}], "pose": {"position": {"x": 0.3}}}


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with RunningServer("--port 0 --simulation physics --world cubes") as running:
        yield running


@pytest.fixture
async def caller(server: RunningServer) -> AsyncIterator[ArmClient]:
    async with arm_client(server.url) as connected:
        yield connected
        await connected.call("/simulation/pause", data=False)


async def heights(caller: ArmClient) -> dict[str, float]:
    scene = (await caller.call("/get_planning_scene", components={"components": 16}))["scene"]
    return {each["id"]: each["pose"]["position"]["z"] for each in scene["world"]["collision_objects"]}


async def test_a_goal_of_a_paused_arm_waits_and_its_client_may_leave_meanwhile(
    server: RunningServer, client: FrameClient, caller: ArmClient
) -> None:
    async with arm_client(server.url) as leaving:
        assert (await leaving.call("/simulation/pause", data=True))["success"]
    before = await client.positions()
    await client.publish("/moveit_goal_named", {"data": "extended"})
    await client.until("/moveit_goal_status", goal_is("executing"))
    assert await client.positions() == before
    for _ in range(3):
        assert (await caller.call("/simulation/step", steps=20))["message"] == "20 of 20 steps are done"
    assert await client.positions() != before
    assert client.messages("/moveit_goal_result") == []
    await caller.call("/simulation/pause", data=False)
    results = await client.until("/moveit_goal_result", lambda all_: len(all_) > 0)
    assert results[0]["val"] == 1


async def test_a_stop_of_a_paused_arm_ends_its_goal_as_soon_as_time_passes(
    client: FrameClient, caller: ArmClient
) -> None:
    await client.publish("/moveit_goal_named", {"data": "rest"})
    await client.until("/moveit_goal_status", goal_is("executing"))
    await caller.call("/simulation/pause", data=True)
    await client.send({"op": "advertise", "topic": "/trajectory_execution_event", "type": "std_msgs/String"})
    await client.publish("/trajectory_execution_event", {"data": "stop"})
    # The answer to a later message of this client shows that the stop has come.
    await client.positions()
    await caller.call("/simulation/step", steps=100)
    results = await client.until("/moveit_goal_result", lambda all_: len(all_) > 0)
    assert results[0]["val"] == -7


async def test_a_stop_of_a_paused_arm_is_answered_while_time_stands_still(
    client: FrameClient, caller: ArmClient
) -> None:
    await client.publish("/moveit_goal_named", {"data": "home"})
    await client.until("/moveit_goal_status", goal_is("executing"))
    await caller.call("/simulation/pause", data=True)
    before = await client.positions()
    answer = await caller.call("/arm/stop")
    assert answer["success"]
    assert answer["message"] == STANDS_STILL
    assert await client.positions() == before
    await caller.call("/simulation/pause", data=False)
    results = await client.until("/moveit_goal_result", lambda all_: len(all_) > 0)
    assert results[0]["val"] == -7
    assert (await caller.call("/arm/stop"))["message"] == "the arm does not move"


async def test_a_pause_by_another_client_cuts_no_steps_short(server: RunningServer, caller: ArmClient) -> None:
    await caller.call("/simulation/pause", data=True)
    async with arm_client(server.url) as other:
        steps = asyncio.create_task(caller.call("/simulation/step", steps=300))
        await caller.until("/joint_states", bool)
        assert (await other.call("/simulation/pause", data=True))["success"]
        assert (await steps)["message"] == "300 of 300 steps are done"


async def test_an_emergency_stop_of_a_paused_arm_is_answered(caller: ArmClient) -> None:
    await caller.call("/simulation/pause", data=True)
    stopped = await caller.call("/arm/emergency_stop")
    assert (stopped["success"], stopped["message"]) == (True, "torque is off at every servo")
    await caller.call("/simulation/pause", data=False)
    assert (await caller.call("/arm/reset_fault"))["success"]
    assert (await caller.call("/arm/enable"))["success"]


async def test_an_object_is_put_falls_step_by_step_and_comes_back(caller: ArmClient) -> None:
    scene = {"is_diff": True, "world": {"collision_objects": [CUBE]}}
    assert (await caller.call("/apply_planning_scene", scene=scene))["success"]
    assert (await caller.call("/simulation/set_body", id="cube", movable=True))["success"]
    await caller.call("/simulation/pause", data=True)
    high = {"position": {"x": 0.3, "z": 0.5}, "orientation": {"w": 1.0}}
    assert (await caller.call("/simulation/set_pose", id="cube", pose=high))["success"]
    assert (await heights(caller))["cube"] == 0.5
    await caller.call("/simulation/step", steps=20)
    assert (await heights(caller))["cube"] == pytest.approx(0.5 - 0.5 * 9.81 * 0.2**2, abs=0.01)
    await caller.call("/simulation/reset")
    assert await heights(caller) == dict.fromkeys(COLORS, 0.016)


def test_a_block_is_picked_and_placed_faster_than_time_without_a_server() -> None:
    command = [sys.executable, "-m", "benchmarks.pick_and_place", "--count", "1", "--friction", "0.8"]
    printed = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=True, cwd=ROOT).stdout
    assert printed.startswith("friction 0.8, seed 1: 1 of 1 blocks picked and placed\n")


def test_the_ready_line_names_the_physics_and_the_world(server: RunningServer) -> None:
    (ready,) = [line for line in server.lines if "armbridge is ready" in line]
    assert "so101 arm simulated (physics, world cubes) (process " in ready


async def test_two_arms_have_a_world_each_and_their_time_stands_still_together() -> None:
    with RunningServer("--port 0 --config examples/two_arms.toml --simulation physics") as two:
        async with arm_client(two.url) as caller:
            cube = CUBE | {"pose": {"position": {"y": -0.5}}}
            scene = {"is_diff": True, "world": {"collision_objects": [cube]}}
            assert (await caller.call("/apply_planning_scene", scene=scene))["success"]
            assert (await caller.call("/simulation/pause", data=True))["success"]
            assert (await caller.call("/right/simulation/set_body", id="cube", movable=True))["success"]
            high = {"position": {"y": -0.5, "z": 0.5}, "orientation": {"w": 1.0}}
            assert (await caller.call("/simulation/set_pose", id="cube", pose=high))["success"]
            assert (await caller.call("/simulation/step", steps=20))["message"] == "20 of 20 steps are done"
            assert (await heights(caller))["cube"] == pytest.approx(0.5 - 0.5 * 9.81 * 0.2**2, abs=0.01)
            # A stop of all arms is answered while the time of the one with a goal stands still.
            await caller.subscribe("/left/moveit_goal_status", "diagnostic_msgs/DiagnosticStatus")
            await caller.goal("/left/moveit_goal_named", "std_msgs/String", {"data": "rest"})
            await caller.until("/left/moveit_goal_status", goal_is("executing"))
            assert (await caller.call("/arm/stop"))["message"] == STANDS_STILL

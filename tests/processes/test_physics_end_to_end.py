"""The world of a running server with physics, over a real socket: pause, steps, placed and dropped objects."""

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from harness.clients import ArmClient, FrameClient, arm_client, goal_is
from harness.server import RunningServer

ARGUMENTS = "--port 0 --simulation physics --world cubes"

COLORS = [f"cube_{color}" for color in ("red", "green", "blue", "yellow")]
STANDS_STILL = "the arm does not move: its time stands still, and it brakes when time passes"
STATUS, RESULT, EVENTS = "/moveit_goal_status", "/moveit_goal_result", "/trajectory_execution_event"
FALLEN_M = 0.5 - 0.5 * 9.81 * 0.2**2


@pytest.fixture
async def caller(server: RunningServer) -> AsyncIterator[ArmClient]:
    async with arm_client(server.url) as connected:
        yield connected
        await connected.call("/simulation/pause", data=False)


async def on_its_way(client: FrameClient, caller: ArmClient, name: str) -> None:
    """Begin a goal while time stands still, so that it is not over before the test goes on, and let some time pass."""
    assert (await caller.call("/simulation/pause", data=True))["success"]
    await client.publish("/moveit_goal_named", {"data": name})
    await client.until(STATUS, goal_is("executing"))
    assert (await caller.call("/simulation/step", steps=20))["message"] == "20 of 20 steps are done"


async def result(client: FrameClient) -> int:
    return int((await client.until(RESULT, bool))[0]["val"])


async def heights(caller: ArmClient) -> dict[str, float]:
    scene = (await caller.call("/get_planning_scene", components={"components": 16}))["scene"]
    return {each["id"]: each["pose"]["position"]["z"] for each in scene["world"]["collision_objects"]}


async def drop_a_cube(caller: ArmClient, x: float, y: float, of_arm: str = "") -> None:
    """Put a cube half a metre above the floor while time stands still, and let a fifth of a second pass."""
    cube = {"id": "cube", "primitives": [{"type": 1, "dimensions": [0.03] * 3}], "pose": {"position": {"x": x, "y": y}}}
    await caller.change_scene(cube)
    assert (await caller.call(f"{of_arm}/simulation/set_body", id="cube", movable=True))["success"]
    assert (await caller.call("/simulation/pause", data=True))["success"]
    high: dict[str, Any] = {"position": {"x": x, "y": y, "z": 0.5}, "orientation": {"w": 1.0}}
    assert (await caller.call("/simulation/set_pose", id="cube", pose=high))["success"]
    assert (await heights(caller))["cube"] == 0.5
    assert (await caller.call("/simulation/step", steps=20))["message"] == "20 of 20 steps are done"
    assert (await heights(caller))["cube"] == pytest.approx(FALLEN_M, abs=0.01)


async def test_a_goal_of_a_paused_arm_waits_and_its_client_may_leave_meanwhile(
    server: RunningServer, client: FrameClient, caller: ArmClient
) -> None:
    async with arm_client(server.url) as leaving:
        assert (await leaving.call("/simulation/pause", data=True))["success"]
    before = await client.positions()
    await client.publish("/moveit_goal_named", {"data": "extended"})
    await client.until(STATUS, goal_is("executing"))
    assert await client.positions() == before
    assert (await caller.call("/simulation/step", steps=60))["message"] == "60 of 60 steps are done"
    assert await client.positions() != before
    assert client.messages(RESULT) == []
    await caller.call("/simulation/pause", data=False)
    assert await result(client) == 1


async def test_a_stop_of_a_paused_arm_ends_its_goal_as_soon_as_time_passes(
    client: FrameClient, caller: ArmClient
) -> None:
    await on_its_way(client, caller, "rest")
    await client.send({"op": "advertise", "topic": EVENTS, "type": "std_msgs/String"})
    await client.publish(EVENTS, {"data": "stop"})
    # The answer to a later message of this client shows that the stop has come.
    await client.positions()
    await caller.call("/simulation/step", steps=100)
    assert await result(client) == -7


async def test_a_stop_of_a_paused_arm_is_answered_while_time_stands_still(
    client: FrameClient, caller: ArmClient
) -> None:
    await on_its_way(client, caller, "home")
    before = await client.positions()
    assert await caller.call("/arm/stop") == {"success": True, "message": STANDS_STILL}
    assert await client.positions() == before
    await caller.call("/simulation/pause", data=False)
    assert await result(client) == -7
    assert (await caller.call("/arm/stop"))["message"] == "the arm does not move"


async def test_an_emergency_stop_of_a_paused_arm_is_answered(caller: ArmClient) -> None:
    await caller.call("/simulation/pause", data=True)
    stopped = await caller.call("/arm/emergency_stop")
    assert stopped == {"success": True, "message": "torque is off at every servo"}
    await caller.call("/simulation/pause", data=False)
    assert (await caller.call("/arm/reset_fault"))["success"]
    assert (await caller.call("/arm/enable"))["success"]


async def test_a_pause_by_another_client_cuts_no_steps_short(server: RunningServer, caller: ArmClient) -> None:
    await caller.call("/simulation/pause", data=True)
    async with arm_client(server.url) as other:
        steps = asyncio.create_task(caller.call("/simulation/step", steps=300))
        await caller.until("/joint_states", bool)
        assert (await other.call("/simulation/pause", data=True))["success"]
        assert (await steps)["message"] == "300 of 300 steps are done"


async def test_an_object_is_put_falls_step_by_step_and_comes_back(server: RunningServer, caller: ArmClient) -> None:
    await drop_a_cube(caller, 0.3, 0.0)
    await caller.call("/simulation/reset")
    assert await heights(caller) == dict.fromkeys(COLORS, 0.016)
    assert server.has_logged("so101 arm simulated (physics, world cubes) (process ")


async def test_two_arms_have_a_world_each_and_their_time_stands_still_together() -> None:
    with RunningServer("--port 0 --config examples/two_arms.toml --simulation physics") as two:
        async with arm_client(two.url) as caller:
            await drop_a_cube(caller, 0.0, -0.5, "/right")
            # A stop of all arms is answered while the time of the one with a goal stands still.
            await caller.subscribe("/left/moveit_goal_status", "diagnostic_msgs/DiagnosticStatus")
            await caller.goal("/left/moveit_goal_named", "std_msgs/String", {"data": "rest"})
            await caller.until("/left/moveit_goal_status", goal_is("executing"))
            assert (await caller.call("/arm/stop"))["message"] == STANDS_STILL

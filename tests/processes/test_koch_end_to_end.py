"""A simulated Koch v1.1: its emulated Dynamixel servos are driven by goals over a real socket."""

from collections.abc import AsyncIterator, Iterator

import pytest

from harness.clients import FrameClient, arm_client, frame_client
from harness.server import RunningServer
from tests.helpers.dynamixel import KOCH

# Droop under the links' weight, and backlash of the goal's ticks [rad].
ARRIVED = 0.03


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with RunningServer("--port 0 --robot koch_v1_1") as running:
        yield running


@pytest.fixture
async def client(server: RunningServer) -> AsyncIterator[FrameClient]:
    async with frame_client(server.url) as connected:
        await connected.open_goals()
        await connected.subscribe("/joint_states", "sensor_msgs/JointState")
        yield connected


@pytest.mark.parametrize("name", ["ready", "rest", "extended", "home"])
async def test_the_arm_goes_to_each_of_its_named_states(client: FrameClient, name: str) -> None:
    result = await client.reach("/moveit_goal_named", {"data": name})
    assert (result["val"], result["message"]) == (1, "the arm is there")
    at = await client.positions()
    wanted = KOCH.model.named_states["arm"][name]
    assert {joint: at[joint] for joint in wanted} == pytest.approx(wanted, abs=ARRIVED)


@pytest.mark.parametrize("name", ["open", "closed"])
async def test_the_gripper_goes_to_its_named_states(server: RunningServer, client: FrameClient, name: str) -> None:
    wanted = KOCH.model.named_states["gripper"][name]["gripper"]
    async with arm_client(server.url) as connected:
        command = {"command": {"position": wanted, "max_effort": 0.0}}
        goal_id = await connected.send_goal(
            "/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand", command
        )
        result = await connected.result(goal_id)
    assert result["result"], result
    assert (await client.positions())["gripper"] == pytest.approx(wanted, abs=ARRIVED)

"""The SO-101 with physics behind the real server."""

from collections.abc import AsyncIterator, Iterator

import pytest

from harness.clients import FrameClient, frame_client
from harness.server import RunningServer
from tests.helpers.robots import so101

# Droop under the links' weight, and backlash of the goal's ticks [rad].
ARRIVED = 0.03


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with RunningServer("--port 0 --simulation physics") as running:
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
    wanted = so101().named_states["arm"][name]
    assert {joint: at[joint] for joint in wanted} == pytest.approx(wanted, abs=ARRIVED)

"""Simulated arms other than the usual one are driven by goals over a real socket.

The servos of the Koch v1.1 are Dynamixel's; the links of the SO-101 with physics move by MuJoCo.
"""

from collections.abc import Iterator

import pytest

from harness.clients import FrameClient, arm_client
from harness.server import RunningServer
from robot.description.model import RobotModel
from tests.helpers.dynamixel import KOCH
from tests.helpers.robots import so101

ARMS = {"--robot koch_v1_1": KOCH.model, "--simulation physics": so101()}

# Droop under the links' weight, and backlash of the goal's ticks [rad].
ARRIVED = 0.03


@pytest.fixture(scope="module", params=ARMS)
def option(request: pytest.FixtureRequest) -> str:
    option: str = request.param
    return option


@pytest.fixture(scope="module")
def server(option: str) -> Iterator[RunningServer]:
    with RunningServer(f"--port 0 {option}") as running:
        yield running


@pytest.fixture
def robot(option: str) -> RobotModel:
    return ARMS[option]


@pytest.mark.parametrize("name", ["ready", "rest", "extended", "home"])
async def test_the_arm_goes_to_each_of_its_named_states(client: FrameClient, robot: RobotModel, name: str) -> None:
    result = await client.reach("/moveit_goal_named", {"data": name})
    assert (result["val"], result["message"]) == (1, "the arm is there")
    at = await client.positions()
    wanted = robot.named_states["arm"][name]
    assert {joint: at[joint] for joint in wanted} == pytest.approx(wanted, abs=ARRIVED)


@pytest.mark.parametrize("name", ["open", "closed"])
async def test_the_gripper_goes_to_its_named_states(
    server: RunningServer, client: FrameClient, robot: RobotModel, name: str
) -> None:
    wanted = robot.named_states["gripper"][name]["gripper"]
    async with arm_client(server.url) as connected:
        command = {"command": {"position": wanted, "max_effort": 0.0}}
        goal_id = await connected.send_goal(
            "/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand", command
        )
        result = await connected.result(goal_id)
    assert result["result"], result
    assert (await client.positions())["gripper"] == pytest.approx(wanted, abs=ARRIVED)

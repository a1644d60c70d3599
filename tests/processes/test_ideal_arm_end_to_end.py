"""An arm of anybody's, by its URDF and SRDF alone: served, told of, and moved over a real socket."""

from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

from harness.clients import FrameClient, arm_client, frame_client, values_of
from harness.server import RunningServer
from robot.description import model
from robot.description.model import RobotModel
from tests.helpers.robots import SEVEN_JOINT_SRDF, SEVEN_JOINT_URDF

# The last joint moves the hand along its axis instead of about it.
TURNS = '<axis xyz="0 0 1"/><limit lower="-2.9" upper="2.9" velocity="4" effort="9"/>'
SLIDES = '<axis xyz="0 0 1"/><limit lower="-0.02" upper="0.2" velocity="0.3" effort="9"/>'
SLIDING = SEVEN_JOINT_URDF.replace('name="a7" type="revolute"', 'name="a7" type="prismatic"').replace(TURNS, SLIDES)

# What the lag of an ideal joint leaves over [rad, m].
ARRIVED = 0.005


@pytest.fixture(scope="module", params=[SEVEN_JOINT_URDF, SLIDING], ids=["seven joints turn", "the last one slides"])
def described(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The files of the robot's description."""
    folder = tmp_path_factory.mktemp("robot")
    for name, text in (("arm.urdf", request.param), ("arm.srdf", SEVEN_JOINT_SRDF)):
        (folder / name).write_text(text)
    return [folder / "arm.urdf", folder / "arm.srdf"]


@pytest.fixture(scope="module")
def server(described: list[Path]) -> Iterator[RunningServer]:
    urdf, srdf = described
    with RunningServer(f"--port 0 --urdf {urdf} --srdf {srdf}") as running:
        yield running


@pytest.fixture
def robot(described: list[Path]) -> RobotModel:
    return model.load(*described)


@pytest.fixture
async def client(server: RunningServer) -> AsyncIterator[FrameClient]:
    async with frame_client(server.url) as connected:
        await connected.open_goals()
        await connected.subscribe("/joint_states", "sensor_msgs/JointState")
        yield connected


async def arrive(client: FrameClient, topic: str, msg: dict[str, Any]) -> dict[str, float]:
    """Send a goal; returns where the joints are when it is reached."""
    result = await client.reach(topic, msg)
    assert (result["val"], result["message"]) == (1, "the arm is there")
    return await client.positions()


async def test_a_named_goal_is_reached(client: FrameClient, robot: RobotModel) -> None:
    joints = await arrive(client, "/moveit_goal_named", {"data": "bent"})
    assert joints == pytest.approx(dict(robot.named_states["arm"]["bent"]), abs=ARRIVED)


async def test_its_joints_have_no_servos_to_tell_of(client: FrameClient) -> None:
    await client.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    arrays = await client.until("/diagnostics", lambda all_: len(all_[-1]["status"]) > 1)
    arm, *joints = arrays[-1]["status"]
    assert [joint["name"] for joint in joints] == [f"arm: a{number}" for number in range(1, 8)]
    assert (values_of(arm)["port"], {joint["hardware_id"] for joint in joints}) == ("ideal", {"ideal joint"})
    assert "temperature_c" not in values_of(joints[0])


async def test_it_can_be_stopped_in_an_emergency_and_goes_on(server: RunningServer) -> None:
    async with arm_client(server.url) as client:
        await client.goal("/moveit_goal_named", "std_msgs/String", {"data": "bent"})
        assert (await client.call("/arm/emergency_stop"))["success"]
        assert values_of(await client.until_mode("fault"))["fault"] == "emergency_stop"
        for service in ("/arm/reset_fault", "/arm/enable"):
            answer = await client.call(service)
            assert answer["success"], answer
        await client.until_mode("holding")

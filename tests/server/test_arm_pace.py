from __future__ import annotations

from typing import Any

import pytest

from protocol.errors import MessageError
from protocol.registry import Registry
from robot.arm import Arm
from robot.calibration import Calibration
from robot.description import model
from robot.hardware.config import EmulatedConfig
from robot.messages import ArmConfig, ArmState, ChangePace, Mode
from server.arm_pace import PAUSE, RESUME, SPEED_FACTOR_TOPIC, STEP_BACK, ArmPace
from server.graph_topics import Graph
from server.node import Node
from tests.helpers.arm_server import ArmClient, values_of

CLIENT = Node("client")
GOAL = ("/moveit_goal_joints", "sensor_msgs/JointState")


class ListeningArm(Arm):
    """Notes what it is told, and is in the mode a test says."""

    def __init__(self) -> None:
        super().__init__(ArmConfig(model.builtin(), EmulatedConfig(Calibration.nominal())), lambda _state: None)
        self.changes: list[ChangePace] = []
        self.be(Mode.HOLDING)

    def be(self, mode: Mode) -> None:
        self.state = ArmState(0.0, mode, ())

    def change_pace(self, change: ChangePace) -> None:
        self.changes.append(change)


class Desk:
    def __init__(self) -> None:
        self.graph = Graph(Registry.load())
        self.arm = ListeningArm()
        ArmPace(self.graph).open(self.arm)

    def call(self, service: str) -> Any:
        answers: list[Any] = []
        self.graph.services.call(CLIENT, service, {}, answers.append)
        return answers[0].values


@pytest.fixture
async def desk() -> Desk:
    return Desk()


@pytest.mark.parametrize("service", [PAUSE, RESUME, STEP_BACK])
async def test_without_a_motion_there_is_nothing_to_pause(desk: Desk, service: str) -> None:
    answer = desk.call(service)
    assert not answer["success"]
    assert "holding" in answer["message"]
    assert desk.arm.changes == []


@pytest.mark.parametrize("factor", [0.0, 0.25, 1.0])
async def test_a_speed_factor_is_passed_on(desk: Desk, factor: float) -> None:
    desk.graph.publish(CLIENT, SPEED_FACTOR_TOPIC, {"data": factor})
    assert desk.arm.changes == [ChangePace(speed_factor=factor)]


@pytest.mark.parametrize("factor", [-0.1, 1.5, float("nan")])
async def test_a_factor_that_is_no_share_is_refused_with_the_limits(
    desk: Desk, factor: float, caplog: pytest.LogCaptureFixture
) -> None:
    desk.graph.publish(CLIENT, SPEED_FACTOR_TOPIC, {"data": factor})
    assert desk.arm.changes == []
    assert f"must be 0 to 1, a share of the planned speed, not {factor}" in caplog.text


async def test_a_message_of_the_wrong_form_changes_nothing(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(MessageError):
        desk.graph.publish(CLIENT, SPEED_FACTOR_TOPIC, {"data": "fast"})
    assert desk.arm.changes == []
    assert SPEED_FACTOR_TOPIC in caplog.text


async def test_a_motion_is_paused_goes_back_and_arrives_after_all(client: ArmClient) -> None:
    await client.goal(*GOAL, {"name": ["shoulder_pan"], "position": [0.0]})
    await client.until("/moveit_goal_result", bool)
    await client.goal(*GOAL, {"name": ["shoulder_pan"], "position": [1.2]})
    await client.until("/joint_states", lambda states: states[-1]["position"][0] > 0.3)
    assert (await client.call(PAUSE))["success"]
    await client.until("/arm/state", lambda states: values_of(states[-1])["course"] == "paused")
    paused_at = (await standing(client))["position"][0]
    assert (await client.call(STEP_BACK))["success"]
    await client.until("/joint_states", lambda states: states[-1]["position"][0] < paused_at - 0.1)
    assert len(client.topics["/moveit_goal_result"]) == 1
    assert (await client.call(RESUME))["success"]
    results = await client.until("/moveit_goal_result", lambda all_: len(all_) == 2)
    assert results[1]["val"] == 1
    assert client.topics["/joint_states"][-1]["position"][0] == pytest.approx(1.2, abs=0.06)


async def standing(client: ArmClient) -> dict[str, Any]:
    """The joints once they stand still."""
    states = await client.until("/joint_states", lambda states: abs(states[-1]["velocity"][0]) < 0.02)
    return states[-1]

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from protocol.registry import Registry
from robot.arm import Arm
from robot.calibration import Calibration
from robot.description import model
from robot.hardware.config import EmulatedConfig
from robot.messages import ArmConfig, ArmState, Mode
from server.graph.node import Node
from server.graph.services import Response
from server.graph.topics import Graph, Subscriber
from server.moveit.current_state import CurrentState
from server.moveit.named_states import NamedStates
from server.moveit.named_states_services import TOPIC, NamedStatesServices
from tests.helpers.goal_translator import keep_nothing
from tests.helpers.readings import reading

ROBOT = model.builtin()
CLIENT = Node("client")
JOINTS = tuple(joint.name for joint in ROBOT.movable_joints)


class Office:
    """The services, for an arm that says where it is."""

    def __init__(self) -> None:
        self.graph = Graph(Registry.load())
        self.states = NamedStates(ROBOT, "arm", {}, keep_nothing)
        self.arm = Arm(ArmConfig(ROBOT, EmulatedConfig(Calibration.nominal())), lambda _state: None)
        NamedStatesServices(self.graph, ROBOT, self.states).open(CurrentState(self.arm, ROBOT))
        self.told: list[dict[str, Any]] = []
        subscriber = Subscriber(lambda publication: self.told.append(json.loads(publication.msg["data"])))
        for publication in self.graph.subscribe(CLIENT, TOPIC, None, subscriber):
            subscriber.deliver(publication)

    def be_at(self, position_rad: float) -> None:
        measured = reading([position_rad] * len(JOINTS))
        self.arm.state = ArmState(0.0, Mode.RELAXED, JOINTS, position_rad=measured.position_rad)

    async def call(self, service: str, **request: Any) -> Response:
        answered: asyncio.Future[Response] = asyncio.get_running_loop().create_future()
        self.graph.services.call(CLIENT, service, request, answered.set_result)
        return await answered


@pytest.fixture
async def office() -> Office:
    return Office()


async def test_the_present_pose_is_saved_under_a_name_and_told(office: Office) -> None:
    office.be_at(0.25)
    assert (await office.call("/save_robot_state", name="mine")).values == {"success": True}
    assert office.states.find("mine") == ("mine", dict.fromkeys(JOINTS, 0.25))
    assert office.told[-1]["mine"] == {"saved": True, "joints": dict.fromkeys(JOINTS, 0.25)}
    assert not office.told[-1]["home"]["saved"]


async def test_where_the_arm_is_cannot_be_saved_while_nobody_knows(office: Office) -> None:
    answer = await office.call("/save_robot_state", name="mine")
    assert not answer.ok
    assert "not known" in answer.values


async def test_a_given_state_is_saved_and_given_back(office: Office) -> None:
    state = {"joint_state": {"name": ["elbow_flex"], "position": [0.4]}}
    assert (await office.call("/save_robot_state", name="mine", state=state)).ok
    joints = (await office.call("/get_robot_state", name="Mine")).values["state"]["joint_state"]
    assert (joints["name"], joints["position"]) == (["elbow_flex"], [0.4])


async def test_a_state_with_more_names_than_positions_is_refused(office: Office) -> None:
    state = {"joint_state": {"name": ["elbow_flex"], "position": []}}
    assert "1 names and 0 positions" in (await office.call("/save_robot_state", name="mine", state=state)).values


async def test_states_are_listed_by_pattern_renamed_and_deleted(office: Office) -> None:
    office.be_at(0.1)
    await office.call("/save_robot_state", name="mine")
    assert (await office.call("/list_robot_states")).values["states"] == ["extended", "home", "mine", "ready", "rest"]
    assert (await office.call("/rename_robot_state", old_name="mine", new_name="rest two")).ok
    assert (await office.call("/list_robot_states", regex="r.*")).values["states"] == ["ready", "rest", "rest two"]
    assert (await office.call("/has_robot_state", name="rest two")).values == {"exists": True}
    assert (await office.call("/delete_robot_state", name="rest two")).ok
    assert (await office.call("/has_robot_state", name="rest two")).values == {"exists": False}


@pytest.mark.parametrize("pattern", ["[", "(a|a)*", "a*a*a*", "a" * 101])
async def test_a_pattern_that_is_none_or_could_take_for_ever_is_refused(office: Office, pattern: str) -> None:
    answer = await office.call("/list_robot_states", regex=pattern)
    assert not answer.ok
    assert answer.values.startswith("regex: ")


async def test_a_request_for_another_robot_is_refused(office: Office) -> None:
    answer = await office.call("/list_robot_states", robot="panda")
    assert not answer.ok
    assert "'so101'" in answer.values
    assert (await office.call("/list_robot_states", robot="so101")).ok


@pytest.mark.parametrize("service", ["/get_robot_state", "/delete_robot_state"])
async def test_a_state_that_is_not_there_is_refused_with_those_that_are(office: Office, service: str) -> None:
    assert "extended, home" in (await office.call(service, name="nowhere")).values

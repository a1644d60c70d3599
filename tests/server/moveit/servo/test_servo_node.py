"""Topics and services of MoveIt Servo."""

import asyncio
import json
import logging
from typing import Any, cast

import pytest

from harness.waiting import until
from planners.scene import EMPTY_SCENE, Scene
from planners.servo.question import ServoAnswer, ServoQuestion, ServoStatus
from robot.stop_epochs import STOP_EPOCHS
from server.arrival import arrived_in
from server.execution.motions import Joints
from server.execution.queue import GoalQueue
from server.graph.local_graph import LocalGraph
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.parameters import MoveItParameters
from server.moveit.servo.servo_node import (
    INT8,
    JOINT_TOPIC,
    LOGGED_AGAIN_S,
    PARAMETERS_TOPIC,
    PAUSE_SERVICE,
    POSE_TOPIC,
    START_SERVICE,
    STATUS_TOPIC,
    STOP_SERVICE,
    SWITCH_SERVICE,
    TIMEOUT_TOPIC,
    TWIST_TOPIC,
    CommandGate,
    CommandType,
    ServoNode,
    StatusPublisher,
)
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import ROBOT, FakeArm, settle
from tests.helpers.gateway import REGISTRY
from tests.helpers.graph import answered, listen
from tests.helpers.moveit import planning_of

NORTH = {"twist": {"linear": {"x": 0.5}}}
TYPES = {
    TWIST_TOPIC: "geometry_msgs/TwistStamped",
    JOINT_TOPIC: "control_msgs/JointJog",
    POSE_TOPIC: "geometry_msgs/PoseStamped",
}


class OneGoal:
    """Queue with a goal in the arm's way, or none."""

    goal = ""

    def busy(self, _joints: Joints) -> str:
        return self.goal

    def take_over(self, _joints: Joints, hand: str) -> None:
        """Do nothing."""


class Rig:
    """A servo node between two clients and an arm."""

    def __init__(self) -> None:
        self.graph, self.arm = Graph(REGISTRY), FakeArm()
        self.queue = OneGoal()
        self.asked: list[ServoQuestion] = []
        self.one, self.other = Node("one", remote=True), Node("other", remote=True)
        self.node = ServoNode(
            LocalGraph(self.graph),
            # No command gets too old where a busy machine takes its time.
            MoveItParameters(servo={"incoming_command_timeout": 5.0}),
            self.arm.as_arm,
            planning_of(self.arm, pool=self),
            cast("GoalQueue", self.queue),
            frozenset(ROBOT.groups["arm"].joints),
        )
        self.node._session._clock = asyncio.get_running_loop().time
        self.heard = listen(self.graph, STATUS_TOPIC)
        for client in (self.one, self.other):
            for topic, type_name in TYPES.items():
                self.graph.advertise(client, topic, type_name)

    async def ask(self, question: ServoQuestion, _scene: Scene = EMPTY_SCENE) -> ServoAnswer:
        self.asked.append(question)
        moving = 0.0 if question.command.zero else 0.1
        return ServoAnswer(dict.fromkeys(ROBOT.groups["arm"].joints, moving))

    async def say(self, topic: str, message: dict[str, Any], client: Node | None = None) -> None:
        self.graph.publish(client or self.one, topic, message)
        await settle()

    def call(self, service: str, **request: Any) -> dict[str, Any]:
        return answered(self.graph, service, self.one, **request).values


@pytest.fixture
async def rig() -> Any:
    made = Rig()
    yield made
    await made.node.close()


async def test_each_type_of_command_is_followed_without_selecting_it(rig: Rig) -> None:
    for topic, message, command in (
        (TWIST_TOPIC, NORTH, "TipTwist"),
        (JOINT_TOPIC, {"joint_names": ["elbow_flex"], "velocities": [0.2]}, "JointVelocities"),
        (POSE_TOPIC, {"pose": {"position": {"x": 0.3}}}, "TipTarget"),
    ):
        await rig.say(topic, message)
        await until(lambda command=command: rig.asked and type(rig.asked[-1].command).__name__ == command)
    assert len(rig.arm.streams) == 1


@pytest.mark.stepped_time
async def test_commands_of_a_second_client_are_ignored(rig: Rig) -> None:
    await rig.say(TWIST_TOPIC, NORTH)
    told = len([each for each in rig.heard if each["code"] == ServoStatus.INVALID])
    await rig.say(JOINT_TOPIC, {"joint_names": ["elbow_flex"], "velocities": [0.2]}, rig.other)
    await asyncio.sleep(0.03)
    assert {type(question.command).__name__ for question in rig.asked} == {"TipTwist"}
    assert len([each for each in rig.heard if each["code"] == ServoStatus.INVALID]) == told


async def test_when_the_first_client_leaves_the_second_may_steer(rig: Rig) -> None:
    await rig.say(TWIST_TOPIC, NORTH)
    rig.graph.remove(rig.one)
    await rig.say(JOINT_TOPIC, {"joint_names": ["elbow_flex"], "velocities": [0.2]}, rig.other)
    await until(lambda: rig.asked and type(rig.asked[-1].command).__name__ == "JointVelocities")


@pytest.mark.parametrize(
    ("busy", "speed", "said"), [("", 2.0, "twist.linear.x"), ("goal 3 is worked on", 0.5, "goal 3 is worked on")]
)
async def test_a_command_not_followed_is_published_on_the_status(rig: Rig, busy: str, speed: float, said: str) -> None:
    rig.queue.goal = busy
    await rig.say(TWIST_TOPIC, {"twist": {"linear": {"x": speed}}})
    assert rig.heard[-1]["code"] == ServoStatus.INVALID
    assert said in rig.heard[-1]["message"]
    assert not rig.arm.streams


async def test_a_selected_command_type_excludes_the_others(rig: Rig) -> None:
    assert rig.call(SWITCH_SERVICE, command_type=0) == {"success": True}
    await rig.say(TWIST_TOPIC, NORTH)
    assert "JOINT_JOG was selected" in rig.heard[-1]["message"]
    refused = answered(rig.graph, SWITCH_SERVICE, rig.one, command_type=9)
    assert refused.values == {"success": False}
    assert refused.reason == "command_type must be one of 0 (JOINT_JOG), 1 (TWIST), 2 (POSE), not 9"


@pytest.mark.stepped_time
@pytest.mark.parametrize(
    ("pause", "go_on"),
    [((PAUSE_SERVICE, {"data": True}), (PAUSE_SERVICE, {"data": False})), ((STOP_SERVICE, {}), (START_SERVICE, {}))],
)
async def test_a_pause_ends_the_steering_until_it_is_lifted(rig: Rig, pause: Any, go_on: Any) -> None:
    await rig.say(TWIST_TOPIC, NORTH)
    assert rig.call(pause[0], **pause[1])["success"]
    assert rig.arm.streams[0].ended.done()
    await asyncio.sleep(0.03)
    await rig.say(TWIST_TOPIC, NORTH)
    assert "paused" in rig.heard[-1]["message"]
    rig.call(go_on[0], **go_on[1])
    await rig.say(TWIST_TOPIC, NORTH)
    assert len(rig.arm.streams) == 2


class StatusRig:
    """A status topic and what is heard there."""

    def __init__(self, type_name: str) -> None:
        graph = Graph(REGISTRY)
        self.clock = FakeClock()
        self.topic = StatusPublisher(graph, Node("servo_node"), type_name, self.clock)
        self.heard = listen(graph, STATUS_TOPIC)


def test_humble_gets_its_own_numbers() -> None:
    rig = StatusRig(INT8)
    for status in (ServoStatus.JOINT_BOUND, ServoStatus.HALT_FOR_COLLISION, ServoStatus.HALT_FOR_SINGULARITY):
        rig.topic.publish(status, "")
    assert [each["data"] for each in rig.heard] == [5, 4, 2]


def test_a_repeated_rejection_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    rig = StatusRig("moveit_msgs/ServoStatus")
    with caplog.at_level(logging.WARNING, "armbridge.servo"):
        for _ in range(10):
            rig.topic.publish(ServoStatus.INVALID, "the arm is relaxed")
            rig.topic.publish(ServoStatus.NO_WARNING, "")
        assert len(caplog.records) == 1
        rig.clock.advance(1.1 * LOGGED_AGAIN_S)
        rig.topic.publish(ServoStatus.INVALID, "the arm is relaxed")
    assert len(caplog.records) == 2
    assert len(rig.heard) == 21


TIMEOUT_S = 0.25
ONE, OTHER = Node("one"), Node("other")
TWIST, JOG = CommandType.TWIST, CommandType.JOINT_JOG


class GateRig:
    """A gate of an arm."""

    def __init__(self) -> None:
        self.arm = FakeArm()
        self.gate = CommandGate(lambda _client: True, TIMEOUT_S, self.arm.as_arm)

    def said(self, at_s: float, client: Node = ONE, kind: CommandType = TWIST) -> str:
        return self.gate.rejection(client, kind, at_s)


@pytest.fixture
def gate_rig() -> GateRig:
    return GateRig()


@pytest.mark.parametrize("said", ["a goal came", "the arm was stopped"])
def test_after_an_interruption_or_a_stop_commands_are_rejected_until_a_pause(gate_rig: GateRig, said: str) -> None:
    gate_rig.said(0.0)
    if said == "the arm was stopped":
        gate_rig.arm.stop()
    else:
        gate_rig.gate.interrupt(said)
    for step in range(1, 20):
        assert said in gate_rig.said(0.1 * step)
    assert gate_rig.said(1.9 + 1.1 * TIMEOUT_S) == ""


def test_a_command_that_a_stop_has_overtaken_is_rejected_even_as_the_first(gate_rig: GateRig) -> None:
    before = STOP_EPOCHS.present
    gate_rig.arm.stop()
    with arrived_in(before):
        assert "the arm was stopped" in gate_rig.said(0.0)


def test_after_a_stop_or_an_interruption_a_held_stick_steers_again_when_the_status_is_reset(gate_rig: GateRig) -> None:
    gate_rig.said(0.0)
    for at_s, end in ((0.1, gate_rig.arm.stop), (0.2, lambda: gate_rig.gate.interrupt("stopped"))):
        end()
        gate_rig.gate.reset()
        assert gate_rig.said(at_s) == ""


@pytest.mark.parametrize("end", ["a stop", "another end of the steering"])
def test_a_client_that_announces_its_presses_steers_again_only_after_another_press(gate_rig: GateRig, end: str) -> None:
    gate = gate_rig.gate
    gate.press(ONE, TIMEOUT_S, {ONE})
    assert gate_rig.said(0.0) == ""
    # A gap alone, as of a page that stood still, ends nothing.
    assert gate_rig.said(1.0) == ""
    if end == "a stop":
        gate_rig.arm.stop()
    else:
        gate.interrupt("a goal came")
    assert f"then publish {TIMEOUT_TOPIC} again" in gate_rig.said(2.0)
    assert gate_rig.said(3.0) != ""
    gate.press(ONE, TIMEOUT_S, {ONE})
    assert gate_rig.said(3.1) != ""
    assert gate_rig.said(4.0) == ""


def test_a_client_shortens_the_timeout_of_its_own_commands_alone(gate_rig: GateRig) -> None:
    gate = gate_rig.gate
    gate.press(ONE, 0.08, {ONE})
    assert (gate.timeout_s(ONE), gate.timeout_s(OTHER)) == (0.08, TIMEOUT_S)
    # The first client has left meanwhile.
    gate.press(OTHER, 3.0, {OTHER})
    assert (gate.timeout_s(ONE), gate.timeout_s(OTHER)) == (TIMEOUT_S, TIMEOUT_S)


@pytest.mark.stepped_time
async def test_the_timeout_of_a_client_counts_for_its_commands(rig: Rig) -> None:
    for client in (rig.one, rig.other):
        rig.graph.advertise(client, TIMEOUT_TOPIC, "std_msgs/Float64")
    await rig.say(TIMEOUT_TOPIC, {"data": 0.03})
    await rig.say(TWIST_TOPIC, NORTH)
    await asyncio.sleep(0.15)
    assert not rig.arm.setpoints[-1].velocity_rad_s.any()


@pytest.mark.parametrize(("data", "said"), [(0.001, "not 0.001"), (float("nan"), "not nan"), (-1.0, "not -1")])
async def test_a_bad_timeout_is_rejected_with_limit_and_value(rig: Rig, data: float, said: str) -> None:
    rig.graph.advertise(rig.one, TIMEOUT_TOPIC, "std_msgs/Float64")
    await rig.say(TIMEOUT_TOPIC, {"data": data})
    assert "/servo_node/command_timeout: data must be at least 0.02 s" in rig.heard[-1]["message"]
    assert said in rig.heard[-1]["message"]


async def test_the_scales_are_published_for_clients_that_come_later(rig: Rig) -> None:
    [latched] = listen(rig.graph, PARAMETERS_TOPIC)
    told = json.loads(latched["data"])
    assert told["linear_scale"] == MoveItParameters().servo.linear_scale
    assert told["command_in_type"] == "unitless"

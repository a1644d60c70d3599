"""Topics and services of MoveIt Servo."""

import asyncio
import json
import logging
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from harness.waiting import until
from planners.scene import EMPTY_SCENE, Scene
from planners.servo.question import ServoAnswer, ServoQuestion, ServoStatus
from robot.stop_epochs import STOP_EPOCHS
from server.arrival import arrived_in
from server.graph.permissions import Node
from server.graph.topics import Graph
from server.moveit.parameters import MoveItParameters
from server.moveit.servo import servo_node
from tests.helpers.clock import FakeClock, SteppedLoop
from tests.helpers.fake_arm import ROBOT, FakeArm, settle
from tests.helpers.gateway import REGISTRY
from tests.helpers.graph import answered, listen
from tests.helpers.moveit import goal_context, planning_of

NORTH = {"twist": {"linear": {"x": 0.5}}}
TYPES = {
    servo_node.TWIST_TOPIC: "geometry_msgs/TwistStamped",
    servo_node.JOINT_TOPIC: "control_msgs/JointJog",
    servo_node.POSE_TOPIC: "geometry_msgs/PoseStamped",
}


class Rig:
    """A servo node between two clients and an arm."""

    def __init__(self) -> None:
        self.graph, self.arm = Graph(REGISTRY, asyncio.get_running_loop().time), FakeArm()
        self.busy = ""
        queue: Any = SimpleNamespace(busy=lambda _joints: self.busy, take_over=lambda *_joints_and_hand: None)
        self.asked: list[ServoQuestion] = []
        self.one, self.other = Node("one", remote=True), Node("other", remote=True)
        planning = planning_of(self.arm, pool=self, graph=self.graph)
        # No command gets too old where a busy machine takes its time.
        context = goal_context(self.graph, self.arm, planning, queue, servo={"incoming_command_timeout": 5.0})
        self.node = servo_node.ServoNode(context)
        self.heard = listen(self.graph, servo_node.STATUS_TOPIC)
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
        (servo_node.TWIST_TOPIC, NORTH, "TipTwist"),
        (servo_node.JOINT_TOPIC, {"joint_names": ["elbow_flex"], "velocities": [0.2]}, "JointVelocities"),
        (servo_node.POSE_TOPIC, {"pose": {"position": {"x": 0.3}}}, "TipTarget"),
    ):
        await rig.say(topic, message)
        await until(lambda command=command: rig.asked and type(rig.asked[-1].command).__name__ == command)
    assert len(rig.arm.streams) == 1


@pytest.mark.stepped_time
async def test_commands_of_a_second_client_are_ignored_until_the_first_leaves(rig: Rig) -> None:
    await rig.say(servo_node.TWIST_TOPIC, NORTH)
    told = len([each for each in rig.heard if each["code"] == ServoStatus.INVALID])
    await rig.say(servo_node.JOINT_TOPIC, {"joint_names": ["elbow_flex"], "velocities": [0.2]}, rig.other)
    await asyncio.sleep(0.03)
    assert {type(question.command).__name__ for question in rig.asked} == {"TipTwist"}
    assert len([each for each in rig.heard if each["code"] == ServoStatus.INVALID]) == told
    rig.graph.remove(rig.one)
    await rig.say(servo_node.JOINT_TOPIC, {"joint_names": ["elbow_flex"], "velocities": [0.2]}, rig.other)
    await until(lambda: rig.asked and type(rig.asked[-1].command).__name__ == "JointVelocities")


async def test_a_command_not_followed_is_published_on_the_status(rig: Rig) -> None:
    for busy, speed, said in (("", 2.0, "twist.linear.x"), ("goal 3 is worked on", 0.5, "goal 3 is worked on")):
        rig.busy = busy
        await rig.say(servo_node.TWIST_TOPIC, {"twist": {"linear": {"x": speed}}})
        assert rig.heard[-1]["code"] == ServoStatus.INVALID, busy
        assert said in rig.heard[-1]["message"]
        assert not rig.arm.streams, busy


async def test_any_type_of_command_may_be_selected_and_no_other_number(rig: Rig) -> None:
    for kind in (0, 1, 2):
        assert rig.call(servo_node.SWITCH_SERVICE, command_type=kind) == {"success": True}
    refused = answered(rig.graph, servo_node.SWITCH_SERVICE, rig.one, command_type=9)
    assert refused.values == {"success": False}
    assert refused.reason == "command_type must be one of 0 (JOINT_JOG), 1 (TWIST), 2 (POSE), not 9"


@pytest.mark.stepped_time
@pytest.mark.parametrize(
    ("pause", "go_on"),
    [
        ((servo_node.PAUSE_SERVICE, {"data": True}), (servo_node.PAUSE_SERVICE, {"data": False})),
        ((servo_node.STOP_SERVICE, {}), (servo_node.START_SERVICE, {})),
    ],
)
async def test_a_pause_ends_the_steering_until_it_is_lifted(rig: Rig, pause: Any, go_on: Any) -> None:
    await rig.say(servo_node.TWIST_TOPIC, NORTH)
    assert rig.call(pause[0], **pause[1])["success"]
    assert rig.arm.streams[0].ended.done()
    await asyncio.sleep(0.03)
    await rig.say(servo_node.TWIST_TOPIC, NORTH)
    assert "paused" in rig.heard[-1]["message"]
    rig.call(go_on[0], **go_on[1])
    await rig.say(servo_node.TWIST_TOPIC, NORTH)
    assert len(rig.arm.streams) == 2


def test_humble_gets_its_own_numbers() -> None:
    graph = Graph(REGISTRY)
    topic = servo_node.StatusPublisher(graph.node("servo_node"), servo_node.INT8)
    heard = listen(graph, servo_node.STATUS_TOPIC)
    for status in (ServoStatus.JOINT_BOUND, ServoStatus.HALT_FOR_COLLISION, ServoStatus.HALT_FOR_SINGULARITY):
        topic.publish(status, "")
    assert [each["data"] for each in heard] == [5, 4, 2]


def test_a_repeated_rejection_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    clock = FakeClock()
    graph = Graph(REGISTRY, clock)
    topic = servo_node.StatusPublisher(graph.node("servo_node"), "moveit_msgs/ServoStatus")
    heard = listen(graph, servo_node.STATUS_TOPIC)
    with caplog.at_level(logging.WARNING, "armbridge.servo"):
        for _ in range(10):
            topic.publish(ServoStatus.INVALID, "the arm is relaxed")
            topic.publish(ServoStatus.NO_WARNING, "")
        assert len(caplog.records) == 1
        clock.advance(1.1 * servo_node.LOGGED_AGAIN_S)
        topic.publish(ServoStatus.INVALID, "the arm is relaxed")
    assert len(caplog.records) == 2
    assert len(heard) == 21


TIMEOUT_S = 0.25
ONE, OTHER = Node("one"), Node("other")


class GateRig:
    """A gate of an arm, and its clients."""

    def __init__(self) -> None:
        self.arm = FakeArm()
        self.present = {ONE, OTHER}
        self.gate = servo_node.CommandGate(self.present.__contains__, TIMEOUT_S, self.arm.as_arm)

    def say(self, client: Node = ONE) -> str:
        """Send a command; returns the reason for which it is rejected."""
        return self.gate.rejection(client, asyncio.get_running_loop().time())


@pytest.fixture
def gate_rig() -> GateRig:
    return GateRig()


def stop(rig: GateRig) -> str:
    rig.arm.stop()
    return "the arm was stopped"


def interrupt(rig: GateRig) -> str:
    rig.gate.interrupt("a goal came")
    return "a goal came"


in_every_way = pytest.mark.parametrize("end", [stop, interrupt])


@pytest.mark.stepped_time
@in_every_way
async def test_after_an_end_of_the_steering_commands_are_rejected_until_a_pause_or_the_status_is_reset(
    gate_rig: GateRig, end: Callable[[GateRig], str]
) -> None:
    gate_rig.say()
    said = end(gate_rig)
    for _ in range(20):
        await asyncio.sleep(0.1)
        assert said in gate_rig.say()
    await asyncio.sleep(1.1 * TIMEOUT_S)
    assert gate_rig.say() == ""
    end(gate_rig)
    gate_rig.gate.reset()
    assert gate_rig.say() == ""


async def test_a_command_that_a_stop_has_overtaken_is_rejected_even_as_the_first(gate_rig: GateRig) -> None:
    before = STOP_EPOCHS.present
    gate_rig.arm.stop()
    with arrived_in(before):
        assert "the arm was stopped" in gate_rig.say()


@pytest.mark.stepped_time
@pytest.mark.parametrize("timers_first", [False, True])
async def test_a_standstill_of_the_server_after_a_stop_lets_no_stick_go(
    gate_rig: GateRig, *, timers_first: bool
) -> None:
    """The commands of that time are read when the server goes on, behind the timers or before them."""
    gate_rig.say()
    stop(gate_rig)
    gate_rig.say()
    cast("SteppedLoop", asyncio.get_running_loop()).advance(10.0 * TIMEOUT_S)
    if timers_first:
        await settle()
    for _ in range(20):
        assert "the arm was stopped" in gate_rig.say()
        await asyncio.sleep(0.2 * TIMEOUT_S)
    await asyncio.sleep(1.1 * TIMEOUT_S)
    assert gate_rig.say() == ""


@pytest.mark.stepped_time
async def test_a_stick_held_on_since_before_a_stop_takes_over_from_no_client_that_leaves(gate_rig: GateRig) -> None:
    assert gate_rig.say() == ""
    assert "cannot steer" in gate_rig.say(OTHER)
    stop(gate_rig)
    gate_rig.present.remove(ONE)
    await asyncio.sleep(0.9 * TIMEOUT_S)
    assert "the arm was stopped" in gate_rig.say(OTHER)
    await asyncio.sleep(1.1 * TIMEOUT_S)
    assert gate_rig.say(OTHER) == ""


@pytest.mark.stepped_time
@in_every_way
async def test_a_client_that_tells_its_presses_steers_after_another(
    gate_rig: GateRig, end: Callable[[GateRig], str]
) -> None:
    gate = gate_rig.gate
    gate.press(ONE, TIMEOUT_S, {ONE})
    assert gate_rig.say() == ""
    # A gap alone, as of a page that stood still, ends nothing.
    await asyncio.sleep(1.0)
    assert gate_rig.say() == ""
    end(gate_rig)
    await asyncio.sleep(1.0)
    assert f"then publish {servo_node.TIMEOUT_TOPIC} again" in gate_rig.say()
    await asyncio.sleep(1.0)
    assert gate_rig.say() != ""
    gate.press(ONE, TIMEOUT_S, {ONE})
    await asyncio.sleep(0.1)
    assert gate_rig.say() != ""
    await asyncio.sleep(1.0)
    assert gate_rig.say() == ""


def test_a_client_shortens_the_timeout_of_its_own_commands_alone(gate_rig: GateRig) -> None:
    gate = gate_rig.gate
    gate.press(ONE, 0.08, {ONE})
    assert (gate.timeout_s(ONE), gate.timeout_s(OTHER)) == (0.08, TIMEOUT_S)
    # The first client has left meanwhile.
    gate.press(OTHER, 3.0, {OTHER})
    assert (gate.timeout_s(ONE), gate.timeout_s(OTHER)) == (TIMEOUT_S, TIMEOUT_S)


# The clients' clocks are ahead, and behind.
@pytest.mark.parametrize("ahead_s", [1000, -1000])
def test_a_command_that_waited_on_its_way_has_expired_by_its_clients_clock(gate_rig: GateRig, ahead_s: int) -> None:
    gate = gate_rig.gate

    def has_expired(sent_s: int, at_s: float, client: Node = ONE) -> bool:
        return gate.has_expired(client, {"sec": sent_s + ahead_s, "nanosec": 0}, at_s)

    gate.press(ONE, 0.08, {ONE})
    sent_at_s = [(2000, 2000.1), (2001, 2001.0), (2002, 2002.07), (2003, 2003.09), (2004, 2004.0)]
    assert [has_expired(*each) for each in sent_at_s] == [False, False, False, True, False]
    # From a slower network, after another press; and of clients that say nothing of presses or times.
    gate.press(ONE, 0.08, {ONE})
    assert not has_expired(2010, 2011.0)
    assert not has_expired(2012, 2019.0, OTHER)
    assert not gate.has_expired(ONE, {"sec": 0, "nanosec": 0}, 2020.0)


@pytest.mark.stepped_time
async def test_a_command_that_has_expired_on_its_way_moves_nothing_and_a_halt_halts_however_late(rig: Rig) -> None:
    rig.graph.advertise(rig.one, servo_node.TIMEOUT_TOPIC, "std_msgs/Float64")
    await rig.say(servo_node.TIMEOUT_TOPIC, {"data": 0.08})
    late, prompt = ({"header": {"stamp": {"sec": sec, "nanosec": 0}}} for sec in (1000, 2000))
    await rig.say(servo_node.TWIST_TOPIC, NORTH | prompt)
    await rig.say(servo_node.TWIST_TOPIC, late)
    assert not rig.arm.setpoints[-1].velocity_rad_s.any()
    await asyncio.sleep(1.0)
    await rig.say(servo_node.TWIST_TOPIC, NORTH | late)
    assert "expired on its way" in rig.heard[-1]["message"]
    assert len(rig.arm.streams) == 1


@pytest.mark.stepped_time
async def test_the_timeout_of_a_client_counts_for_its_commands(rig: Rig) -> None:
    for client in (rig.one, rig.other):
        rig.graph.advertise(client, servo_node.TIMEOUT_TOPIC, "std_msgs/Float64")
    await rig.say(servo_node.TIMEOUT_TOPIC, {"data": 0.03})
    await rig.say(servo_node.TWIST_TOPIC, NORTH)
    await asyncio.sleep(0.15)
    assert not rig.arm.setpoints[-1].velocity_rad_s.any()


@pytest.mark.parametrize(("data", "said"), [(0.001, "not 0.001"), (float("nan"), "not nan"), (-1.0, "not -1")])
async def test_a_bad_timeout_is_rejected_with_limit_and_value(rig: Rig, data: float, said: str) -> None:
    rig.graph.advertise(rig.one, servo_node.TIMEOUT_TOPIC, "std_msgs/Float64")
    await rig.say(servo_node.TIMEOUT_TOPIC, {"data": data})
    assert "/servo_node/command_timeout: data must be at least 0.02 s" in rig.heard[-1]["message"]
    assert said in rig.heard[-1]["message"]


async def test_the_scales_are_published_for_clients_that_come_later(rig: Rig) -> None:
    [latched] = listen(rig.graph, servo_node.PARAMETERS_TOPIC)
    told = json.loads(latched["data"])
    assert told["linear_scale"] == MoveItParameters().servo.linear_scale
    assert told["command_in_type"] == "unitless"

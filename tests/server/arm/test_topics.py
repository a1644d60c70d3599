import numpy as np
import pytest

from harness.clients import values_of
from robot.faults import Fault, FaultCode
from robot.messages import ArmHealth, ArmState, BusCounters, JointHealth, Mode
from server.arm.topics import LIMITS_TOPIC, STATE_TOPIC, TOPIC, ArmStateTopics, states_are_observed
from server.graph.permissions import Node
from server.graph.topics import Graph, LocalGraph, Subscriber
from tests.helpers.graph import listen
from tests.helpers.messages import REGISTRY
from tests.helpers.robots import nominal_calibration, so101

ROBOT = so101()
STALLED = Fault(FaultCode.STALLED, "joint elbow_flex is stalled", "elbow_flex", 12.5)


class Heard:
    """The topics, and what was said on them."""

    def __init__(self) -> None:
        self.graph = Graph(REGISTRY)
        self.topics = ArmStateTopics(
            LocalGraph(self.graph), ROBOT, ArmState(0.0, Mode.CONNECTED, ()), nominal_calibration()
        )
        self.states = listen(self.graph, STATE_TOPIC)
        self.limits = listen(self.graph, LIMITS_TOPIC)


@pytest.fixture
def heard() -> Heard:
    return Heard()


def health(limits_rad: list[tuple[float, float]]) -> ArmHealth:
    servos = tuple(
        JointHealth(name, f"servo {number}", 0.0, 30, 5.0, 0.0, 0.0, True, 0, 0.0, 0)
        for number, name in enumerate(("shoulder_pan", "gripper"), start=1)
    )
    times = (0.0, 0.0, 0.0)
    return ArmHealth(0.0, Mode.HOLDING, "", servos, BusCounters(), times, times, True, limits_rad=np.array(limits_rad))


def test_a_state_has_the_calibrated_ranges_and_is_published_when_it_says_something_new(heard: Heard) -> None:
    for stamp_s in range(3):
        heard.topics.take_state(ArmState(stamp_s, Mode.HOLDING, ("a",), position_rad=np.array([stamp_s])))
    for last_stop in (3, 3, 4):
        heard.topics.take_state(ArmState(4.0, Mode.MOVING, ("a",)), last_stop)
    told = [(values_of(state)["mode"], values_of(state)["last_stop"]) for state in heard.states[1:]]
    assert told == [("holding", "0"), ("moving", "3"), ("moving", "4")]
    gripper = nominal_calibration().joints[-1]
    ends = values_of(heard.states[0])["calibrated_range_rad.gripper"].split()
    assert [float(end) for end in ends] == pytest.approx([gripper.lower_rad, gripper.upper_rad], abs=1e-5)


def test_a_fault_is_told_with_code_sentence_remedy_and_service(heard: Heard) -> None:
    heard.topics.take_state(ArmState(0.0, Mode.FAULT, ("a",), fault=STALLED))
    state = heard.states[-1]
    assert state["level"] == 2
    assert state["message"].startswith(str(STALLED))
    assert "/arm/reset_fault" in state["message"]
    values = values_of(state)
    assert (values["fault"], values["fault_joint"], values["fault_stamp"]) == ("stalled", "elbow_flex", "12.500")
    assert values["fault_remedy"] == STALLED.remedy


def test_the_limits_are_the_descriptions_until_the_servos_own_are_known(heard: Heard) -> None:
    assert heard.limits[0]["joint_names"] == [joint.name for joint in ROBOT.movable_joints]
    heard.topics.take_health(health([(-1.0, 1.5), (0.0, 1.0)]))
    heard.topics.take_health(health([(-1.0, 1.5), (0.0, 1.0)]))
    assert len(heard.limits) == 2
    pan, gripper = heard.limits[1]["limits"]
    assert (pan["joint_name"], pan["min_position"], pan["max_position"]) == ("shoulder_pan", -1.0, 1.5)
    assert gripper["max_velocity"] == ROBOT.joints["gripper"].max_velocity


def test_joints_are_published_with_the_time_of_their_reading_and_not_of_an_arm_that_is_not_there(heard: Heard) -> None:
    array, joint_states = np.array([0.1, -0.2]), listen(heard.graph, TOPIC)
    heard.topics.publish_joints(ArmState(1.8e9, Mode.DISCONNECTED, ("a",), reason="unplugged"))
    heard.topics.publish_joints(
        ArmState(1234.25, Mode.HOLDING, ("a", "b"), position_rad=array, velocity_rad_s=array * 2, load=array * 3)
    )
    assert joint_states == [
        {
            "header": {"stamp": {"sec": 1234, "nanosec": 250_000_000}, "frame_id": ""},
            "name": ["a", "b"],
            "position": pytest.approx([0.1, -0.2]),
            "velocity": pytest.approx([0.2, -0.4]),
            "effort": pytest.approx([0.3, -0.6]),
        }
    ]


@pytest.mark.parametrize(
    ("topic", "observed"),
    [
        ("/joint_states", True),
        ("/tf", True),
        ("/arm_controller/state", True),
        ("/arm_with_torso_controller/controller_state", True),
        ("/arm/state", False),
        ("/diagnostics", False),
    ],
)
def test_states_are_observed_while_somebody_subscribes_to_what_follows_them(topic: str, observed: bool) -> None:
    graph, node = Graph(REGISTRY), Node("test")
    graph.advertise(Node("arm"), topic, "std_msgs/String")
    assert not states_are_observed(graph)
    graph.subscribe(node, topic, None, Subscriber(lambda _: None))
    assert states_are_observed(graph) is observed
    graph.remove(node)
    assert not states_are_observed(graph)

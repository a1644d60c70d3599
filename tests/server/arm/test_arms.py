"""Arms of a server: set up, calibrating and topics."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.clients import values_of
from robot.calibration import save
from robot.errors import CalibrationError
from robot.faults import Fault, FaultCode
from robot.hardware.config import IdealConfig
from robot.messages import ArmHealth, ArmState, BusCounters, JointHealth, Mode
from robot.stop_epochs import STOP_EPOCHS
from server.arm.arms import JoinedBeat, joined_robot, read_arms, without_prefix
from server.arm.calibrating import calibration_file
from server.arm.interface import LIMITS_TOPIC, STATE_TOPIC, TOPIC, ArmStateTopics, states_are_observed
from server.arm.setup import Description
from server.config import ArmSettings, Settings
from server.errors import ConfigurationError
from server.graph.permissions import Node
from server.graph.topics import Graph, LocalGraph, Subscriber
from tests.helpers.graph import listen
from tests.helpers.messages import REGISTRY
from tests.helpers.robots import nominal_calibration, so101


def settings(**arms: dict[str, Any]) -> Settings:
    return Settings.model_validate({"arms": arms})


def test_below_a_name_an_arm_has_the_same_calibration_and_limits_and_without_it_the_plain_names(tmp_path: Path) -> None:
    save(nominal_calibration(), tmp_path / "left.json")
    arm = read_arms(settings(left={"calibration": str(tmp_path / "left.json")}))["left"]
    plain = Description.read(ArmSettings(calibration=tmp_path / "left.json"))
    for prefix, calibration in (("left_", arm.description.calibration), ("", plain.calibration)):
        assert calibration is not None
        assert without_prefix(calibration, prefix) == nominal_calibration()
    for joint in plain.robot.movable_joints:
        limits = arm.config.robot.joints[f"left_{joint.name}"]
        assert (limits.lower, limits.upper) == (joint.lower, joint.upper)


def test_arms_of_different_kinds_stand_in_one_description(tmp_path: Path) -> None:
    urdf, srdf = tmp_path / "one.urdf", tmp_path / "one.srdf"
    urdf.write_text(so101().urdf)
    srdf.write_text(so101().srdf)
    arms = read_arms(
        settings(
            left={"base_xyz_m": (0.0, 0.3, 0.0), "role": "leader"},
            koch={"robot": "koch_v1_1", "base_rpy_rad": (0.0, 0.0, 1.5)},
            ideal={"urdf": str(urdf), "srdf": str(srdf)},
        )
    )
    assert isinstance(arms["ideal"].config.hardware, IdealConfig)
    assert [arm.config.start_enabled for arm in arms.values()] == [False, True, True], "a leader starts without torque"
    whole = joined_robot(arms)
    assert [joint.name for joint in whole.movable_joints] == [name for arm in arms.values() for name in arm.joint_names]


def test_arms_without_a_place_of_their_own_are_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    read_arms(settings(left={"base_xyz_m": (0.0, 0.3, 0.0)}, middle={}, right={}))
    assert [record.getMessage() for record in caplog.records if record.levelname == "WARNING"] == [
        "arms.middle and arms.right stand in each other: set base_xyz_m, or their goals are refused"
    ]


def test_what_cannot_be_used_is_refused_with_the_name_of_the_arm() -> None:
    for arm, words in (
        ({"role": "leader", "serial": "/dev/nothing"}, "a leader needs a calibration"),
        ({"robot": "nobody"}, "'nobody' is no folder"),
        ({"zero_offset_rad": {"knee": 0.1}}, "knee"),
        ({"emulator": {"write_log": "/nowhere/log"}}, "emulator.write_log"),
    ):
        with pytest.raises(ConfigurationError, match=rf"^arms.left: .*{words}"):
            read_arms(settings(left=arm))


PERIOD_S = 0.02


def test_states_of_arms_are_told_once_a_period_and_silent_arms_and_bursts_hold_nobody_up() -> None:
    random = np.random.default_rng(3)

    def told(*arrivals_s: float) -> int:
        beat = JoinedBeat(PERIOD_S)
        return sum(beat.takes(at_s) for at_s in sorted(arrivals_s))

    ticks_s = PERIOD_S * np.arange(100.0)
    # Of three arms, each with a phase of its own and a jitter of 2 ms, and of one alone.
    several_s = ticks_s + PERIOD_S * random.random((3, 1)) + 0.002 * random.random((3, 100))
    assert told(*several_s.ravel()) == pytest.approx(100, abs=10)
    assert told(*ticks_s) == 100
    assert told(*np.repeat(0.1 * np.arange(20.0), 15)) == 20


@pytest.fixture
def lerobot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    save(nominal_calibration(), tmp_path / "robots" / "so_follower" / "mine.json")
    return tmp_path / "robots" / "so_follower"


def test_a_name_is_one_of_lerobots_and_without_one_the_calibration_in_use_is_written(lerobot: Path) -> None:
    description = Description.read(ArmSettings(calibration=Path("mine")))
    assert (description.calibration, description.calibration_file) == (nominal_calibration(), lerobot / "mine.json")
    assert calibration_file("other", description) == (lerobot / "other.json", False)
    for name in ("mine", ""):
        assert calibration_file(name, description) == (lerobot / "mine.json", True)


def test_a_name_leads_nowhere_else_and_one_is_needed_that_lerobot_has_a_place_for(lerobot: Path) -> None:
    assert lerobot.is_dir()
    unknown = Description.read(ArmSettings())
    for name, description, words in (
        ("", Description.read(ArmSettings(robot="so101")), "no calibration is in use: name the one to write"),
        *((name, unknown, "is no name") for name in ("a/b", "../mine", "mine.json", "-x", "x" * 65, "a b")),
        ("mine", Description.read(ArmSettings(robot="koch_v1_1")), "has dynamixel servos"),
        ("mine", replace(unknown, hardware=replace(unknown.hardware, calibrations=())), "has no place for this arm"),
    ):
        with pytest.raises(CalibrationError, match=words):
            calibration_file(name, description)


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


def test_a_state_is_published_when_it_says_something_new_and_a_fault_with_its_remedy(heard: Heard) -> None:
    for stamp_s in range(3):
        heard.topics.take_state(ArmState(stamp_s, Mode.HOLDING, ("a",), position_rad=np.array([stamp_s])))
    for last_stop in (3, 3, 4):
        heard.topics.take_state(ArmState(4.0, Mode.MOVING, ("a",)), last_stop)
    # A stop of another part, which a client may name as the last one that it knew of.
    stops = [STOP_EPOCHS.present, STOP_EPOCHS.begin()]
    heard.topics.take_state(ArmState(4.0, Mode.MOVING, ("a",)), 4)
    told = [(values["mode"], values["last_stop"], values["stops"]) for values in map(values_of, heard.states[1:])]
    before, now = map(str, stops)
    assert told == [("holding", "0", before), ("moving", "3", before), ("moving", "4", before), ("moving", "4", now)]
    gripper = nominal_calibration().joints[-1]
    ends = values_of(heard.states[0])["calibrated_range_rad.gripper"].split()
    assert [float(end) for end in ends] == pytest.approx([gripper.lower_rad, gripper.upper_rad], abs=1e-5)
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


def test_states_are_observed_while_somebody_subscribes_to_what_follows_them() -> None:
    for topic, observed in (
        ("/joint_states", True),
        ("/tf", True),
        ("/arm_controller/state", True),
        ("/arm_with_torso_controller/controller_state", True),
        ("/arm/state", False),
        ("/diagnostics", False),
    ):
        graph, node = Graph(REGISTRY), Node("test")
        graph.advertise(Node("arm"), topic, "std_msgs/String")
        assert not states_are_observed(graph), topic
        graph.subscribe(node, topic, None, Subscriber(lambda _: None))
        assert states_are_observed(graph) is observed
        graph.remove(node)
        assert not states_are_observed(graph), topic

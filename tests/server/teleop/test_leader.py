"""Leaders: their values, their client and teleoperation by them."""

import asyncio
import math
from collections.abc import AsyncIterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.publication import PublishedMessage
from robot import logs
from robot.messages import ArmState, Mode
from server import cli
from server.errors import ServiceError
from server.graph.permissions import Node
from server.interfaces import load_registry
from server.rosbridge_clients import PublishedTopic
from server.teleop.following import STALE_S
from server.teleop.leader import JitterBuffer, LeaderPose, LeaderSample, joint_map, mirrored_joints
from server.teleop.leader_client import IN_FLIGHT, LeaderClient
from server.teleop.teleoperation import MAX_JOINTS, Leader, read_sample
from tests.helpers.clock import FakeClock
from tests.helpers.held_connection import HeldConnection
from tests.helpers.messages import time_message
from tests.helpers.robots import so101

# The leader's clock is elsewhere.
OFFSET_S = 1e6


def buffer_of(*samples: tuple[float, float, float], velocity: float = 2.0) -> JitterBuffer:
    """A buffer that took a position [rad] read at a time, which came at another [s]."""
    buffer = JitterBuffer({"a": velocity})
    for read_s, arrived_s, position_rad in samples:
        buffer.add(LeaderSample(read_s + OFFSET_S, {"a": position_rad}), arrived_s)
    return buffer


def pose_at(buffer: JitterBuffer, now_s: float) -> LeaderPose:
    pose = buffer.pose(now_s)
    assert pose is not None
    return pose


def test_an_arm_of_this_server_is_followed_without_a_delay_and_an_empty_buffer_not_at_all() -> None:
    buffer = JitterBuffer({}, max_delay_s=0.0)
    for number, late_s in enumerate((0.0, 0.03, 0.0, 0.05)):
        buffer.add(LeaderSample(number * 0.1, {"pan": float(number)}), number * 0.1 + late_s)
    assert (buffer.delay_s, pose_at(buffer, 0.35).positions_rad) == (0.0, {"pan": 3.0})
    buffer = JitterBuffer({})
    assert buffer.pose(1.0) is None
    assert buffer.age_s(1.0) == math.inf


def test_a_velocity_is_not_that_of_the_single_ticks_of_an_encoder() -> None:
    # 0.1 rad/s, read at 100 Hz in steps of 1.5 mrad: two readings in a row differ by nothing or by 0.15 rad/s.
    buffer = JitterBuffer({}, max_delay_s=0.0)
    velocities = []
    for read_s in np.arange(100) / 100:
        buffer.add(LeaderSample(read_s, {"pan": 0.0015 * round(0.1 * read_s / 0.0015)}), read_s)
        velocities.append(pose_at(buffer, read_s).velocity_rad_s["pan"])
    assert velocities[0] == 0.0
    assert velocities[10:] == pytest.approx([0.1] * 90, abs=0.035)


def test_samples_that_come_in_bursts_are_followed_evenly() -> None:
    buffer = JitterBuffer({"a": 2.0})
    seen = []
    for tick in range(100):
        for k in range(tick - 3, tick + 1) if tick % 4 == 3 else ():
            buffer.add(LeaderSample(k / 100 + OFFSET_S, {"a": k / 100}), tick / 100)
        if tick > 20:
            seen.append(pose_at(buffer, tick / 100).positions_rad["a"])
    assert np.diff(seen) == pytest.approx(0.01, abs=1e-6)


def test_a_sample_that_is_overtaken_is_dropped_and_a_jump_told_once() -> None:
    buffer = buffer_of((0.0, 0.0, 0.0), (0.02, 0.02, 0.2), (0.01, 0.03, 0.1))
    assert pose_at(buffer, 1.0).positions_rad["a"] == 0.2
    buffer = buffer_of((0.0, 0.0, 0.0), (0.01, 0.01, 1.0), (0.02, 0.02, 1.0))
    assert "a of the leader jumped by 1.00 rad within 0.010 s" in buffer.take_jump()
    assert buffer.take_jump() == ""
    assert buffer_of((0.0, 0.0, 0.0), (0.05, 0.05, 0.2)).take_jump() == ""
    assert buffer_of((0.0, 0.0, 0.0), (0.5, 0.5, 1.9)).take_jump() == ""


@given(st.lists(st.tuples(st.floats(0.001, 0.05), st.floats(0.0, 0.2), st.floats(-1.0, 1.0)), min_size=1, max_size=80))
def test_a_pose_is_always_between_samples(steps: list[tuple[float, float, float]]) -> None:
    buffer, read_s, arrived_s = JitterBuffer({}), 0.0, 0.0
    for step_s, late_s, angle in steps:
        read_s += step_s
        arrived_s = max(arrived_s, read_s + late_s)
        buffer.add(LeaderSample(read_s + OFFSET_S, {"a": angle}), arrived_s)
        pose = pose_at(buffer, arrived_s)
        assert -1.0 - 1e-6 <= pose.positions_rad["a"] <= 1.0 + 1e-6
        assert pose.latency_s >= 0.0


@pytest.mark.parametrize("jump_s", [-3600.0, 3600.0, -6e8, 6e8])
def test_a_leader_whose_clock_is_set_is_followed_on(jump_s: float) -> None:
    buffer = JitterBuffer({"pan": 2.0}, max_delay_s=0.0)
    for number in range(100):
        now_s = number / 100
        buffer.add(LeaderSample(now_s + (jump_s if number >= 50 else 0.0), {"pan": now_s}), now_s)
        pose = pose_at(buffer, now_s)
        assert (buffer.age_s(now_s), pose.positions_rad) == (0.0, {"pan": now_s})
        assert abs(pose.velocity_rad_s["pan"]) < 1.1
    assert buffer.take_jump() == ""


ROBOT = so101()
JOINTS = [joint.name for joint in ROBOT.movable_joints]


PAN = ROBOT.joints["shoulder_pan"]


def test_joints_follow_those_of_the_same_name_or_as_the_request_says_and_pan_and_roll_may_be_mirrored() -> None:
    for leader, options, positions_rad, targets_rad in (
        (
            [f"left_{name}" for name in JOINTS],
            {"leader_prefix": "left_"},
            {"left_elbow_flex": 0.3},
            {"elbow_flex": 0.3},
        ),
        (JOINTS, {"scale": 0.5}, {"elbow_flex": 0.4, "gripper": 0.4}, {"elbow_flex": 0.2, "gripper": 0.4}),
        (JOINTS, {}, {"shoulder_pan": 9.0}, {"shoulder_pan": PAN.upper}),
        (JOINTS, {"mirror": True}, {"shoulder_pan": 0.4, "elbow_flex": 0.4}, {"shoulder_pan": -0.4, "elbow_flex": 0.4}),
        (["a", "b"], {"pairs": (["b"], ["wrist_roll"])}, {"a": 0.1, "b": 0.2}, {"wrist_roll": 0.2}),
    ):
        joints = joint_map(ROBOT, "", leader, **options)
        assert joints.targets_rad(positions_rad) == targets_rad
        assert [link.follower for link in joints.links] == (["wrist_roll"] if "pairs" in options else JOINTS)
    assert mirrored_joints(ROBOT) == {"shoulder_pan", "wrist_roll"}


@pytest.mark.parametrize(("pan_rad", "says"), [(45.0, "45.00 rad"), (-2.5, "-2.50 rad"), (2.0, "")])
def test_a_target_far_beyond_the_range_is_named_with_a_hint_at_degrees(pan_rad: float, says: str) -> None:
    found = joint_map(ROBOT, "", JOINTS).beyond_range({"shoulder_pan": pan_rad})
    assert ("the leader's shoulder_pan leads shoulder_pan" in found and "not in degrees" in found) is bool(says)
    assert says in found


def test_a_wrong_map_is_refused() -> None:
    for leader, pairs, scale, said in (
        (["a"], ([], []), 1.0, "leader: has no joint of the follower's"),
        (["a"], (["x"], ["wrist_roll"]), 1.0, "leader_joints: must be of a, not 'x'"),
        (["a"], (["a"], ["x"]), 1.0, "follower_joints: must be of shoulder_pan, .*, not 'x'"),
        (["a"], (["a"], []), 1.0, "follower_joints: must have as many names as leader_joints, 1, not 0"),
        (["a", "b"], (["a", "b"], ["gripper", "gripper"]), 1.0, "follower_joints: must have each joint once"),
        (JOINTS, ([], []), 3.0, "scale: must be above 0 and at most 2, not 3"),
        (JOINTS, ([], []), float("nan"), "scale: must be above 0 and at most 2, not nan"),
    ):
        with pytest.raises(ServiceError, match=said):
            joint_map(ROBOT, "", leader, scale=scale, pairs=pairs)


TOPIC = "/leader/joint_states"


def reading(position_rad: float) -> ArmState:
    at = np.array([position_rad])
    return ArmState(position_rad, Mode.RELAXED, ("elbow_flex",), position_rad=at, velocity_rad_s=at)


class Publishing:
    """A client that publishes the samples that a test shows, on a connection whose pongs the test gives."""

    def __init__(self) -> None:
        self.server, self.told = HeldConnection(), list[str]()
        self.client = LeaderClient(PublishedTopic("ws://nowhere", TOPIC, "secret-of-sixteen"), self.told.append)

    async def show(self, *states: ArmState) -> None:
        for state in states:
            self.client.take_state(state)
            for _ in range(5):
                await asyncio.sleep(0)

    @property
    def positions(self) -> list[float]:
        return [message["position"][0] for message in self.server.messages]


@pytest.fixture
async def publishing() -> AsyncIterator[Publishing]:
    made = Publishing()
    await made.client.announce(made.server)
    task = asyncio.create_task(made.client.publish(made.server))
    yield made
    task.cancel()
    await asyncio.wait([task])


async def test_it_shows_its_token_and_advertises_before_the_first_sample(publishing: Publishing) -> None:
    await publishing.show(*2 * [ArmState(1.0, Mode.DISCONNECTED, ("elbow_flex",), reason="unplugged")])
    assert (publishing.positions, publishing.told) == ([], ["the arm: unplugged"]), "of an arm that is not read"
    await publishing.show(reading(0.5))
    assert [each["op"] for each in publishing.server.sent] == ["auth", "set_level", "advertise", "publish"]
    assert publishing.server.sent[-1]["msg"]["name"] == ["elbow_flex"]
    assert publishing.server.sent[-1]["msg"]["header"]["stamp"] == {"sec": 0, "nanosec": 500_000_000}


async def test_on_a_slow_network_old_samples_are_left_out(publishing: Publishing) -> None:
    await publishing.show(*(reading(number) for number in range(50)))
    assert len(publishing.positions) <= IN_FLIGHT + 2
    publishing.server.pings[0].set_result(0.1)
    await publishing.show(reading(100.0))
    # Those that were on their way, at most one that was waited with, and the newest.
    assert publishing.positions[-1] == 100.0
    assert len(publishing.positions) <= IN_FLIGHT + 4


def test_a_real_leader_needs_a_calibration(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(logs, "configure", lambda *_arguments: None)
    assert cli.main(["leader", "--serial", "/dev/nothing"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("armbridge: --calibration: without one nobody knows where the joints")


REGISTRY = load_registry(())


def message(stamp_s: float, **positions_rad: float) -> dict[str, Any]:
    joints = {"name": list(positions_rad), "position": list(positions_rad.values()), "velocity": [], "effort": []}
    return {"header": {"stamp": time_message(stamp_s), "frame_id": ""}, **joints}


def send(leader: Leader, publisher: Node, msg: dict[str, Any], now_s: float) -> None:
    published = PublishedMessage("/glove", "sensor_msgs/msg/JointState", msg, REGISTRY, now_s, publisher=publisher)
    leader.take_message(published)


def test_a_message_that_cannot_be_followed_is_refused_with_its_field() -> None:
    for change, said in (
        ({"position": []}, "name: must have 1 to 32 joints, as many as position has values, 0, not 1"),
        ({"name": [], "position": []}, "name: must have 1 to 32 joints"),
        ({"name": ["j"] * (MAX_JOINTS + 1), "position": [0.0] * (MAX_JOINTS + 1)}, "name: must have 1 to 32 joints"),
        ({"position": [math.nan]}, "position of elbow: must be a finite number, not nan"),
    ):
        with pytest.raises(ServiceError, match=said):
            read_sample(message(1.0, elbow=0.5) | change, 99.0)
        clock = FakeClock()
        leader = Leader("/glove", {}, clock)
        send(leader, Node("one"), message(1.0, elbow=0.5) | change, clock.now_s)
        assert leader.joint_names == (), change


def test_while_one_client_leads_another_is_not_followed_and_takes_over_after_a_silence() -> None:
    clock, one, other = FakeClock(), Node("one"), Node("other")
    leader = Leader("/glove", {}, clock)
    send(leader, one, message(50.0, elbow=0.1), clock.now_s)
    send(leader, other, message(60.0, elbow=0.9), clock.now_s)
    first = leader.samples.pose(clock.now_s)
    clock.advance(STALE_S + 0.01)
    # Its clock is far behind that of the first.
    send(leader, other, message(10.0, elbow=0.9), clock.now_s)
    second = leader.samples.pose(clock.now_s)
    assert [pose and pose.positions_rad for pose in (first, second)] == [{"elbow": 0.1}, {"elbow": 0.9}]

"""Following: phases, and velocities that keep all limits whatever the leader does."""

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.publication import PublishedMessage
from robot.control.motion import VelocityTracking
from robot.control.pacing import PERIOD_S
from robot.description.limits import JointBounds
from robot.trajectory import TIME_TO_FULL_ACCELERATION_S
from server.datasets.export import ExportOptions, export
from server.datasets.samples import LEADER_TOPIC, STATE_TOPIC
from server.graph.permissions import Node
from server.graph.topics import Subscriber
from server.recording.files import RecordedMessage
from server.teleop.following import FollowerAct, Following, FollowingPhase, TrackingLimits, tracking_velocity
from tests.helpers.arm_rig import NAMES
from tests.helpers.messages import time_message
from tests.helpers.stage import RecordedStage, inline_threads
from tests.server.recordings import REGISTRY, START_NS, entry, record

FRESH, STALE = 0.01, 0.3
TICK_S = 0.01
LIMITS = TrackingLimits(2.0, 6.0)


def following() -> Following:
    one = Following()
    assert [one.tick(0.0, FRESH) for _ in range(3)] == [FollowerAct.RAMP, FollowerAct.NOTHING, FollowerAct.NOTHING]
    one.take_ramp_end("")
    return one


def test_a_ramp_that_fails_ends_it_with_the_cause_and_samples_that_stop_brake_it() -> None:
    one = Following()
    one.tick(0.0, FRESH)
    one.take_ramp_end("the goal collides")
    assert one.ended
    assert "the goal collides" in one.message
    one = Following()
    one.tick(0.0, FRESH)
    assert one.tick(0.5, STALE) is FollowerAct.BRAKE
    one.take_ramp_end("")
    assert one.phase is FollowingPhase.BRAKING


def test_it_follows_after_one_ramp_and_holds_while_the_clutch_is_open_or_when_the_leader_jumps() -> None:
    one = following()
    assert one.tick(0.1, FRESH) is FollowerAct.FOLLOW
    one.set_clutch(closed=True)
    assert one.tick(1.0, FRESH) is FollowerAct.FOLLOW
    assert one.set_clutch(closed=False) is FollowerAct.BRAKE
    assert one.tick(2.0, FRESH) is FollowerAct.NOTHING
    one.set_clutch(closed=True)
    assert one.tick(3.0, FRESH) is FollowerAct.RAMP
    one = following()
    assert one.tick(1.0, FRESH, jump="a jumped") is FollowerAct.BRAKE
    assert one.phase is FollowingPhase.HOLDING
    assert one.message == "a jumped: close the clutch to go on"


@pytest.mark.parametrize("before", ["ramping", "following", "holding"])
def test_a_follower_that_cannot_go_on_ends_once_from_every_phase(before: str) -> None:
    one = Following() if before == "ramping" else following()
    if before == "holding":
        one.set_clutch(closed=False)
    ticks = [one.tick(now_s, FRESH, obstacle="the arm has a fault") for now_s in (1.0, 1.1)]
    assert ticks == [FollowerAct.BRAKE, FollowerAct.NOTHING]
    assert one.message == "the arm has a fault"


class Tracking:
    """A joint between two limits that is steered after a leader, every other tick."""

    def __init__(self, range_rad: float = 2.0) -> None:
        bounds = JointBounds(*(np.array([value]) for value in (-range_rad, range_rad, 2.0, 6.0)))
        self._joint, self._ticks = VelocityTracking(bounds, np.zeros(1)), 0

    def follow(self, place_rad: float, velocity_rad_s: float = 0.0) -> tuple[float, float]:
        """Do a tick; returns position [rad] and velocity [rad/s]."""
        if self._ticks % 2 == 0:
            error_rad = place_rad - float(self._joint.position_rad[0])
            self._joint.set_target(np.array([tracking_velocity(error_rad, velocity_rad_s, LIMITS, 0.0)]))
        self._ticks += 1
        self._joint.advance(TICK_S)
        return float(self._joint.position_rad[0]), float(self._joint.velocity_rad_s[0])


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=40), st.integers(1, 12))
def test_goals_never_jump_however_the_leader_moves(places: list[float], ticks_each: int) -> None:
    jerk = LIMITS.acceleration_rad_s2 / TIME_TO_FULL_ACCELERATION_S
    ticks = [(0.0, 0.0)]
    tracking = Tracking()
    ticks += [tracking.follow(place) for place in places for _ in range(ticks_each)]
    position, velocity = np.array(ticks).T
    acceleration = np.diff(velocity) / TICK_S
    assert np.abs(position).max() <= 2.0 + 1e-6
    assert np.abs(np.diff(position)).max() <= LIMITS.velocity_rad_s * TICK_S + 1e-6
    assert np.abs(acceleration).max() <= LIMITS.acceleration_rad_s2 + 1e-4
    assert np.abs(np.diff(acceleration)).max(initial=0.0) <= jerk * TICK_S * 2.0 + 1e-4


@pytest.mark.parametrize("distance_rad", [0.05, 0.5, 1.5])
def test_a_follower_arrives_at_a_resting_leader_without_swinging_past(distance_rad: float) -> None:
    tracking = Tracking()
    positions = [tracking.follow(distance_rad)[0] for _ in range(400)]
    assert positions[-1] == pytest.approx(distance_rad, abs=2e-3)
    assert max(positions) <= distance_rad + 0.01


def test_a_steady_leader_is_followed_without_lag() -> None:
    tracking = Tracking(9.0)
    positions = [tracking.follow(tick * TICK_S, 1.0)[0] for tick in range(1, 401)]
    assert positions[-1] == pytest.approx(4.0, abs=0.02)


pytestmark = pytest.mark.stepped_time

GRIPPER = NAMES.index("gripper")

# To the leader, and into its rhythm [s].
SETTLED_S = 1.5
LAG_S = 0.1


class Led(RecordedStage):
    """An arm that follows a topic."""

    async def lead(self, seconds: float, gripper_rad: Callable[[float], float]) -> float:
        """Lead by 50 samples a second; returns the last goal of the gripper [rad]."""
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        while (at_s := loop.time() - began_s) < seconds:
            position = [0.1, 0.0, 0.0, 0.0, 0.0, gripper_rad(at_s)]
            sample = {"header": {"stamp": time_message(5.0 + at_s)}, "name": list(NAMES), "position": position}
            self.publish_now("/glove", "sensor_msgs/JointState", sample)
            await asyncio.sleep(2.0 * PERIOD_S)
        return float(self.goals_rad[-1][GRIPPER])


@pytest.fixture
async def led(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Led]:
    inline_threads(monkeypatch)
    async for made in Led().run():
        made.stage.call("/teleop/start", leader="/glove")
        yield made


def opening(at_s: float) -> float:
    """Return the leader's gripper, which opens and closes every 2 s [rad]."""
    return 0.7 - 0.5 * math.cos(2.0 * math.pi * 0.5 * at_s)


async def test_the_gripper_follows_within_a_tenth_of_a_second(led: Led) -> None:
    await led.lead(4.0, opening)
    first = round(SETTLED_S / PERIOD_S)
    goals = np.array(led.goals_rad)[first:, GRIPPER]
    at_s = (np.arange(len(goals)) + first + 1) * PERIOD_S
    behind = np.abs(goals - np.array([opening(each) for each in at_s]))
    # At its fastest the leader goes this far in the time.
    assert behind.max() < LAG_S * 0.5 * 2.0 * math.pi * 0.5
    assert np.ptp(goals) > 0.9


async def test_a_dataset_has_the_gripper_within_a_tenth_of_a_second_of_its_action(led: Led, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra [datasets] is not installed: no pyarrow")
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    recorded: list[RecordedMessage] = []

    def take(published: PublishedMessage) -> None:
        # The wall clock of stamps is no stepped time: without stamps the time of recording counts.
        message = {**published.msg, "header": {}}
        recorded.append(entry(published.topic, "sensor_msgs/JointState", message, loop.time() - began_s))

    for topic in (STATE_TOPIC, LEADER_TOPIC):
        led.stage.graph.subscribe(Node("recorder"), topic, "sensor_msgs/JointState", Subscriber(take))
    await led.lead(SETTLED_S + 4.0, opening)
    recording = record(tmp_path / "run.mcap", [each for each in recorded if each.log_time_ns > START_NS + 1.5e9])
    done = export(ExportOptions([recording], tmp_path / "data", fps=50), REGISTRY, lambda _text: None)
    assert (done.actions, done.problems) == (LEADER_TOPIC, ())
    rows = parquet.read_table(tmp_path / "data/data/chunk-000/file-000.parquet").to_pylist()
    states, actions = (np.array([row[name] for row in rows])[:, GRIPPER] for name in ("observation.state", "action"))
    assert np.ptp(states) > 0.9
    assert np.abs(states - actions).max() < LAG_S * 0.5 * 2.0 * math.pi * 0.5


async def test_a_gripper_that_another_client_moved_follows_when_the_leader_moves_on(led: Led) -> None:
    assert await led.lead(2.0, lambda _at_s: 0.5) == pytest.approx(0.5, abs=0.01)
    command = {"position": 1.0}
    led.stage.send("/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand", command=command)
    assert await led.lead(2.0, lambda _at_s: 0.5) == pytest.approx(1.0, abs=0.01)
    assert await led.lead(1.0, lambda _at_s: 0.6) == pytest.approx(0.6, abs=0.01)


async def test_a_stop_stops_the_gripper(led: Led) -> None:
    await led.lead(2.0, lambda at_s: 0.2 + 0.2 * at_s)
    led.stage.call("/arm/stop")
    held_rad = await led.lead(0.3, lambda at_s: 0.6 + 0.2 * at_s)
    assert await led.lead(1.0, lambda at_s: 0.66 + 0.2 * at_s) == held_rad

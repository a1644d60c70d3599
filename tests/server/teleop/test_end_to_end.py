"""A leader that a scripted hand moves, and a follower, each on its emulated bus, in one server."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robot.calibration import save
from server.teleop.teleoperation import CLUTCH, LEADER_TOPIC, START, STATE_TOPIC, STOP
from tests.helpers.clients import ArmClient, arm_client, values_of
from tests.helpers.robots import nominal_calibration, so101
from tests.helpers.server import EmulatorControl, RunningServer

pytestmark = pytest.mark.real_time

JOINTS = {joint.joint: joint for joint in nominal_calibration().joints}
ROBOT = so101()
TIMEOUT_S = 60.0

# A follower's servos carry the arm, and both have backlash [rad].
BESIDE_RAD = 0.1

CONFIG = """
[server]
port = 0
[access]
control = "shared"
[moveit]
max_velocity_scaling = 1.0
max_acceleration_scaling = 1.0
[arms.leader]
role = "leader"
base_xyz_m = [0.0, 1.5, 0.0]
calibration = "{folder}/leader.json"
emulator.control = "{folder}/leader"
[arms.follower]
emulator.control = "{folder}/follower"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pair")
    save(nominal_calibration(), folder / "leader.json")
    return folder


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[RunningServer]:
    (folder / "pair.toml").write_text(CONFIG.format(folder=folder))
    with RunningServer(f"--config {folder / 'pair.toml'}") as running:
        yield running


class Pair:
    """A client of the server, and the hand at the leader."""

    def __init__(self, client: ArmClient, folder: Path) -> None:
        self.client = client
        self.leader, self.follower = EmulatorControl(folder / "leader"), EmulatorControl(folder / "follower")

    async def lead(self, **to_rad: float) -> None:
        """Move joints of the leader by hand, and wait until they are there."""
        hand = {str(JOINTS[name].servo_id): JOINTS[name].ticks_from_rad(value) for name, value in to_rad.items()}
        await asyncio.to_thread(self.leader.command, hand=hand)
        await self.until(lambda now: all(abs(now[f"leader_{name}"] - value) < 0.03 for name, value in to_rad.items()))

    async def until(self, condition: Any) -> dict[str, float]:
        def holds(states: list[dict[str, Any]]) -> bool:
            return bool(condition(dict(zip(states[-1]["name"], states[-1]["position"], strict=True))))

        latest = (await self.client.until("/joint_states", holds, TIMEOUT_S))[-1]
        return dict(zip(latest["name"], latest["position"], strict=True))

    async def until_beside(self, *names: str) -> dict[str, float]:
        """Wait until joints of the follower are where the leader's are."""
        return await self.until(
            lambda now: all(abs(now[f"leader_{name}"] - now[f"follower_{name}"]) < BESIDE_RAD for name in names)
        )

    async def start(self, **request: Any) -> dict[str, Any]:
        return await self.client.call(START, **{"follower": "follower", "leader": "leader", **request})

    async def until_phase(self, phase: str) -> dict[str, Any]:
        return (await self.client.until(STATE_TOPIC, lambda told: told[-1]["phase"] == phase, TIMEOUT_S))[-1]


@asynccontextmanager
async def at(server: RunningServer, folder: Path) -> AsyncIterator[Pair]:
    async with arm_client(server.url) as client:
        await client.say("subscribe", topic="/joint_states", type="sensor_msgs/JointState")
        await client.say("subscribe", topic=STATE_TOPIC, type="armbridge_msgs/TeleopState")
        for arm in ("leader", "follower"):
            await client.say("subscribe", topic=f"/{arm}/arm/state", type="diagnostic_msgs/DiagnosticStatus")
        yield Pair(client, folder)


@pytest.fixture
async def pair(server: RunningServer, folder: Path) -> AsyncIterator[Pair]:
    async with at(server, folder) as one:
        await one.lead(shoulder_pan=0.0, shoulder_lift=-0.5, elbow_flex=0.5, wrist_flex=0.0, wrist_roll=0.0)
        yield one
        await one.client.call(STOP)
        if len(one.client.topics.get(STATE_TOPIC, ())):
            await one.until_phase("idle")
        async with asyncio.timeout(TIMEOUT_S):
            while not (await one.client.call("/follower/arm/enable"))["success"]:
                await one.client.call("/follower/arm/reset_fault")
                await asyncio.sleep(0.05)


async def test_the_follower_goes_to_its_leader_and_follows_it(pair: Pair) -> None:
    answer = await pair.start()
    assert answer["success"], answer
    await pair.until_phase("following")
    for elbow, pan in ((0.1, 0.3), (0.7, -0.3), (0.4, 0.0)):
        await pair.lead(elbow_flex=elbow, shoulder_pan=pan)
        await pair.until_beside("elbow_flex", "shoulder_pan", "shoulder_lift")


async def test_the_follower_never_jumps(pair: Pair) -> None:
    assert (await pair.start())["success"]
    await pair.until_phase("following")
    topic = "/follower/arm_controller/controller_state"
    await pair.client.say("subscribe", topic=topic, type="control_msgs/JointTrajectoryControllerState")
    await pair.client.until(topic, bool)
    for pan in (0.8, -0.8, 0.0):
        await pair.lead(shoulder_pan=pan)
    await pair.until_beside("shoulder_pan")
    states = pair.client.topics[topic]
    names = states[0]["joint_names"]
    stamps = np.array([each["header"]["stamp"]["sec"] + each["header"]["stamp"]["nanosec"] * 1e-9 for each in states])
    goals = np.array([each["reference"]["positions"] for each in states])
    limits = np.array([ROBOT.joints[name.removeprefix("follower_")].max_velocity for name in names])
    steps = np.abs(np.diff(goals, axis=0))
    # A state is told with a goal up to a tick older or newer than its stamp.
    assert (steps <= limits * (np.diff(stamps)[:, None] + 0.021)).all()


async def test_the_gripper_follows(pair: Pair) -> None:
    await pair.lead(gripper=0.2)
    assert (await pair.start())["success"]
    await pair.until_phase("following")
    await pair.lead(gripper=1.0)
    await pair.until_beside("gripper")


async def test_an_open_clutch_holds_the_follower_and_a_closed_one_takes_it_along(pair: Pair) -> None:
    assert (await pair.start())["success"]
    await pair.until_phase("following")
    before = await pair.until_beside("shoulder_pan")
    assert (await pair.client.call(CLUTCH, data=False))["success"]
    await pair.until_phase("clutch open")
    await pair.lead(shoulder_pan=0.8)
    now = await pair.until(lambda _now: True)
    assert now["follower_shoulder_pan"] == pytest.approx(before["follower_shoulder_pan"], abs=0.05)
    assert (await pair.client.call(CLUTCH, data=True))["success"]
    await pair.until_beside("shoulder_pan")
    await pair.until_phase("following")


async def test_what_is_followed_is_told_for_datasets(pair: Pair) -> None:
    await pair.client.say("subscribe", topic=LEADER_TOPIC, type="sensor_msgs/JointState")
    assert (await pair.start())["success"]
    told = (await pair.client.until(LEADER_TOPIC, bool, TIMEOUT_S))[-1]
    assert "follower_elbow_flex" in told["name"]


@pytest.mark.parametrize("service", [STOP, "/arm/stop", "/follower/arm/stop", "/follower/arm/relax"])
async def test_a_stop_ends_the_following_with_one_answer(pair: Pair, service: str) -> None:
    assert (await pair.start())["success"]
    await pair.until_phase("following")
    pair.client.topics[STATE_TOPIC].clear()
    assert (await pair.client.call(service))["success"]
    ended = await pair.until_phase("idle")
    assert ended["message"]
    assert [each["phase"] for each in pair.client.topics[STATE_TOPIC]].count("idle") == 1


async def test_a_goal_from_elsewhere_takes_the_arm(pair: Pair) -> None:
    assert (await pair.start())["success"]
    await pair.until_phase("following")
    goal = await pair.client.send_goal("/follower/moveit_goal", "armbridge_msgs/action/MoveitGoal", {"named": "home"})
    assert (await pair.client.result(goal))["values"]["success"]
    assert "following was ended" in (await pair.until_phase("idle"))["message"]


async def test_a_leader_that_gets_torque_ends_the_following(pair: Pair) -> None:
    assert (await pair.start())["success"]
    await pair.until_phase("following")
    assert (await pair.client.call("/leader/arm/enable"))["success"]
    assert "the leader leader has torque" in (await pair.until_phase("idle"))["message"]
    refused = await pair.start()
    assert "relax it by /leader/arm/relax" in refused["message"]
    assert (await pair.client.call("/leader/arm/relax"))["success"]
    await pair.client.until("/leader/arm/state", lambda told: values_of(told[-1])["mode"] == "relaxed", TIMEOUT_S)


@pytest.mark.parametrize("bus", ["leader", "follower"])
async def test_a_bus_that_is_lost_ends_the_following_and_the_follower_holds(pair: Pair, bus: str) -> None:
    assert (await pair.start())["success"]
    await pair.until_phase("following")
    control = pair.leader if bus == "leader" else pair.follower
    await asyncio.to_thread(control.command, online=[])
    ended = await pair.until_phase("idle")
    assert ended["message"]
    await asyncio.to_thread(control.command, online=[1, 2, 3, 4, 5, 6])
    async with asyncio.timeout(TIMEOUT_S):
        while not (await pair.client.call(f"/{bus}/arm/reset_fault"))["success"]:
            await asyncio.sleep(0.05)


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"follower": "nobody"}, "there is no arm 'nobody' that may follow"),
        ({"leader": "nobody"}, "must be 'leader', or a topic"),
        ({"leader": "/nothing"}, "nothing comes on /nothing"),
        ({"scale": 9.0}, "scale: must be 0.05 to 5"),
        ({"leader_joints": ["leader_gripper"]}, "leader_joints has 1 joints, and follower_joints 0"),
        ({"leader_joints": ["knee"], "follower_joints": ["elbow_flex"]}, "the leader has no joint 'knee'"),
        ({"leader_joints": ["leader_gripper"], "follower_joints": ["knee"]}, "the follower has no joint 'knee'"),
    ],
)
async def test_what_cannot_be_followed_is_refused_in_one_sentence(
    pair: Pair, request_: dict[str, Any], words: str
) -> None:
    answer = await pair.start(**request_)
    assert not answer["success"]
    assert words in answer["message"]


async def test_a_follower_in_fault_does_not_follow(pair: Pair) -> None:
    assert (await pair.client.call("/follower/arm/emergency_stop"))["success"]
    refused = await pair.start()
    assert not refused["success"]
    assert "has a fault" in refused["message"]

"""A follower on its emulated bus follows an arm that a hand leads, and a client's topic, and ends well."""

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from harness.clients import ArmClient, arm_client, values_of
from harness.server import EmulatorControl, RunningServer
from harness.waiting import TIMEOUT_S
from tests.helpers.messages import time_message
from tests.helpers.robots import so101
from tests.helpers.teleop import follow, is_late, led

JOINTS = tuple(joint.name for joint in so101().movable_joints)
STATE, TOPIC = "/teleop/state", "/glove/joint_states"
MIDDLE_TICK = 2048

CONFIG = """
[server]
port = 0
[moveit]
max_velocity_scaling = 1.0
max_acceleration_scaling = 1.0
[arms.follower]
base_xyz_m = [0.0, 0.4, 0.0]
emulator.control = "{folder}/follower"
[arms.leader]
role = "leader"
base_xyz_m = [0.0, -0.4, 0.0]
emulator.control = "{folder}/leader"
"""


PAIR = {"follower": "follower", "leader": "leader"}


@pytest.fixture
def hand(folder: Path) -> Iterator[EmulatorControl]:
    """The hand that leads; it holds the leader straight when it is let go of."""
    one = EmulatorControl(folder / "leader")
    one.command(hand={"1": MIDDLE_TICK, "5": MIDDLE_TICK})
    yield one
    one.command(hand={"1": MIDDLE_TICK, "5": MIDDLE_TICK})


@pytest.fixture
async def client(server: RunningServer, hand: EmulatorControl) -> AsyncIterator[ArmClient]:
    async with arm_client(server.url) as one:
        await one.say("subscribe", topic="/joint_states", type="sensor_msgs/JointState")
        await one.say("subscribe", topic="/follower/arm/state", type="diagnostic_msgs/DiagnosticStatus")
        await one.say("subscribe", topic=STATE, type="armbridge_msgs/TeleopState")
        yield one
        await one.call("/teleop/stop")
        await recovers(one)
        await one.call("/arm/release_control")


async def recovers(client: ArmClient) -> None:
    """Bring the follower back to holding; a bus that was lost is found again a little later."""
    async with asyncio.timeout(TIMEOUT_S):
        while values_of(client.topics["/follower/arm/state"][-1])["mode"] not in ("holding", "moving"):
            await client.call("/follower/arm/reset_fault")
            await client.call("/follower/arm/enable")
            await asyncio.sleep(0.1)


async def phase_is(client: ArmClient, phase: str) -> dict[str, Any]:
    return (await client.until(STATE, lambda states: states[-1]["phase"] == phase))[-1]


@asynccontextmanager
async def glove(client: ArmClient, places: dict[str, float]) -> AsyncIterator[asyncio.Task[None]]:
    """Samples of a leader elsewhere, whose places [rad] the test changes."""
    await client.say("advertise", topic=TOPIC, type="sensor_msgs/JointState")

    async def send() -> None:
        while True:
            header = {"stamp": time_message(time.time())}
            msg = {"header": header, "name": list(places), "position": list(places.values())}
            await client.say("publish", topic=TOPIC, msg=msg)
            await asyncio.sleep(0.01)

    sending = asyncio.create_task(send())
    try:
        yield sending
    finally:
        sending.cancel()
        with suppress(asyncio.CancelledError):
            await sending


async def test_the_follower_goes_where_a_hand_leads_the_leader(client: ArmClient, hand: EmulatorControl) -> None:
    await follow(client, "/teleop", **PAIR)
    await client.say("subscribe", topic="/teleop/leader_joint_states", type="sensor_msgs/JointState")

    def is_followed(now: dict[str, float]) -> bool:
        leader_rad, follower_rad = (now[f"{arm}_shoulder_pan"] for arm in ("leader", "follower"))
        return abs(leader_rad) >= 0.3 and abs(follower_rad - leader_rad) < 0.06

    for ticks in (300, -300):
        hand.command(hand={"1": MIDDLE_TICK + ticks})
        await led(client, is_followed, **PAIR)
    targets = (await client.until("/teleop/leader_joint_states", bool))[-1]
    assert set(targets["name"]) == {f"follower_{name}" for name in JOINTS}


async def test_a_leader_by_topic_is_followed_and_its_silence_ends_it(client: ArmClient) -> None:
    places = dict.fromkeys(JOINTS, 0.0)

    def is_turned(now: dict[str, float]) -> bool:
        places["wrist_roll"] = min(places["wrist_roll"] + 0.01, 0.5)
        return now["follower_wrist_roll"] >= 0.4

    async with glove(client, places):
        await follow(client, "/teleop", follower="follower", leader=TOPIC)
        await led(client, is_turned, follower="follower", leader=TOPIC)
    ended = await phase_is(client, "idle")
    assert ended["message"] == "the leader has sent nothing for 2 s"
    assert "braking" in [state["phase"] for state in client.topics[STATE]]
    resting = (await client.positions())["follower_wrist_roll"]
    assert (await client.positions())["follower_wrist_roll"] == pytest.approx(resting, abs=0.02)


@pytest.mark.parametrize("service", ["/arm/stop", "/follower/arm/stop", "/teleop/stop"])
async def test_every_stop_ends_the_following(client: ArmClient, service: str) -> None:
    await follow(client, "/teleop", **PAIR)
    while (await client.call(service))["success"] and is_late((await phase_is(client, "idle"))["message"]):
        await follow(client, "/teleop", **PAIR)
    assert "stopped" in client.topics[STATE][-1]["message"]
    assert (await client.call("/teleop/stop"))["message"] == "no arm follows: call /teleop/start"


async def test_a_goal_from_elsewhere_ends_the_following(client: ArmClient) -> None:
    await follow(client, "/teleop", **PAIR)
    await client.goal("/follower/moveit_goal_named", "std_msgs/String", {"data": "ready"})
    assert (await phase_is(client, "idle"))["message"]


async def test_a_relaxed_follower_does_not_begin(client: ArmClient) -> None:
    assert (await client.call("/follower/arm/relax"))["success"]
    await client.until("/follower/arm/state", lambda states: values_of(states[-1])["mode"] == "relaxed")
    refused = await client.call("/teleop/start", follower="follower", leader="leader")
    assert refused["message"].startswith("follower cannot follow: the arm follower is relaxed")


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        ({"follower": "other", "leader": "leader"}, "follower: must be one of follower, not 'other'"),
        ({"follower": "", "leader": "follower"}, "leader: must be an arm that leads (leader) or a topic"),
        ({"follower": "", "leader": "/silent"}, "leader: /silent has sent nothing for 1 s"),
        ({"follower": "", "leader": "/joint_states"}, "leader: must not be /joint_states"),
    ],
)
async def test_an_impossible_following_is_refused(client: ArmClient, request_: dict[str, Any], said: str) -> None:
    refused = await client.call("/teleop/start", **request_)
    assert not refused["success"]
    assert refused["message"].startswith(said)

"""Two followers of one leader: each has its own beginning, clutch and end."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from harness.clients import ArmClient, arm_client
from harness.server import EmulatorControl, RunningServer
from tests.helpers.teleop import follow, led

CONFIG = """
[server]
port = 0
[moveit]
max_velocity_scaling = 1.0
max_acceleration_scaling = 1.0
[arms.left]
base_xyz_m = [0.0, 0.7, 0.0]
[arms.right]
base_xyz_m = [0.0, -0.7, 0.0]
[arms.leader]
role = "leader"
emulator.control = "{folder}/leader"
"""
MIDDLE_TICK = 2048
TARGETS = "/teleop/leader_joint_states"


@pytest.fixture
async def client(server: RunningServer, folder: Path) -> AsyncIterator[ArmClient]:
    # Held, as else it sinks below its limits in a while.
    EmulatorControl(folder / "leader").command(hand={str(servo): MIDDLE_TICK for servo in range(1, 6)})
    async with arm_client(server.url) as one:
        await one.say("subscribe", topic="/joint_states", type="sensor_msgs/JointState")
        await one.say("subscribe", topic=TARGETS, type="sensor_msgs/JointState")
        for arm in ("left", "right"):
            await one.say("subscribe", topic=f"/{arm}/teleop/state", type="armbridge_msgs/TeleopState")
        yield one
        await one.call("/teleop/stop")
        for arm in ("left", "right"):
            await phase_is(one, arm, "idle")


async def phase_is(client: ArmClient, arm: str, phase: str) -> str:
    """Wait for a phase of one follower; returns its message."""
    states = await client.until(f"/{arm}/teleop/state", lambda states: states[-1]["phase"] == phase)
    return str(states[-1]["message"])


async def both_follow(client: ArmClient) -> None:
    for arm in ("left", "right"):
        await follow(client, f"/{arm}/teleop", leader="leader")


async def rolled(client: ArmClient, *arms: str) -> None:
    """Wait until the wrists of some arms are turned."""
    for arm in arms:
        await led(client, lambda now, arm=arm: now[f"{arm}_wrist_roll"] >= 0.4, f"/{arm}/teleop", leader="leader")


async def test_two_arms_follow_one_leader_at_the_same_time(client: ArmClient, folder: Path) -> None:
    await both_follow(client)
    EmulatorControl(folder / "leader").command(hand={"5": MIDDLE_TICK + 300})
    await rolled(client, "left", "right")
    targets = await client.until(TARGETS, lambda told: len(told[-1]["name"]) == 12)
    assert {name.split("_")[0] for name in targets[-1]["name"]} == {"left", "right"}


async def test_an_end_of_one_following_lets_the_other_go_on(client: ArmClient, folder: Path) -> None:
    await both_follow(client)
    ended = await client.call("/left/teleop/stop")
    assert ended["message"] == "left follows no more"
    assert await phase_is(client, "left", "idle") == "stopped by a client"
    EmulatorControl(folder / "leader").command(hand={"5": MIDDLE_TICK + 300})
    await rolled(client, "right")
    assert not (await client.call("/left/teleop/stop"))["success"]


async def test_a_clutch_is_that_of_one_follower_or_of_all(client: ArmClient) -> None:
    await both_follow(client)
    assert (await client.call("/right/teleop/clutch", data=False))["message"] == "right holds"
    assert await phase_is(client, "right", "holding") == "the clutch is open"
    # A following that a starved process has ended meanwhile is begun again.
    states = client.topics["/left/teleop/state"]
    await led(client, lambda _now: states[-1]["phase"] == "following", "/left/teleop", leader="leader")
    assert (await client.call("/teleop/clutch", data=False))["message"] == "left and right hold"
    await phase_is(client, "left", "holding")
    assert (await client.call("/teleop/clutch", data=True))["message"] == "left and right go to where the leader is"
    for arm in ("left", "right"):
        await phase_is(client, arm, "following")


async def test_a_follower_follows_one_leader_and_an_arm_is_started_by_its_own_name_alone(client: ArmClient) -> None:
    await follow(client, "/left/teleop", leader="leader")
    again = await client.call("/teleop/start", follower="left", leader="leader")
    assert again["message"] == "left follows leader: call /teleop/stop first"
    other = await client.call("/left/teleop/start", follower="right", leader="leader")
    assert other["message"] == "follower: must be one of left, not 'right'"
    unnamed = await client.call("/teleop/start", leader="leader")
    assert unnamed["message"] == "follower: must be one of left, right, not ''"

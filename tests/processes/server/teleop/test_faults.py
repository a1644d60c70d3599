"""Faults on either bus while an arm follows, drawn by seed: no jump of the follower, and one end that is told."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.clients import ArmClient, arm_client, values_of
from harness.server import FAST_ARMS, ROOT, EmulatorControl, RunningServer
from tests.helpers.robots import so101
from tests.helpers.teleop import follow

STATE, CONTROLLER = "/teleop/state", "/follower/arm_controller/controller_state"
TIMEOUT_S = 60.0
SERVOS = [1, 2, 3, 4, 5, 6]
MIDDLE_TICK = 2048
ROBOT = so101()

# What can happen to a bus, and how it is mended.
FAULTS: dict[str, dict[str, Any]] = {
    "one servo is silent": {"offline": [3]},
    "all servos are silent": {"offline": SERVOS},
    "replies are lost": {"drop": 0.6},
    "replies are wrong": {"corrupt": 0.6},
}
MENDED = {"online": SERVOS, "drop": 0.0, "corrupt": 0.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("buses")


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[RunningServer]:
    buses = {f"ARMBRIDGE_ARMS__{arm.upper()}__EMULATOR__CONTROL": str(folder / arm) for arm in ("leader", "follower")}
    settings = {**FAST_ARMS, **buses, "ARMBRIDGE_ACCESS__CONTROL": "shared"}
    with RunningServer(f"--port 0 --config {ROOT / 'examples' / 'leader_follower.toml'}", settings) as running:
        yield running


async def mended(client: ArmClient, folder: Path) -> None:
    """Mend both buses, and have the follower hold and the leader be relaxed again."""
    for arm in ("leader", "follower"):
        await asyncio.to_thread(EmulatorControl(folder / arm).command, **MENDED)
    async with asyncio.timeout(TIMEOUT_S):
        for arm, mode in (("leader", "relaxed"), ("follower", "holding")):
            while values_of(client.topics[f"/{arm}/arm/state"][-1])["mode"] != mode:
                await client.call(f"/{arm}/arm/reset_fault")
                await client.call(f"/{arm}/arm/{'enable' if mode == 'holding' else 'relax'}")
                await asyncio.sleep(0.05)


def assert_no_jump(states: list[dict[str, Any]]) -> None:
    """The goals of the arm never go faster than its joints may."""
    names = states[0]["joint_names"]
    stamps_s = np.array([each["header"]["stamp"]["sec"] + each["header"]["stamp"]["nanosec"] * 1e-9 for each in states])
    goals_rad = np.array([each["reference"]["positions"] for each in states])
    limits = np.array([ROBOT.joints[name.removeprefix("follower_")].max_velocity for name in names])
    # A goal may be a tick older or newer than the stamp of its state.
    allowed_rad = limits * (np.maximum(np.diff(stamps_s), 0.0)[:, None] + 0.021)
    assert (np.abs(np.diff(goals_rad, axis=0)) <= allowed_rad).all()


@pytest.mark.parametrize("seed", range(6))
async def test_a_fault_ends_the_following_once_without_a_jump(server: RunningServer, folder: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    bus = ("leader", "follower")[seed % 2]
    fault = sorted(FAULTS)[int(random.integers(len(FAULTS)))]
    async with arm_client(server.url) as client:
        await client.say("subscribe", topic=STATE, type="armbridge_msgs/TeleopState")
        await client.say("subscribe", topic=CONTROLLER, type="control_msgs/JointTrajectoryControllerState")
        for arm in ("leader", "follower"):
            await client.say("subscribe", topic=f"/{arm}/arm/state", type="diagnostic_msgs/DiagnosticStatus")
            await client.until(f"/{arm}/arm/state", bool)
        await mended(client, folder)
        hand = EmulatorControl(folder / "leader")
        await follow(client, "/teleop", follower="", leader="leader")
        client.topics[STATE].clear()
        swing = MIDDLE_TICK + int(random.integers(-400, 400))
        await asyncio.to_thread(hand.command, hand={"1": swing})
        await asyncio.sleep(float(random.uniform(0.0, 0.5)))
        await asyncio.to_thread(EmulatorControl(folder / bus).command, **FAULTS[fault])
        # A lost leader ends the following after ten states (2 s). Some lost replies are borne: then a stop ends it.
        many = len(client.topics[STATE]) + 20
        told = await client.until(STATE, lambda told: told[-1]["phase"] == "idle" or len(told) > many, TIMEOUT_S)
        if told[-1]["phase"] != "idle":
            await client.call("/teleop/stop")
            await client.until(STATE, lambda told: told[-1]["phase"] == "idle", TIMEOUT_S)
        ends = [each for each in client.topics[STATE] if each["phase"] == "idle"]
        assert len(ends) == 1, (fault, bus, ends)
        assert ends[0]["message"]
        assert_no_jump(client.topics[CONTROLLER])
        await mended(client, folder)

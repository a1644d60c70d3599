"""A leader at another machine, and a follower of it over a real socket."""

import asyncio
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from harness.clients import ArmClient, arm_client
from harness.server import FAST, ROOT, EmulatorControl, ServerOnBus, free_port, server_on_bus
from harness.waiting import TIMEOUT_S, running
from server.teleop.teleoperation import START, STATE_TOPIC, STOP
from tests.helpers.robots import nominal_calibration

JOINTS = {joint.joint: joint for joint in nominal_calibration().joints}


TOPIC = "/leader/joint_states"


@pytest.fixture
def follower() -> Iterator[ServerOnBus]:
    with server_on_bus(**{key.removeprefix("ARMBRIDGE_"): value for key, value in FAST.items()}) as running:
        yield running


def leader(url: str, control: Path) -> AbstractContextManager[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "server.cli", "leader", "--connect", url, "--emulator-control", str(control)]
    return running(command, cwd=ROOT, stderr=subprocess.PIPE)


async def elbow_at(client: ArmClient, position_rad: float) -> None:
    def there(states: list[dict[str, Any]]) -> bool:
        return abs(states[-1]["position"][states[-1]["name"].index("elbow_flex")] - position_rad) < 0.1

    await client.until("/joint_states", there)


async def test_an_arm_follows_a_leader_at_another_machine_and_holds_when_it_is_gone(
    follower: ServerOnBus, tmp_path: Path
) -> None:
    control = tmp_path / "control"
    elbow = JOINTS["elbow_flex"]
    async with arm_client(follower.server.url) as client:
        await client.say("subscribe", topic="/joint_states", type="sensor_msgs/JointState")
        await client.say("subscribe", topic=STATE_TOPIC, type="armbridge_msgs/TeleopState")
        await client.say("subscribe", topic=TOPIC, type="sensor_msgs/JointState")
        with leader(f"ws://127.0.0.1:{follower.server.port}", control) as process:
            hand = EmulatorControl(control)
            await client.until(TOPIC, bool)
            await asyncio.to_thread(hand.command, hand={str(elbow.servo_id): elbow.ticks_from_rad(0.4)})
            answer = await client.call(START, follower="", leader=TOPIC)
            assert answer["success"], answer
            await elbow_at(client, 0.4)
            await asyncio.to_thread(hand.command, hand={str(elbow.servo_id): elbow.ticks_from_rad(-0.2)})
            await elbow_at(client, -0.2)
            process.kill()
            process.wait(TIMEOUT_S)
        ended = await client.until(STATE_TOPIC, lambda told: told[-1]["phase"] == "idle")
        assert ended[-1]["message"]
        await client.until_mode("holding")
        await client.call(STOP)


def test_without_a_server_it_says_so_tries_again_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    with leader(f"ws://127.0.0.1:{free_port()}", tmp_path / "control") as process:
        assert process.stderr is not None
        for line in process.stderr:
            if "trying again in" in line:
                break
        process.send_signal(signal.SIGINT)
        assert process.wait(TIMEOUT_S) == 0

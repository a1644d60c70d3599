"""A leader at another machine, and a follower of it over a real socket."""

import asyncio
import signal
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path

from harness.clients import ArmClient
from harness.server import ROOT, EmulatorControl, ServerOnBus, free_port
from harness.waiting import TIMEOUT_S, running
from server.teleop.teleoperation import STATE_TOPIC
from tests.helpers.robots import nominal_calibration
from tests.helpers.teleop import follow, led

TOPIC = "/leader/joint_states"


def leader(url: str, control: Path) -> AbstractContextManager[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "server.cli", "leader", "--connect", url, "--emulator-control", str(control)]
    return running(command, cwd=ROOT, stderr=subprocess.PIPE)


async def test_an_arm_follows_a_leader_at_another_machine_and_holds_when_it_is_gone(
    client: ArmClient, served: ServerOnBus, tmp_path: Path
) -> None:
    elbow = next(joint for joint in nominal_calibration().joints if joint.joint == "elbow_flex")
    await client.subscribe(STATE_TOPIC, "armbridge_msgs/TeleopState")
    await client.subscribe(TOPIC, "sensor_msgs/JointState")

    def lead(position_rad: float) -> None:
        hand = {str(elbow.servo_id): elbow.ticks_from_rad(position_rad)}
        EmulatorControl(tmp_path / "control").command(hand=hand)

    async def elbow_at(position_rad: float) -> None:
        await led(client, lambda now: abs(now["elbow_flex"] - position_rad) < 0.1, follower="", leader=TOPIC)

    with leader(f"ws://127.0.0.1:{served.server.port}", tmp_path / "control") as process:
        await client.until(TOPIC, bool)
        await asyncio.to_thread(lead, 0.4)
        await follow(client, "/teleop", follower="", leader=TOPIC)
        await elbow_at(0.4)
        await asyncio.to_thread(lead, -0.2)
        await elbow_at(-0.2)
        process.kill()
        process.wait(TIMEOUT_S)
    ended = await client.until(STATE_TOPIC, lambda told: told[-1]["phase"] == "idle")
    assert ended[-1]["message"]
    await client.until_mode("holding")


def test_without_a_server_it_says_so_tries_again_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    with leader(f"ws://127.0.0.1:{free_port()}", tmp_path / "control") as process:
        assert process.stderr is not None
        assert any("trying again in" in line for line in process.stderr)
        process.send_signal(signal.SIGINT)
        assert process.wait(TIMEOUT_S) == 0

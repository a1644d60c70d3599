"""Survival of everything else when a process dies or hangs, at the start, in the middle and at the end."""

import asyncio
import json
import os
import signal
import socket
import subprocess
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from websockets.asyncio.client import ClientConnection, connect

from harness.clients import FrameClient, frame_client, goal_is
from harness.server import ROOT, RunningServer, ServerOnBus, free_port, run_command, server_on_bus
from harness.waiting import running, until

RESULT = "/moveit_goal_result"
STATE = "/arm/state"
FAR = {"name": ["shoulder_pan"], "position": [1.5]}
NEAR = {"name": ["shoulder_pan"], "position": [0.2]}

# A process that dies is replaced, or a fault reported, within a second or two; a busy machine takes longer.
RECOVERY_S = 20.0

# Longer than any limit that a real arm has, and shorter than what counts as a process's death [s].
STARVED_S = 3.5

# Motions may take little longer than planned: one that stands still for so long would be given up by the wall clock.
HASTE = {"MOVEIT__ALLOWED_EXECUTION_DURATION_SCALING": "1", "MOVEIT__ALLOWED_GOAL_DURATION_MARGIN": "1.5"}
ARRIVAL_S = 30.0

HALF_WAY_RAD = 0.5


@pytest.fixture(scope="module")
def on_bus() -> Iterator[ServerOnBus]:
    with server_on_bus(ACCESS__CONTROL="shared", **HASTE) as running:
        yield running


@pytest.fixture
def server(on_bus: ServerOnBus) -> RunningServer:
    return on_bus.server


@pytest.fixture
async def client(server: RunningServer) -> AsyncIterator[FrameClient]:
    async with frame_client(server.url) as before:
        # Where the test before left the arm, the next motion would be none.
        await before.open_goals()
        await reaches(before)
    async with frame_client(server.url) as connected:
        await connected.open_goals()
        await connected.subscribe(STATE, "diagnostic_msgs/DiagnosticStatus")
        yield connected


def child_of(server: RunningServer, module: str) -> psutil.Process:
    children = psutil.Process(server.process.pid).children(recursive=True)
    return next(child for child in children if module in child.cmdline())


async def moving(client: FrameClient) -> None:
    await client.publish("/moveit_goal_joints", FAR)
    await client.until("/moveit_goal_status", goal_is("executing"))


async def reaches(client: FrameClient) -> None:
    result = await client.reach("/moveit_goal_joints", NEAR)
    assert result["val"] == 1, result


async def told(client: FrameClient, words: str, timeout_s: float) -> None:
    """Wait until the arm's state says something."""
    await client.until(STATE, lambda all_: words in all_[-1]["message"], timeout_s)


async def test_servos_that_are_gone_are_found_again_and_can_be_moved(on_bus: ServerOnBus, client: FrameClient) -> None:
    await moving(client)
    on_bus.emulator.command(plugged=False)
    result = (await client.until(RESULT, bool, RECOVERY_S))[-1]
    assert (result["val"], "lost" in result["message"]) == (-25, True)
    await told(client, "the arm is not connected", RECOVERY_S)
    await asyncio.to_thread(on_bus.emulator.command, plugged=True)
    await told(client, "the arm holds", 2 * RECOVERY_S)
    await reaches(client)


async def test_an_arm_process_that_dies_costs_its_goal_and_comes_back_with_its_joints_where_they_were(
    server: RunningServer, client: FrameClient
) -> None:
    await client.subscribe("/joint_states", "sensor_msgs/JointState")
    await moving(client)
    await client.until("/joint_states", lambda all_: all_[-1]["position"][0] > HALF_WAY_RAD)
    child_of(server, "robot.control.loop").kill()
    result = (await client.until(RESULT, bool, RECOVERY_S))[-1]
    assert result["val"] == -25
    await told(client, "the arm holds", 2 * RECOVERY_S)
    seen = len(client.messages("/joint_states"))
    state = (await client.until("/joint_states", lambda all_: len(all_) > seen))[-1]
    assert HALF_WAY_RAD < state["position"][0] < FAR["position"][0]
    await reaches(client)


def says_busy(diagnostics: list[dict[str, Any]]) -> bool:
    """Look at all messages: several may come before the next look."""
    return any("this machine is busy" in each["status"][0]["message"] for each in diagnostics)


async def test_a_simulated_arm_that_stands_still_for_seconds_reaches_its_goal_and_says_that_it_is_slow(
    server: RunningServer, client: FrameClient
) -> None:
    await client.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    await moving(client)
    arm = child_of(server, "robot.control.loop")
    arm.suspend()
    await asyncio.sleep(STARVED_S)
    assert client.messages(RESULT) == []
    arm.resume()
    await client.until("/diagnostics", says_busy)
    result = (await client.until(RESULT, bool, ARRIVAL_S))[-1]
    assert (result["val"], result["message"]) == (1, "the arm is there")
    await reaches(client)


async def test_a_server_that_stands_still_for_seconds_does_not_cost_its_simulated_arms_goal(
    server: RunningServer, client: FrameClient
) -> None:
    await moving(client)
    os.kill(server.process.pid, signal.SIGSTOP)
    await asyncio.sleep(STARVED_S)
    os.kill(server.process.pid, signal.SIGCONT)
    result = (await client.until(RESULT, bool, ARRIVAL_S))[-1]
    assert (result["val"], result["message"]) == (1, "the arm is there")
    await reaches(client)


async def test_a_simulated_arm_that_is_silent_for_more_than_five_seconds_is_replaced_and_its_goal_answered(
    server: RunningServer, client: FrameClient
) -> None:
    await moving(client)
    arm = child_of(server, "robot.control.loop")
    arm.suspend()
    suspended_s = time.monotonic()
    result = (await client.until(RESULT, bool, 5.0 + RECOVERY_S))[-1]
    assert result["_at_s"] - suspended_s > 5.0
    assert (result["val"], "the arm process ended" in result["message"]) == (-25, True)
    assert await asyncio.to_thread(server.has_logged, "the arm process has been silent for 5 s and is ended")
    await told(client, "the arm holds", 2 * RECOVERY_S)
    await reaches(client)


async def test_neither_a_hung_arm_nor_hung_planners_nor_a_deaf_client_hold_up_the_end() -> None:
    with RunningServer() as server:
        children = psutil.Process(server.process.pid).children(recursive=True)
        deaf = await deaf_client(server.url)
        async with frame_client(server.url) as client:
            await client.open_goals()
            await moving(client)
            for child in children:
                child.suspend()
            code, seconds = await asyncio.to_thread(server.end, signal.SIGTERM)
            assert [result["val"] for result in client.messages(RESULT)] == [-7]
            await client.websocket.wait_closed()
            assert client.websocket.close_code == 1001
        deaf.transport.abort()
    # Far more than it waits for them, and far less than a planner would keep it.
    assert (code, seconds < 30.0) == (0, True)
    _, alive = await asyncio.to_thread(psutil.wait_procs, children, timeout=30)
    assert not alive
    assert server.has_logged("the arm process does not end and is killed")


async def deaf_client(url: str) -> ClientConnection:
    """A client that subscribes and never reads."""
    deaf = await connect(url)
    await deaf.send(json.dumps({"op": "subscribe", "topic": "/joint_states"}))
    deaf.transport.pause_reading()
    return deaf


# Python runs a module of this name at its start: the arm process waits there for a file.
WAITING_ARM = """
import pathlib, sys, time
while "robot.control.loop" in sys.orig_argv and not pathlib.Path(__file__).with_name("begin").exists():
    time.sleep(0.01)
"""


async def test_a_server_answers_before_its_arm_is_ready_and_a_goal_waits_for_it(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(WAITING_ARM)
    port = free_port()
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    with running(run_command(f"--port {port}"), cwd=ROOT, stderr=subprocess.DEVNULL, env=environment) as process:
        async with frame_client(await until_open(port)) as client:
            await client.open_goals()
            await client.subscribe(STATE, "diagnostic_msgs/DiagnosticStatus")
            first = (await client.until(STATE, bool))[0]
            assert first["message"] == "the arm is not connected: the arm process is starting"
            await client.publish("/moveit_goal_joints", NEAR)
            await client.until("/moveit_goal_status", bool)
            (tmp_path / "begin").touch()
            assert (await client.until(RESULT, bool))[0]["val"] == 1
        process.terminate()
        assert await asyncio.to_thread(process.wait, 30.0) == 0


async def test_a_server_that_was_killed_can_be_started_again_at_once(server: RunningServer) -> None:
    server.end(signal.SIGKILL)
    with RunningServer(f"--port {server.port}") as restarted:
        async with frame_client(restarted.url) as client:
            await client.open_goals()
            await reaches(client)


async def until_open(port: int, timeout_s: float = 60.0) -> str:
    """The URL of a server that is starting, once its port is there."""

    def is_open() -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    await until(is_open, timeout_s)
    return f"ws://127.0.0.1:{port}"

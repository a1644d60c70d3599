"""What becomes of everybody else when a process dies or hangs, at the start, in the middle and at the end."""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import time
from collections.abc import AsyncIterator, Iterator

import psutil
import pytest
from websockets.asyncio.client import ClientConnection, connect

from tests.helpers.client import FrameClient, frame_client, goal_is
from tests.helpers.server import ROOT, RunningServer, free_port, run_command

RESULT = "/moveit_goal_result"
STATE = "/arm/state"
FAR = {"name": ["shoulder_pan"], "position": [1.5]}
NEAR = {"name": ["shoulder_pan"], "position": [0.2]}

# A process that dies is replaced, or a fault told, within so long.
RECOVERY_S = 2.0


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with RunningServer(settings={"ARMBRIDGE_ACCESS__CONTROL": "shared"}) as running:
        yield running


@pytest.fixture
async def client(server: RunningServer) -> AsyncIterator[FrameClient]:
    async with frame_client(server.url) as connected:
        await connected.open_goals()
        await connected.subscribe(STATE, "diagnostic_msgs/DiagnosticStatus")
        yield connected


def child_of(server: RunningServer, module: str) -> psutil.Process:
    children = psutil.Process(server.process.pid).children(recursive=True)
    return next(child for child in children if module in child.cmdline())


async def moving(client: FrameClient) -> None:
    await client.publish("/moveit_goal_joints", FAR)
    await client.wait_for("/moveit_goal_status", goal_is("executing"))


async def reaches(client: FrameClient) -> None:
    result = await client.goal("/moveit_goal_joints", NEAR)
    assert result["val"] == 1, result


async def told(client: FrameClient, words: str, timeout_s: float) -> None:
    """Wait until the arm's state says something."""
    await client.wait_for(STATE, lambda all_: bool(all_) and words in all_[-1]["message"], timeout_s)


async def test_a_simulated_arm_that_dies_is_told_replaced_and_can_be_enabled(
    server: RunningServer, client: FrameClient
) -> None:
    await moving(client)
    child_of(server, "robot.emulator").kill()
    result = (await client.wait_for(RESULT, bool, RECOVERY_S))[-1]
    assert (result["val"], "lost" in result["message"]) == (-25, True)
    await told(client, "relaxed; /arm/enable makes it hold", 2 * RECOVERY_S)
    async with connect(server.url) as other:
        await other.send(json.dumps({"op": "call_service", "service": "/arm/enable"}))
        assert json.loads(await asyncio.wait_for(other.recv(), RECOVERY_S))["values"]["success"]
    await told(client, "the arm holds", RECOVERY_S)
    await reaches(client)


async def test_an_arm_process_that_dies_costs_its_goal_and_comes_back(
    server: RunningServer, client: FrameClient
) -> None:
    await moving(client)
    child_of(server, "robot.control.loop").kill()
    result = (await client.wait_for(RESULT, bool, RECOVERY_S))[-1]
    assert result["val"] == -25
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
                if "robot.emulator" not in child.cmdline():
                    child.suspend()
            code, seconds = await asyncio.to_thread(server.end, signal.SIGTERM)
            assert [result["val"] for result in client.messages(RESULT)] == [-7]
            await client.websocket.wait_closed()
            assert client.websocket.close_code == 1001
        deaf.transport.abort()
    assert (code, seconds < 3.0) == (0, True)
    _, alive = await asyncio.to_thread(psutil.wait_procs, children, timeout=2)
    assert not alive
    assert server.has_logged("stopping: the arm did not end within")


async def deaf_client(url: str) -> ClientConnection:
    """A client that subscribes and never reads."""
    deaf = await connect(url)
    await deaf.send(json.dumps({"op": "subscribe", "topic": "/joint_states"}))
    deaf.transport.pause_reading()
    return deaf


async def test_a_server_answers_before_its_arm_is_ready_and_a_goal_waits_for_it() -> None:
    port = free_port()
    command = run_command(f"--port {port}")
    process = await asyncio.create_subprocess_exec(*command, cwd=ROOT, stderr=subprocess.DEVNULL)
    async with frame_client(await until_open(port)) as client:
        await client.open_goals()
        await client.subscribe(STATE, "diagnostic_msgs/DiagnosticStatus")
        first = (await client.wait_for(STATE, bool))[0]
        assert first["message"] == "the arm is not connected: the arm process is starting"
        await reaches(client)
    process.terminate()
    assert await asyncio.wait_for(process.wait(), 5.0) == 0


async def test_a_server_that_was_killed_can_be_started_again_at_once(server: RunningServer) -> None:
    server.end(signal.SIGKILL)
    with RunningServer(f"--port {server.port}") as restarted:
        async with frame_client(restarted.url) as client:
            await client.open_goals()
            await reaches(client)


async def until_open(port: int, timeout_s: float = 20.0) -> str:
    """The URL of a server that is starting, once its port is there."""
    until_s = time.monotonic() + timeout_s
    while time.monotonic() < until_s:
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            await asyncio.sleep(0.01)
        else:
            writer.close()
            return f"ws://127.0.0.1:{port}"
    raise AssertionError("the port never opened")

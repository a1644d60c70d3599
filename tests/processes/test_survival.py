"""Survival of everything else when a process dies or hangs, at the start, in the middle and at the end."""

import asyncio
import json
import os
import signal
import subprocess
from pathlib import Path

import psutil
from websockets.asyncio.client import connect

from harness.clients import arm_client, frame_client, goal_is
from harness.server import ROOT, RunningServer, free_port, run_command
from harness.waiting import TIMEOUT_S, running, until
from tests.helpers.resources import is_open

RESULT = "/moveit_goal_result"
STATE = "/arm/state"
NEAR = {"name": ["shoulder_pan"], "position": [0.2]}


async def test_neither_a_hung_arm_nor_hung_planners_nor_a_deaf_client_hold_up_the_end() -> None:
    with RunningServer() as server:
        children = psutil.Process(server.process.pid).children(recursive=True)
        # A client that subscribes and never reads.
        deaf = await connect(server.url)
        await deaf.send(json.dumps({"op": "subscribe", "topic": "/joint_states"}))
        deaf.transport.pause_reading()
        async with frame_client(server.url) as client:
            await client.open_goals()
            await client.set_speed(0.1)
            await client.publish("/moveit_goal_joints", {"name": ["shoulder_pan"], "position": [1.5]})
            await client.until("/moveit_goal_status", goal_is("executing"))
            for child in children:
                child.suspend()
            # None of these processes would ever let it end.
            code, _ = await asyncio.to_thread(server.end, signal.SIGTERM)
            assert [result["val"] for result in client.messages(RESULT)] == [-7]
            await client.websocket.wait_closed()
            assert client.websocket.close_code == 1001
        deaf.transport.abort()
    assert code == 0
    _, alive = await asyncio.to_thread(psutil.wait_procs, children, timeout=TIMEOUT_S)
    assert not alive
    assert server.has_logged("the arm process has not ended in order")


# Python runs a module of this name at its start: the arm process waits there for a file.
WAITING_ARM = """
import pathlib, sys, time
while "robot.control.loop" in sys.orig_argv and not pathlib.Path(__file__).with_name("begin").exists():
    time.sleep(0.01)
"""


async def test_a_goal_of_the_gripper_and_a_call_that_waits_for_a_client_are_answered_by_a_server_that_ends() -> None:
    with RunningServer() as server:
        async with arm_client(server.url) as client, arm_client(server.url) as provider:
            await provider.say("advertise_service", service="/never", type="std_srvs/Trigger")
            await provider.call("/rosapi/get_time")
            call = asyncio.create_task(client.call("/never"))
            goal = await client.send_goal(
                "/gripper_controller/gripper_cmd",
                "control_msgs/action/GripperCommand",
                {"command": {"position": 1.2}},
            )
            await client.call("/rosapi/get_time")
            code, _ = await asyncio.to_thread(server.end, signal.SIGTERM)
            assert (await client.result(goal))["values"] == "the server is shutting down"
            assert str(await call) == "the server is shutting down"
    assert code == 0


async def test_a_server_answers_before_its_arm_is_ready_and_a_goal_waits_for_it(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(WAITING_ARM)
    port = free_port()
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    with running(run_command(f"--port {port}"), cwd=ROOT, stderr=subprocess.DEVNULL, env=environment) as process:
        await until(lambda: is_open(port))
        async with frame_client(f"ws://127.0.0.1:{port}") as client:
            await client.open_goals()
            await client.subscribe(STATE, "diagnostic_msgs/DiagnosticStatus")
            first = (await client.until(STATE, bool))[0]
            assert first["message"] == "the arm is not connected: the arm process is starting"
            await client.publish("/moveit_goal_joints", NEAR)
            await client.until("/moveit_goal_status", bool)
            (tmp_path / "begin").touch()
            assert (await client.until(RESULT, bool))[0]["val"] == 1
        process.terminate()
        assert await asyncio.to_thread(process.wait, TIMEOUT_S) == 0

"""Transports of a running server: hostile frames, a client in C over raw TCP, and Zenoh."""

import asyncio
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from websockets.asyncio.client import connect

from harness.clients import frame_client
from harness.server import FAST, FAST_ARMS, ROOT, RunningServer
from harness.waiting import TIMEOUT_S, running, until, wait_until
from protocol.codecs import json
from protocol.limits import Limits
from protocol.session import FrameReader
from tests.helpers.programs import run
from tests.helpers.zenoh_network import RosMachine, free_port

OPENED = ["{", '{"a":', '"', '{"', '{"a\\"', '["",', '{"a":[', '{"":"\\\\', '{"\\']
CLOSED = ["{}", "[{},", "[{{}},", "{  ", "}", '{"a",}']


def seconds_for(text: str) -> float:
    """Processor time of reading a text inside of an object, the least of three [s]."""
    times_s = []
    for _ in range(3):
        reader = FrameReader(Limits())
        started_s = time.thread_time()
        reader.feed('{"a":')
        reader.feed(text)
        times_s.append(time.thread_time() - started_s)
    return min(times_s)


@pytest.mark.parametrize("unit", OPENED + CLOSED)
def test_hostile_frames_take_time_in_proportion_to_their_length(unit: str) -> None:
    short_s, long_s = (seconds_for(unit * (size // len(unit))) for size in (50_000, 800_000))
    # Sixteen times the length; a quadratic reader would take 256 times as long. The floor is the clock's noise, and
    # that only the longer one is decoded in pieces.
    assert long_s < 64 * max(short_s, 0.01)


def test_an_object_in_very_many_frames_takes_time_in_proportion_to_its_length() -> None:
    reader = FrameReader(Limits())
    started_s = time.thread_time()
    reader.feed('{"a":["')
    for _ in range(20_000):
        reader.feed('",{"b":1},"')
    # Reading it anew with each frame would look at two gigabytes.
    assert time.thread_time() - started_s < 5


SOURCE = ROOT / "tests" / "helpers" / "raw_tcp_client.c"
TOKEN = "unreal-0123456789abcdef"

# What each kind of field in a joint state in ROS 1's spelling is printed as.
FIELDS_OF_JOINT_STATE = {
    "msg.header.seq": "int32",
    "msg.header.stamp.secs": "int32",
    "msg.header.stamp.nsecs": "int32",
    "msg.header.frame_id": "text",
    "msg.name.0": "text",
    "msg.position.0": "double",
    "msg.velocity.0": "double",
    "msg.effort": "array",
}
ANSWER = """op text service_response
service text /rosapi/topic_type
values document
values.type text sensor_msgs/JointState
result boolean 1
id text call_service:/rosapi/topic_type:5
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The client, compiled."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no compiler of C (cc) on this machine")
    program = tmp_path_factory.mktemp("raw_tcp") / "client"
    done = run(compiler, "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-o", program, SOURCE)
    assert done.returncode == 0, done.stderr
    return program


def test_a_client_hears_joint_states_reaches_a_goal_and_calls_a_service(program: Path) -> None:
    tokens = {"ARMBRIDGE_ACCESS__OPERATE_TOKENS__UNREAL": TOKEN}
    with RunningServer("--port 0 --tcp-port 0", {**FAST, **tokens}) as server:
        (port,) = re.findall(r"tcp://127\.0\.0\.1:(\d+) \(rosbridge over TCP\)", "\n".join(server.lines))
        done = run(program, port, TOKEN)
        assert done.returncode == 0, done.stderr
        assert server.has_logged(" connected")
        assert server.has_logged(" left")
    state = done.stdout.split("topic text /joint_states\n")[1].split("\ndocument")[0]
    kinds = dict(line.split(" ", 2)[:2] for line in state.splitlines())
    assert {key: kinds.get(key) for key in FIELDS_OF_JOINT_STATE} == FIELDS_OF_JOINT_STATE
    assert "msg.val int32 1\n" in done.stdout.split("topic text /moveit_goal_result\n")[1]
    assert ANSWER in done.stdout


STRING, JOINT_STATE = "std_msgs/msg/String", "sensor_msgs/msg/JointState"
ERROR_CODES = "moveit_msgs::msg::dds_::MoveItErrorCodes_"
SUCCESS = 1


DEAF = """
import signal, sys, zenoh
from tests.helpers.zenoh_network import RosMachine
machine = RosMachine(int(sys.argv[1]))
machine.hear("/arm1/joint_states", "sensor_msgs/msg/JointState")
print("up", flush=True)
signal.pause()
"""


def zenoh_settings(**settings: str) -> dict[str, str]:
    return {f"ARMBRIDGE_ZENOH__{name}": value for name, value in {"MODE": "peer", **settings}.items()} | FAST_ARMS


@dataclass
class Lab:
    """A server with an arm, one for those who look at it, and a ROS 2 machine."""

    port: int
    arm: RunningServer
    viewer: RunningServer
    machine: RosMachine


@pytest.fixture(scope="module")
def lab() -> Iterator[Lab]:
    port = free_port()
    endpoint = f'["tcp/127.0.0.1:{port}"]'
    arm_settings = zenoh_settings(
        LISTEN=endpoint,
        NAMESPACE="/arm1",
        SUBSCRIBE='["/moveit_goal_*"]',
        OFFER='["/arm/*", "/execute_trajectory", "*_controller/*"]',
    )
    viewer_settings = zenoh_settings(
        CONNECT=endpoint, PUBLISH='["/arm1/moveit_goal_*"]', SUBSCRIBE='["/arm1/*"]', CALL='["/arm1/*"]'
    )
    with (
        RunningServer(settings=arm_settings) as arm,
        RunningServer(settings=viewer_settings) as viewer,
        RosMachine(port) as machine,
    ):
        yield Lab(port, arm, viewer, machine)


@pytest.fixture
def ready_arm(lab: Lab) -> Lab:
    """The arm without the fault that a machine under load gives it: servos that seem silent."""
    # A machine finds the services some time after it has joined.
    wait_until(lambda: lab.machine.call("/arm1/arm/stop"))
    for service in ("reset_fault", "enable"):
        (reply,) = lab.machine.call(f"/arm1/arm/{service}")
        assert reply.ok is not None
    return lab


def test_a_goal_of_a_ros_2_machine_moves_the_arm_and_is_answered(ready_arm: Lab) -> None:
    machine, results = ready_arm.machine, []
    states = machine.hear("/arm1/joint_states", JOINT_STATE)
    machine.session.declare_subscriber(
        f"0/arm1/moveit_goal_result/{ERROR_CODES}/*", lambda sample: results.append(bytes(sample.payload))
    )
    wait_until(lambda: states)
    before = states[0][0].position
    machine.publish("/arm1/moveit_goal_named", STRING, data="ready")
    wait_until(lambda: results)
    assert int.from_bytes(results[0][4:8], "little", signed=True) == SUCCESS, results[0]
    assert abs(states[-1][0].position - before).max() > 0.1


async def test_a_client_of_another_server_sees_the_arm_and_moves_it(ready_arm: Lab) -> None:
    async with frame_client(ready_arm.viewer.url) as client:
        await client.subscribe("/arm1/joint_states", JOINT_STATE)
        await client.subscribe("/arm1/moveit_goal_result", "moveit_msgs/MoveItErrorCodes")
        await client.until("/arm1/joint_states", bool)
        await client.send({"op": "advertise", "topic": "/arm1/moveit_goal_named", "type": "std_msgs/String"})
        await client.publish("/arm1/moveit_goal_named", {"data": "rest"})
        results = await client.until("/arm1/moveit_goal_result", bool)
    assert results[0]["val"] == SUCCESS, results[0]


async def test_a_machine_that_does_not_read_holds_up_neither_others_nor_the_end(lab: Lab) -> None:
    # A machine that has asked for joint states, and then reads nothing any more.
    with running([sys.executable, "-c", DEAF, str(lab.port)], stdout=subprocess.PIPE) as deaf:
        assert deaf.stdout is not None
        assert deaf.stdout.readline() == "up\n"
        os.kill(deaf.pid, signal.SIGSTOP)
        heard = lab.machine.hear("/arm1/joint_states", JOINT_STATE)
        await until(lambda: len(heard) >= 100)
        code, _ = await asyncio.to_thread(lab.arm.end, signal.SIGTERM)
    assert code == 0
    # What the arm's server shared is nowhere any more, and the other server goes on.
    wait_until(lambda: not lab.machine.has_token("%arm1%joint_states/sensor_msgs::msg::dds_::JointState_"))
    async with connect(lab.viewer.url) as websocket, asyncio.timeout(TIMEOUT_S):
        answer = {"result": True}
        while answer["result"]:
            await websocket.send('{"op": "call_service", "service": "/arm1/arm/stop"}')
            answer = json.decode(await websocket.recv())
    code, _ = await asyncio.to_thread(lab.viewer.end, signal.SIGTERM)
    assert code == 0

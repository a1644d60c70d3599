"""Two servers in processes of their own, a machine that speaks as rmw_zenoh does, and one that stops reading."""

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from websockets.asyncio.client import connect

from harness.clients import frame_client
from harness.server import FAST_ARMS, RunningServer
from harness.waiting import TIMEOUT_S, running, until, wait_until
from protocol.codecs import json
from tests.helpers.zenoh_network import RosMachine, free_port

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

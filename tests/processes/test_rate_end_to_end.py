"""A running server whose simulated arm is faster than time: goals, stops, steering in real time, and stamps."""

import asyncio
import os
import re
import signal
from collections.abc import Iterator
from typing import Any

import pytest

from harness.clients import ArmClient
from harness.server import RunningServer
from harness.waiting import TIMEOUT_S

CLOCK, JOG, EVENTS = "/clock", "/servo_node/delta_joint_cmds", "/trajectory_execution_event"


@pytest.fixture(scope="module", params=["", "--simulation physics"], ids=["light", "physics"])
def server(request: pytest.FixtureRequest) -> Iterator[RunningServer]:
    with RunningServer(f"--port 0 --rate 20 {request.param}") as running:
        yield running


async def test_a_stop_at_any_moment_ends_a_goal_and_the_next_ones_succeed(caller: ArmClient) -> None:
    await caller.say("advertise", topic=EVENTS, type="std_msgs/String")
    for index in range(8):
        going = asyncio.create_task(caller.call("/moveit_goal", named=("extended", "home")[index % 2]))
        await asyncio.sleep(0.02 * index)
        await caller.publish(EVENTS, {"data": "stop"})
        assert (await going)["code"] in (1, -7)
    for name in ("extended", "home"):
        assert (await caller.call("/moveit_goal", named=name))["success"]


async def test_a_client_that_steers_in_real_time_moves_the_arm(caller: ArmClient) -> None:
    before = await caller.positions()
    await caller.say("advertise", topic=JOG, type="control_msgs/JointJog")
    async with asyncio.timeout(TIMEOUT_S):
        while caller.messages("/joint_states")[-1]["position"][0] < before["shoulder_pan"] + 0.1:
            await caller.publish(JOG, {"joint_names": ["shoulder_pan"], "velocities": [0.5]})
            await asyncio.sleep(0.02)
    assert (await caller.call("/moveit_goal", named="home"))["success"]


def seconds(stamp: dict[str, Any]) -> float:
    return float(stamp["sec"] + 1e-9 * stamp["nanosec"])


async def test_the_clock_has_the_stamps_of_the_joint_states_and_does_not_go_back_when_the_arm_process_dies(
    server: RunningServer, caller: ArmClient
) -> None:
    await caller.subscribe(CLOCK, "rosgraph_msgs/Clock")
    await caller.until(CLOCK, lambda all_: len(all_) > 20)
    pid = int(re.findall(r"\(process (\d+), 100 Hz", "\n".join(server.lines))[0])
    os.kill(pid, signal.SIGKILL)
    seen = len(caller.messages(CLOCK))
    await caller.until(CLOCK, lambda all_: len(all_) > seen + 50)
    stamps = [seconds(each["clock"]) for each in caller.messages(CLOCK)]
    assert stamps == sorted(stamps)
    assert any(seconds(each["header"]["stamp"]) in stamps for each in caller.messages("/joint_states"))

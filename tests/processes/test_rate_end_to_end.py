"""A running server whose simulated arm is faster than time: goals, stops, steering in real time, and stamps."""

import asyncio
import os
import re
import signal
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from harness.clients import ArmClient, FrameClient, arm_client
from harness.server import RunningServer
from harness.waiting import TIMEOUT_S

CLOCK = "/clock"
JOG = "/servo_node/delta_joint_cmds"


@pytest.fixture(scope="module", params=["", "--simulation physics"], ids=["light", "physics"])
def server(request: pytest.FixtureRequest) -> Iterator[RunningServer]:
    with RunningServer(f"--port 0 --rate 20 {request.param}") as running:
        yield running


@pytest.fixture
async def caller(server: RunningServer) -> AsyncIterator[ArmClient]:
    async with arm_client(server.url) as connected:
        yield connected


def seconds(stamp: dict[str, Any]) -> float:
    return float(stamp["sec"] + 1e-9 * stamp["nanosec"])


async def test_goals_one_after_the_other_reach_their_ends(client: FrameClient) -> None:
    for state in ("extended", "home", "ready"):
        assert (await client.reach("/moveit_goal_named", {"data": state}))["val"] == 1


async def test_a_stop_at_any_moment_ends_a_goal_and_the_next_one_succeeds(client: FrameClient) -> None:
    await client.send({"op": "advertise", "topic": "/trajectory_execution_event", "type": "std_msgs/String"})
    for index in range(8):
        seen = len(client.messages("/moveit_goal_result"))
        await client.publish("/moveit_goal_named", {"data": ("extended", "home")[index % 2]})
        await asyncio.sleep(0.02 * index)
        await client.publish("/trajectory_execution_event", {"data": "stop"})
        results = await client.until("/moveit_goal_result", lambda all_, seen=seen: len(all_) > seen)
        assert results[seen]["val"] in (1, -7)
    assert (await client.reach("/moveit_goal_named", {"data": "home"}))["val"] == 1


async def test_the_clock_has_the_stamps_of_the_joint_states_and_never_goes_back(caller: ArmClient) -> None:
    await caller.subscribe(CLOCK, "rosgraph_msgs/Clock")
    await caller.until(CLOCK, lambda all_: len(all_) > 20)
    stamps = [seconds(each["clock"]) for each in caller.messages(CLOCK)]
    assert stamps == sorted(stamps)
    assert any(seconds(each["header"]["stamp"]) in stamps for each in caller.messages("/joint_states"))


async def test_a_client_that_steers_in_real_time_moves_the_arm(caller: ArmClient) -> None:
    assert (await caller.call("/moveit_goal", named="home"))["success"]
    before = await caller.positions()
    await caller.say("advertise", topic=JOG, type="control_msgs/JointJog")
    async with asyncio.timeout(TIMEOUT_S):
        while caller.messages("/joint_states")[-1]["position"][0] < before["shoulder_pan"] + 0.1:
            await caller.publish(JOG, {"joint_names": ["shoulder_pan"], "velocities": [0.5]})
            await asyncio.sleep(0.02)
    assert (await caller.call("/moveit_goal", named="home"))["success"]


async def test_the_clock_does_not_go_back_when_the_arm_process_dies(server: RunningServer, caller: ArmClient) -> None:
    await caller.subscribe(CLOCK, "rosgraph_msgs/Clock")
    await caller.until(CLOCK, bool)
    seen = len(caller.messages(CLOCK))
    pid = int(re.findall(r"\(process (\d+), 100 Hz", "\n".join(server.lines))[0])
    os.kill(pid, signal.SIGKILL)
    await caller.until(CLOCK, lambda all_: len(all_) > seen + 50)
    stamps = [seconds(each["clock"]) for each in caller.messages(CLOCK)]
    assert stamps == sorted(stamps)

"""Time from the death of the arm process, at rest and in a motion, until the arm holds again and reaches a goal."""

from __future__ import annotations

import asyncio
import itertools
import time
from typing import Any

import psutil

from harness.clients import FrameClient, frame_client, goal_is
from harness.figures import percentiles, print_table
from harness.server import FAST, RunningServer

TRIALS = 8

JOINT = "shoulder_pan"
FAR_RAD = 1.0

NEAR_RAD = 0.1  # a goal that takes a quarter of a second from rest, from wherever the arm has stopped
IN_MOTION_S = 0.4  # the arm is amid its motion [s]


def run() -> None:
    """Kill the arm process again and again."""
    with RunningServer(settings=FAST) as server:
        rows = asyncio.run(_measure(server))
    header = ["killed", "times", "arm holds p50", "max", "goal reached p50", "max"]
    print_table("After the death of the arm process [s]", header, rows)


async def _measure(server: RunningServer) -> list[list[str]]:
    rows = []
    async with frame_client(server.url) as client:
        await client.open_goals()
        await client.subscribe("/arm/state", "diagnostic_msgs/DiagnosticStatus")
        await client.subscribe("/joint_states", "sensor_msgs/JointState")
        for name, moves in (("at rest", False), ("in a motion", True)):
            trials = [await _recovery_s(server, client, moves=moves, side=1 - 2 * (n % 2)) for n in range(TRIALS)]
            columns = [percentiles(values, 50, 100, scale=1.0) for values in zip(*trials, strict=True)]
            rows.append([name, str(TRIALS), *(cell for column in columns for cell in column)])
    return rows


async def _recovery_s(server: RunningServer, client: FrameClient, *, moves: bool, side: int) -> tuple[float, ...]:
    """Return the times from a kill to the next process's holding arm, and to the end of a new goal [s]."""
    await client.reach("/moveit_goal_joints", {"name": [JOINT], "position": [side * FAR_RAD]})
    if moves:
        await client.publish("/moveit_goal_joints", {"name": [JOINT], "position": [-side * FAR_RAD]})
        await client.until("/moveit_goal_status", goal_is("executing"))
        await asyncio.sleep(IN_MOTION_S)
    seen, killed_s = len(client.messages("/arm/state")), time.monotonic()
    _arm_process(server).kill()
    states = await client.until("/arm/state", lambda all_: _held_again_s(all_[seen:]) is not None)
    held_s = _held_again_s(states[seen:])
    near_rad = client.messages("/joint_states")[-1]["position"][0] - side * NEAR_RAD
    result = await client.reach("/moveit_goal_joints", {"name": [JOINT], "position": [near_rad]})
    if held_s is None or result["val"] != 1:
        raise RuntimeError(f"the goal is refused: {result}")
    return held_s - killed_s, result["_at_s"] - killed_s


def _held_again_s(states: list[dict[str, Any]]) -> float | None:
    """Return when the arm held after it was not connected [s], monotonic; None before."""
    lost = itertools.dropwhile(lambda state: "not connected" not in state["message"], states)
    return next((state["_at_s"] for state in lost if state["message"] == "the arm holds"), None)


def _arm_process(server: RunningServer) -> psutil.Process:
    children = psutil.Process(server.process.pid).children()
    return next(child for child in children if "robot.control.loop" in child.cmdline())

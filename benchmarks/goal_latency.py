"""Latency from a client's goal message to the first servo write that moves the arm."""

from __future__ import annotations

import asyncio
import tempfile
import time
from pathlib import Path
from typing import Any

from harness.clients import frame_client
from harness.figures import percentiles, print_table
from harness.server import RunningServer, read_write_log

GOALS = 60
STEP_RAD = 0.1

# At full acceleration, so that the first write which differs by a tick (1.5 mrad) comes 16 ms after the motion begins.
SETTINGS = {"ARMBRIDGE_MOVEIT__MAX_ACCELERATION_SCALING": "1.0", "ARMBRIDGE_MOVEIT__MAX_VELOCITY_SCALING": "1.0"}
PAN_SERVO = "1"
GOAL_ADDRESS = 41


def run() -> None:
    """Send short joint goals, and look up the time of the first write of each in the servos' log."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "writes.jsonl"
        with RunningServer(settings={**SETTINGS, "ARMBRIDGE_EMULATOR__WRITE_LOG": str(log)}) as server:
            sent_s = asyncio.run(_send_goals(server.url))
        writes = [
            entry for entry in read_write_log(log) if entry["address"] == GOAL_ADDRESS and PAN_SERVO in entry["data"]
        ]
    latencies = [_first_change_s(writes, at_s) - at_s for at_s in sent_s]
    print_table(
        "Goal message to first servo write [ms]",
        ["goals", "p50", "p99", "max"],
        [[str(len(latencies)), *percentiles(latencies, 50, 99, 100)]],
    )


async def _send_goals(url: str) -> list[float]:
    """Send the goals and return the monotonic times at which they were sent [s]."""
    sent_s = []
    async with frame_client(url) as client:
        await client.open_goals()
        await client.reach("/moveit_goal_named", {"data": "ready"})
        for number in range(GOALS):
            sent_s.append(time.monotonic())
            goal = {"name": ["shoulder_pan"], "position": [STEP_RAD * (1 - number % 2)]}
            result = await client.reach("/moveit_goal_joints", goal)
            assert result["val"] == 1, result
    return sent_s


def _first_change_s(writes: list[dict[str, Any]], after_s: float) -> float:
    """Return the time of the first write that changes the goal of the shoulder pan."""
    held = None
    for entry in writes:
        goal = entry["data"][PAN_SERVO][1:3]
        if entry["machine_t"] > after_s and held is not None and goal != held:
            return float(entry["machine_t"])
        held = goal
    raise AssertionError("a goal moved nothing")

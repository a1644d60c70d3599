"""Chunks of a policy on the simulated arm: how soon they are answered, and how far the goals are behind the targets."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

from harness.clients import ArmClient, arm_client
from harness.figures import percentiles, print_table
from harness.server import FAST, RunningServer

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
CHUNKS, POINTS, HZ, EVERY_S = 60, 50, 30.0, 0.33
STATE = "/arm_controller/controller_state"
ANSWER = "/arm/chunks/answer"


def run() -> None:
    """Measure a stream of overlapping chunks."""
    latencies_s, lags_s = asyncio.run(_measure())
    print_table(
        "Chunks of 50 targets, three a second, into the simulated arm's motion [ms]",
        ["figure", "p50", "p95", "p99"],
        [
            ["from a chunk to its answer, checked whole", *percentiles(latencies_s, 50, 95, 99)],
            ["goals behind the targets, at 0.6 rad/s", *percentiles(lags_s, 50, 95, 99)],
        ],
    )


def _targets(start_rad: dict[str, float], at_s: float) -> list[float]:
    swing = 0.4 * math.sin(1.5 * max(at_s, 0.0))
    return [start_rad[name] + (swing if name == "shoulder_pan" else 0.0) for name in JOINTS]


async def _measure() -> tuple[list[float], list[float]]:
    with RunningServer(settings=FAST) as server:
        async with arm_client(server.url) as client:
            await client.say("subscribe", topic="/joint_states", type="sensor_msgs/JointState")
            await client.say("subscribe", topic=ANSWER, type="armbridge_msgs/ActionChunkAnswer")
            await client.say("advertise", topic="/arm/chunks", type="armbridge_msgs/ActionChunk")
            states = await client.until("/joint_states", bool, 30.0)
            start_rad = dict(zip(states[-1]["name"], states[-1]["position"], strict=True))
            await client.say("subscribe", topic=STATE, type="control_msgs/JointTrajectoryControllerState")
            return await _stream(client, start_rad)


async def _stream(client: ArmClient, start_rad: dict[str, float]) -> tuple[list[float], list[float]]:
    latencies_s, began_s = [], time.time()
    for number in range(1, CHUNKS + 1):
        observed_s = time.time()
        points = [
            {
                "positions": _targets(start_rad, observed_s - began_s + index / HZ),
                "time_from_start": _duration(index / HZ),
            }
            for index in range(1, POINTS + 1)
        ]
        header = {"stamp": _duration(observed_s)}
        chunk = {"header": header, "joint_names": list(JOINTS), "points": points}
        await client.say("publish", topic="/arm/chunks", msg={"id": str(number), "trajectory": chunk})
        sent_s = time.monotonic()
        answers = await client.until(ANSWER, lambda heard: heard[-1]["id"] == str(number), 30.0)  # noqa: B023 - at once
        latencies_s.append(time.monotonic() - sent_s)
        if answers[-1]["error_code"]["val"] != 1:
            raise RuntimeError(answers[-1]["message"])
        await asyncio.sleep(max(EVERY_S - (time.time() - observed_s), 0.0))
    column = JOINTS.index("shoulder_pan")
    lags_s = []
    for state in client.topics[STATE]:
        stamp = state["header"]["stamp"]
        at_s = stamp["sec"] + 1e-9 * stamp["nanosec"] - began_s
        speed = 0.6 * math.cos(1.5 * at_s)
        if at_s > 1.0 and abs(speed) > 0.3:
            behind = _targets(start_rad, at_s)[column] - state["reference"]["positions"][0]
            lags_s.append(abs(behind / speed))
    return latencies_s, lags_s


def _duration(time_s: float) -> dict[str, Any]:
    sec, nanosec = divmod(round(time_s * 1e9), 1_000_000_000)
    return {"sec": sec, "nanosec": nanosec}

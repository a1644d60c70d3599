"""Chunks of a policy on the simulated arm: how soon they are answered and change the goals, beside a running camera."""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from typing import Any

from harness.clients import ArmClient, arm_client
from harness.figures import percentiles, print_table
from harness.server import FAST, ROOT, RunningServer
from harness.waiting import running
from robot.trajectory import PERIOD_S

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
CHUNKS, POINTS, HZ, EVERY_S = 200, 50, 30.0, 0.1
# Swing of the first joint: 1.2 rad/s at most; lags are taken above a speed [rad, rad/s].
SWING_RAD, SWINGS, FAST_RAD_S = 0.8, 1.5, 0.9
# A tick is late when its reading comes so long after the one before: half a period more than one [s].
LATE_S = 0.015
# Chunks that move an arm at rest, time of coming to rest [s], and the least change of a goal [rad].
CHANGES, RESTS_S, CHANGED_RAD = 100, 0.6, 1e-7
CAMERA = ROOT / ".venv/bin/armbridge", "camera", "test", "--width", "640", "--fps", "30", "--connect"
# A state for each tick.
SETTINGS = {**FAST, "ARMBRIDGE_ARM__JOINT_STATE_RATE_HZ": "100"}
STATE = "/arm_controller/controller_state"
ANSWER = "/arm/chunks/answer"


def run() -> None:
    """Measure a stream of overlapping chunks, and how soon the goals of the arm change, beside a camera at 30 Hz."""
    late, late_streamed, latencies_s, lags_s, changes_s = asyncio.run(_measure())
    print_table(
        "Chunks of 50 targets into the simulated arm's motion [ms]",
        ["figure", "p50", "p95", "p99"],
        [
            ["from a chunk to its answer, checked whole", *percentiles(latencies_s, 50, 95, 99)],
            ["from a chunk to the first tick of a changed goal", *percentiles(changes_s, 50, 95, 99)],
            ["goals behind the targets, at 1 rad/s", *percentiles(lags_s, 50, 95, 99)],
        ],
    )
    print_table(
        f"Ticks of the arm whose reading comes more than {1e3 * LATE_S:.0f} ms after the one before",
        ["beside a camera", "late", "ticks"],
        [["no chunks", *map(str, late)], [f"{1.0 / EVERY_S:.0f} chunks a second", *map(str, late_streamed)]],
    )


def _targets(start_rad: dict[str, float], at_s: float) -> list[float]:
    swing = SWING_RAD * math.sin(SWINGS * max(at_s, 0.0))
    return [start_rad[name] + (swing if name == "shoulder_pan" else 0.0) for name in JOINTS]


Late = tuple[int, int]


async def _measure() -> tuple[Late, Late, list[float], list[float], list[float]]:
    with RunningServer(settings=SETTINGS) as server, running([*CAMERA, f"ws://127.0.0.1:{server.port}"]):
        async with arm_client(server.url) as client:
            await client.say("subscribe", topic="/joint_states", type="sensor_msgs/JointState")
            await client.say("subscribe", topic=ANSWER, type="armbridge_msgs/ActionChunkAnswer")
            await client.say("advertise", topic="/arm/chunks", type="armbridge_msgs/ActionChunk")
            states = await client.until("/joint_states", bool, 30.0)
            start_rad = dict(zip(states[-1]["name"], states[-1]["position"], strict=True))
            await client.say("subscribe", topic=STATE, type="control_msgs/JointTrajectoryControllerState")
            await asyncio.sleep(CHUNKS * EVERY_S)
            resting = _late(client)
            streamed = await _stream(client, start_rad)
            return resting, _late(client), *streamed, await _changes(client, start_rad)


def _late(client: ArmClient) -> Late:
    """Return how many of the last ticks were late, and the number of ticks."""
    stamps_s = [_stamp_s(state) for state in client.topics[STATE]][-round(CHUNKS * EVERY_S / PERIOD_S) :]
    return sum(after - before > LATE_S for before, after in itertools.pairwise(stamps_s)), len(stamps_s)


async def _send(client: ArmClient, name: str, targets: list[list[float]]) -> tuple[float, float]:
    """Send a chunk; return the times of its sending and of its answer [s since the epoch]."""
    points = [
        {"positions": target, "time_from_start": _duration(index / HZ)} for index, target in enumerate(targets, 1)
    ]
    sent_s = time.time()
    chunk = {"header": {"stamp": _duration(sent_s)}, "joint_names": list(JOINTS), "points": points}
    await client.say("publish", topic="/arm/chunks", msg={"id": name, "trajectory": chunk})
    answers = await client.until(ANSWER, lambda heard: heard[-1]["id"] == name, 30.0)
    if answers[-1]["error_code"]["val"] != 1:
        raise RuntimeError(answers[-1]["message"])
    return sent_s, time.time()


async def _stream(client: ArmClient, start_rad: dict[str, float]) -> tuple[list[float], list[float]]:
    latencies_s, began_s = [], time.time()
    for number in range(1, CHUNKS + 1):
        observed_s = time.time()
        times_s = [observed_s - began_s + index / HZ for index in range(1, POINTS + 1)]
        sent_s, answered_s = await _send(client, str(number), [_targets(start_rad, at_s) for at_s in times_s])
        latencies_s.append(answered_s - sent_s)
        await asyncio.sleep(max(EVERY_S - (time.time() - observed_s), 0.0))
    lags_s = []
    for state in client.topics[STATE]:
        at_s = _stamp_s(state) - began_s
        speed = SWING_RAD * SWINGS * math.cos(SWINGS * at_s)
        if at_s > 1.0 and abs(speed) > FAST_RAD_S:
            lags_s.append(abs((_targets(start_rad, at_s)[0] - _pan_rad(state)) / speed))
    return latencies_s, lags_s


async def _changes(client: ArmClient, start_rad: dict[str, float]) -> list[float]:
    """Return the times from a chunk that moves the arm, in a chunk at rest, to its first changed goal."""
    found_s = []
    others = [start_rad[name] for name in JOINTS[1:]]
    await asyncio.sleep(POINTS / HZ)
    for number in range(CHANGES):
        await _send(client, f"rest {number}", [[_pan_rad(client.topics[STATE][-1]), *others]] * POINTS)
        await asyncio.sleep(RESTS_S)
        held_rad = _pan_rad(client.topics[STATE][-1])
        step = 0.1 if number % 2 == 0 else -0.1
        ramp = [[held_rad + step * index / POINTS, *others] for index in range(1, POINTS + 1)]
        sent_s, _ = await _send(client, f"ramp {number}", ramp)
        moved_s: list[float] = []
        async with asyncio.timeout(30.0):
            while not moved_s:
                await asyncio.sleep(0.05)
                recent = [state for state in client.topics[STATE] if _stamp_s(state) > sent_s]
                moved_s = [_stamp_s(state) for state in recent if abs(_pan_rad(state) - held_rad) > CHANGED_RAD]
        found_s.append(moved_s[0] - sent_s)
    return found_s


def _pan_rad(state: dict[str, Any]) -> float:
    return float(state["reference"]["positions"][0])


def _stamp_s(state: dict[str, Any]) -> float:
    stamp = state["header"]["stamp"]
    return float(stamp["sec"] + 1e-9 * stamp["nanosec"])


def _duration(time_s: float) -> dict[str, Any]:
    sec, nanosec = divmod(round(time_s * 1e9), 1_000_000_000)
    return {"sec": sec, "nanosec": nanosec}

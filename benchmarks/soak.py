"""Soak test: goals as fast as they finish, on an unreliable bus, with clients that connect, leave and vanish.

``python -m benchmarks.soak SECONDS`` samples the server's memory, threads and file descriptors, and counts the answers.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import json
import random
import sys
import time
from dataclasses import dataclass, field

import numpy as np
import psutil
from websockets.asyncio.client import connect

from harness.clients import FrameClient, frame_client
from harness.figures import print_table
from harness.server import RunningServer
from server.moveit.actions.gripper import GRIPPER_ACTION

SECONDS = 60.0
SEED = 5

# Replies of servos that are lost and that have a wrong byte, far more than a cable that should be replaced; and motions
# at full speed, for more goals.
SETTINGS = {
    "ARMBRIDGE_EMULATOR__DROP": "0.002",
    "ARMBRIDGE_EMULATOR__CORRUPT": "0.002",
    "ARMBRIDGE_ACCESS__CONTROL": "shared",
    "ARMBRIDGE_ACCESS__GOALS_PER_S": "1000",
    "ARMBRIDGE_MOVEIT__MAX_VELOCITY_SCALING": "1.0",
    "ARMBRIDGE_MOVEIT__MAX_ACCELERATION_SCALING": "1.0",
}

# One-time loading and growth has ended by then; slopes are of the samples after it.
WARM_UP_SHARE = 0.2
SAMPLES = 200

ANSWER_TIMEOUT_S = 30.0
VANISH_EVERY_S = 0.5

GOAL_SHARES = {"/moveit_goal_joints": 0.6, "/moveit_goal_pose": 0.25, "/moveit_goal_named": 0.15}
# On an action, whose result goes to its client alone.
GRIPPER_GOAL = json.dumps(
    {
        "op": "send_action_goal",
        "id": "grip",
        "action": GRIPPER_ACTION,
        "action_type": "control_msgs/GripperCommand",
        "args": {"command": {"position": 0.5}},
    }
)

NAMES = ("home", "ready", "rest", "nowhere")


@dataclass
class Log:
    """Samples of time [s], memory [MB], threads, file descriptors, and the children's memory [MB]."""

    samples: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    answers: collections.Counter[int] = field(default_factory=collections.Counter)
    reasons: dict[int, str] = field(default_factory=dict)
    unanswered: int = 0
    vanished: int = 0
    repairs: int = 0


def run(seconds: float = SECONDS) -> None:
    """Send goals for the given time, and print the growth of each resource."""
    log = Log()
    with RunningServer(settings=SETTINGS) as server:
        asyncio.run(_work(server, seconds, log))
        server.lines.clear()
    _tell(seconds, log)


async def _work(server: RunningServer, seconds: float, log: Log) -> None:
    until_s = time.monotonic() + seconds
    process = psutil.Process(server.process.pid)
    async with asyncio.TaskGroup() as group:
        group.create_task(_send_goals(server.url, until_s, log))
        group.create_task(_vanish(server.url, until_s, log))
        group.create_task(_sample(process, server, until_s, seconds / SAMPLES, log))


async def _send_goals(url: str, until_s: float, log: Log) -> None:
    chance = random.Random(SEED)
    async with frame_client(url) as client:
        await client.open_goals()
        while time.monotonic() < until_s:
            topic = chance.choices(list(GOAL_SHARES), list(GOAL_SHARES.values()))[0]
            try:
                answer = await client.reach(topic, _goal(topic, chance), ANSWER_TIMEOUT_S)
            except TimeoutError:
                log.unanswered += 1
            else:
                log.answers[answer["val"]] += 1
                log.reasons[answer["val"]] = answer["message"]
                if answer["val"] in (-4, -25):
                    log.repairs += await _repair(url)
            _forget(client)


def _goal(topic: str, chance: random.Random) -> dict[str, object]:
    if topic == "/moveit_goal_named":
        return {"data": chance.choice(NAMES)}
    if topic == "/moveit_goal_pose":
        x, y, z = chance.uniform(0.1, 0.4), chance.uniform(-0.25, 0.25), chance.uniform(0.05, 0.35)
        return {"pose": {"position": {"x": x, "y": y, "z": z}}}
    names = ["shoulder_pan", "wrist_flex", "wrist_roll"]
    return {"name": names, "position": [chance.uniform(-1.0, 1.0) for _ in names]}


def _forget(client: FrameClient) -> None:
    """Discard received messages, which would grow in this process."""
    client.topics.clear()


async def _repair(url: str) -> bool:
    """Reset a fault and enable the arm again, as an operator would."""
    async with connect(url) as websocket:
        for service in ("/arm/reset_fault", "/arm/enable"):
            await websocket.send(f'{{"op":"call_service","service":"{service}"}}')
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(websocket.recv(), ANSWER_TIMEOUT_S)
    return True


async def _vanish(url: str, until_s: float, log: Log) -> None:
    """Connect clients that subscribe to everything, move the gripper, and vanish without a closing handshake."""
    while time.monotonic() < until_s:
        websocket = await connect(url, ping_interval=None)
        for topic in ("/joint_states", "/tf", "/moveit_goal_status", "/diagnostics"):
            await websocket.send(f'{{"op":"subscribe","topic":"{topic}"}}')
        await websocket.send(GRIPPER_GOAL)
        await asyncio.sleep(VANISH_EVERY_S)
        websocket.transport.abort()
        log.vanished += 1


async def _sample(process: psutil.Process, server: RunningServer, until_s: float, period_s: float, log: Log) -> None:
    began_s = time.monotonic()
    while time.monotonic() < until_s:
        children_mb = sum(_memory_mb(child) for child in process.children(recursive=True))
        log.samples.append(
            (
                time.monotonic() - began_s,
                _memory_mb(process),
                float(process.num_threads()),
                float(process.num_fds()),
                children_mb,
            )
        )
        del server.lines[:-100]
        await asyncio.sleep(period_s)


def _memory_mb(process: psutil.Process) -> float:
    try:
        return float(process.memory_info().rss / 1e6)
    except psutil.NoSuchProcess:
        return 0.0


def _tell(seconds: float, log: Log) -> None:
    samples = np.array(log.samples)
    later = samples[samples[:, 0] >= WARM_UP_SHARE * seconds]
    rows = []
    for column, name in enumerate(("memory [MB]", "threads", "file descriptors", "memory of children [MB]"), start=1):
        slope_per_hour = np.polyfit(later[:, 0], later[:, column], 1)[0] * 3600.0
        first, last = later[0, column], later[-1, column]
        rows.append([name, f"{first:.1f}", f"{later[:, column].max():.1f}", f"{last:.1f}", f"{slope_per_hour:+.2f}"])
    goals = sum(log.answers.values())
    print_table(
        f"Soak of {seconds:g} s: the server, after its warm-up", ["", "first", "most", "last", "per hour"], rows
    )
    print_table(
        f"{goals + log.unanswered} goals, {log.unanswered} unanswered",
        ["answer", "times", "the last of them"],
        [[str(code), str(count), log.reasons[code]] for code, count in sorted(log.answers.items())],
    )
    print(f"{log.vanished} clients vanished; the arm was repaired {log.repairs} times")


if __name__ == "__main__":
    run(float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS)

"""Latency of a client's stops: to the servos, behind its own work, and of a client that does not read its replies."""

from __future__ import annotations

import asyncio
import itertools
import json
import random
import socket
import tempfile
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import bson
from websockets.asyncio.client import connect

from benchmarks.servo_loop import recover
from harness.clients import ArmClient, FrameClient, arm_client, frame_client
from harness.figures import percentiles, print_table
from harness.server import FAST, RunningServer, free_port, read_write_log

TRIALS = 8
STOPS = 3

SPACING_S = 0.005  # between the stops of one trial [s]
SETTLE_S = 0.5  # time for the first stops to pass before another client's motion, and for that motion to begin [s]

ANSWER_TIMEOUT_S = 30.0

# Stops of a joint in the midst of its motion at its full speed, and writes before the stop that show this speed.
MOTIONS = 40
EMERGENCY_STOPS = 20
JOINT, SERVO = "wrist_roll", "5"
GOAL_ADDRESS, TORQUE_ADDRESS = 41, 40
REACH_RAD = 1.5
FIRST_STOP_S, LAST_STOP_S = 0.4, 0.8
CRUISE_WRITES = 10

JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]

Operation = dict[str, Any]


def trajectory(points: int) -> Operation:
    """Return a goal of /execute_trajectory that is refused, since it does not begin where the arm is."""
    point = {"positions": [1.5, 0.25, 0.125, 0.5, 0.75], "velocities": [0.0] * 5}
    made = [{**point, "time_from_start": {"sec": number, "nanosec": 0}} for number in range(1, points + 1)]
    message = {"trajectory": {"joint_trajectory": {"joint_names": JOINTS, "points": made}}}
    fields = {"action": "/execute_trajectory", "action_type": "moveit_msgs/action/ExecuteTrajectory"}
    return {"op": "send_action_goal", "id": "t", **fields, "args": message}


def picture(megabytes: int) -> Operation:
    """Return a message of many numbers, which a thread completes."""
    fields = {"op": "publish", "topic": "/cloud", "type": "std_msgs/Float64MultiArray"}
    return {**fields, "msg": {"data": [0.5] * (megabytes * 200_000)}}


BACKLOGS: dict[str, list[Operation]] = {
    "nothing": [],
    "2 MB of trajectories of 15 kB": [trajectory(100)] * 134,
    "four messages of 2 MB": [{"op": "advertise", "topic": "/cloud", "type": "std_msgs/Float64MultiArray"}]
    + [picture(2)] * 4,
}


class Sender:
    """Client of one transport, which sends operations and hears which calls were answered."""

    def __init__(self, write: Callable[[Operation], Coroutine[Any, Any, None]]) -> None:
        self.write = write
        self.answered_at_s: dict[str, float] = {}
        self.news = asyncio.Event()

    def hear(self, operation: Operation) -> None:
        """Note the answer to a call."""
        if operation.get("op") == "service_response":
            self.answered_at_s[operation["id"]] = time.monotonic()
            self.news.set()

    async def stop_latencies_s(self, backlog: list[Operation], ids: list[str]) -> list[float]:
        """Send a backlog and stops behind it; return the time to the answer of each stop [s]."""
        for operation in backlog:
            await self.write(operation)
        sent_s = {}
        for id_ in ids:
            sent_s[id_] = time.monotonic()
            await self.write({"op": "call_service", "id": id_, "service": "/arm/stop"})
            await asyncio.sleep(SPACING_S)
        async with asyncio.timeout(ANSWER_TIMEOUT_S):
            while not all(id_ in self.answered_at_s for id_ in ids):
                self.news.clear()
                await self.news.wait()
        return [self.answered_at_s[id_] - sent_s[id_] for id_ in ids]


async def over_websocket(url: str, backlog: list[Operation], ids: list[str]) -> list[float]:
    """Measure by JSON over a WebSocket."""
    frames = {id(operation): json.dumps(operation) for operation in backlog}
    async with connect(url, max_size=None) as websocket:
        sender = Sender(lambda operation: websocket.send(frames.get(id(operation)) or json.dumps(operation)))

        async def read() -> None:
            async for frame in websocket:
                sender.hear(json.loads(frame))

        reading = asyncio.create_task(read())
        latencies_s = await sender.stop_latencies_s(backlog, ids)
    await reading
    return latencies_s


async def over_tcp(port: int, backlog: list[Operation], ids: list[str]) -> list[float]:
    """Measure by BSON over raw TCP."""
    frames = {id(operation): bson.encode(operation) for operation in backlog}
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=2**24)

    async def write(operation: Operation) -> None:
        writer.write(frames.get(id(operation)) or bson.encode(operation))
        await writer.drain()

    async def read() -> None:
        while head := await reader.readexactly(4):
            body = await reader.readexactly(int.from_bytes(head, "little") - 4)
            sender.hear(bson.decode(head + body))

    sender = Sender(write)
    reading = asyncio.create_task(read())
    latencies_s = await sender.stop_latencies_s(backlog, ids)
    reading.cancel()
    writer.close()
    return latencies_s


async def unread_latency_s(port: int, observer: FrameClient) -> float:
    """Return the time from the third stop of a client that reads nothing to the end of another client's motion [s]."""
    pan_rad = -0.5 if observer.messages("/joint_states")[-1]["position"][0] > 0 else 0.5
    seen = len(observer.messages("/moveit_goal_result"))
    deaf = socket.create_connection(("127.0.0.1", port))
    ids = map(str, itertools.count())
    try:
        deaf.setblocking(False)
        loop = asyncio.get_running_loop()
        asked = {"op": "call_service", "service": "/rosapi/topics_and_raw_types"}
        calls = b"".join(json.dumps({**asked, "id": next(ids)}).encode() for _ in range(400))
        await asyncio.wait_for(loop.sock_sendall(deaf, calls), 1.0)
        stop = json.dumps({"op": "publish", "topic": "/stop", "msg": {}}).encode()
        for _ in range(STOPS - 1):
            await loop.sock_sendall(deaf, stop)
        await asyncio.sleep(SETTLE_S)
        await observer.publish("/moveit_goal_joints", {"name": ["shoulder_pan"], "position": [pan_rad]})
        await asyncio.sleep(SETTLE_S)
        await loop.sock_sendall(deaf, stop)
        sent_s = time.monotonic()
        results = await observer.until("/moveit_goal_result", lambda all_: len(all_) > seen)
        ended = results[-1]
        return float(ended["_at_s"]) - sent_s if ended["val"] == -7 else float("inf")
    finally:
        deaf.close()


async def stop_motions(url: str) -> tuple[list[float], list[float]]:
    """Stop motions, and then cut the torque; return the monotonic times at which each was sent [s]."""
    stopped_s, cut_s = [], []
    chance = random.Random(0)
    async with arm_client(url) as client:
        await client.say("advertise", topic="/stop", type="std_msgs/Empty")
        await client.until_mode("holding")
        await _move(client, -REACH_RAD)
        await client.until_mode("holding")
        for number in range(MOTIONS):
            reach_rad = REACH_RAD if number % 2 == 0 else -REACH_RAD
            await _move(client, reach_rad)
            await asyncio.sleep(chance.uniform(FIRST_STOP_S, LAST_STOP_S))
            stopped_s.append(time.monotonic())
            await client.say("publish", topic="/stop", msg={})
            await client.until_mode("holding")
            await _move(client, reach_rad)
            await client.until_mode("holding")
        for _ in range(EMERGENCY_STOPS):
            await recover(client)
            cut_s.append(time.monotonic())
            await client.call("/arm/emergency_stop")
    return stopped_s, cut_s


async def _move(client: ArmClient, target_rad: float) -> None:
    """Send a goal, and wait until the arm moves."""
    goal = {"name": [JOINT], "position": [target_rad]}
    await client.goal("/moveit_goal_joints", "sensor_msgs/JointState", goal)
    await client.until_mode("moving")


def slower_s(writes: list[dict[str, Any]], sent_s: float) -> float:
    """Return the time from a stop to the first goal by which the joint moves less than by any shortly before it [s]."""
    goals = [
        (entry["machine_t"], int.from_bytes(bytes(entry["data"][SERVO][1:3]), "little"))
        for entry in writes
        if entry["address"] == GOAL_ADDRESS and SERVO in entry["data"]
    ]
    steps = [(at_s, abs(goal - before)) for (_, before), (at_s, goal) in itertools.pairwise(goals)]
    cruise = min([step for at_s, step in steps if at_s <= sent_s][-CRUISE_WRITES:])
    return next(float(at_s) - sent_s for at_s, step in steps if at_s > sent_s and step < cruise)


def cut_s(writes: list[dict[str, Any]], sent_s: float) -> float:
    """Return the time from an emergency stop to the write that switches torque off [s]."""
    cuts = (
        float(entry["machine_t"])
        for entry in writes
        if entry["address"] == TORQUE_ADDRESS and any(data[0] == 0 for data in entry["data"].values())
    )
    return next(at_s - sent_s for at_s in cuts if at_s > sent_s)


def to_the_servos() -> list[list[str]]:
    """Measure stops and emergency stops of a client, up to the writes to the servos."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "writes.jsonl"
        with RunningServer(settings={**FAST, "ARMBRIDGE_EMULATOR__WRITE_LOG": str(log)}) as server:
            stops_s, emergency_stops_s = asyncio.run(stop_motions(server.url))
        writes = read_write_log(log)
    return [
        [name, str(len(sent_s)), *percentiles([latency_s(writes, at_s) for at_s in sent_s], 50, 99, 100)]
        for name, sent_s, latency_s in (
            ("/stop, to the first slower goal", stops_s, slower_s),
            ("/arm/emergency_stop, to torque off", emergency_stops_s, cut_s),
        )
    ]


async def _measure(url: str, port: int) -> list[list[str]]:
    rows = []
    ids = map(str, itertools.count())
    for way, measure in (("WebSocket, JSON", over_websocket), ("raw TCP, BSON", over_tcp)):
        place = url if measure is over_websocket else port
        for name, backlog in BACKLOGS.items():
            trials = [
                await measure(place, backlog, [next(ids) for _ in range(STOPS)])  # type: ignore[arg-type]
                for _ in range(TRIALS)
            ]
            for number, latencies_s in enumerate(zip(*trials, strict=True), 1):
                rows.append([way, name, str(number), *percentiles(list(latencies_s), 50, 100)])
    async with frame_client(url) as observer:
        await observer.subscribe("/joint_states", "sensor_msgs/JointState")
        await observer.open_goals()
        await observer.until("/joint_states", bool)
        unread_s = [await unread_latency_s(port, observer) for _ in range(TRIALS)]
        behind = "replies unread (to the end of a motion)"
        rows.append(["raw TCP, JSON", behind, "3", *percentiles(unread_s, 50, 100)])
    return rows


def run() -> None:
    """Measure the stops of one client after the other."""
    header = ["order of a client", "times", "p50", "p99", "max"]
    print_table("From a client's message to the servos [ms]", header, to_the_servos())
    port = free_port()
    with RunningServer(f"--port 0 --tcp-port {port}", {"ARMBRIDGE_MOVEIT__MAX_VELOCITY_SCALING": "0.1"}) as server:
        rows = asyncio.run(_measure(server.url, port))
    print_table("Stops behind their client's own work [ms]", ["way", "behind", "stop", "p50", "max"], rows)

"""Cost of a recording: CPU time per message, and length of the event loop's turns."""

from __future__ import annotations

import asyncio
import gc
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import uvloop

from harness.figures import percentiles, print_table
from protocol.publication import PublishedMessage
from protocol.registry import Registry
from server.config import RecordingSettings
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from server.recording.recorder import Recorder

# An arm sends a hundred messages a second; a busy network of clients sends some thousands.
RATES_HZ = (100, 1000, 5000)
SECONDS = 3.0
TICK_S = 0.002
REPEATS = 4

JOINT_STATE = {
    "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": ""},
    "name": ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"],
    "position": [0.123456789, -0.5, 0.5, 0.2, 0.0, 1.0],
    "velocity": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
    "effort": [0.01] * 6,
}


@dataclass
class Cost:
    """Cost of publishing."""

    cpu_us: float  # CPU time of the whole process, per message [us]
    publish_us: float  # CPU time of the event loop's thread in `Graph.publish`, per message [us]
    # CPU time of the whole process between two turns of the event loop [s], an upper bound on each turn.
    turns_s: list[float]
    file_bytes: float = 0.0  # size of the file per message; 0 without one
    dropped: int = 0  # messages that are missing in the file


def run() -> None:
    """Publish joint states to a subscriber that takes JSON, with and without a recording."""
    rows = []
    for rate_hz in RATES_HZ:
        plain, recorded = [], []
        # In turns, so that other load of the machine affects both alike.
        for _ in range(REPEATS):
            plain.append(uvloop.run(_measure(rate_hz, None)))
            with tempfile.TemporaryDirectory() as directory:
                file = Path(directory) / "run.mcap"
                recorded.append(uvloop.run(_measure(rate_hz, file)))
                recorded[-1].file_bytes = file.stat().st_size / (rate_hz * SECONDS)
        rows += [_row(rate_hz, "no", _best(plain), _best(plain)), _row(rate_hz, "yes", _best(recorded), _best(plain))]
    print_table(
        "Recording joint states, beside one subscriber in JSON",
        [
            "messages/s",
            "recorded",
            "CPU/message [us]",
            "ratio",
            "publish() [us]",
            "ratio",
            "CPU between turns p50 [ms]",
            "p99",
            "max",
            "bytes/message",
            "dropped",
        ],
        rows,
    )


async def _measure(rate_hz: int, file: Path | None) -> Cost:
    graph, talker = Graph(Registry.load()), Node("talker")
    graph.advertise(talker, "/joint_states", "sensor_msgs/JointState")
    graph.subscribe(Node("listener"), "/joint_states", None, Subscriber(_encode))
    recorder = None if file is None else Recorder(graph, file, RecordingSettings())
    if recorder is not None:
        recorder.start()
    # As the server does it: what lives as long as the process is not looked at again.
    gc.collect()
    gc.freeze()
    cost = await _publish(graph, talker, rate_hz)
    if recorder is not None:
        await recorder.close()
        cost.dropped = recorder.dropped
    return cost


async def _publish(graph: Graph, talker: Node, rate_hz: int) -> Cost:
    """Publish at a rate for some seconds, a few messages every tick."""
    turns_s, spent_s, sent = [], 0.0, 0
    cpu_s, started_s = time.process_time(), time.perf_counter()
    next_s, turn_cpu_s = started_s, cpu_s
    while sent < rate_hz * SECONDS:
        next_s += TICK_S
        await asyncio.sleep(max(0.0, next_s - time.perf_counter()))
        turns_s.append(time.process_time() - turn_cpu_s)
        turn_cpu_s = time.process_time()
        due = round((next_s - started_s) * rate_hz)
        began_s = time.perf_counter()
        for _ in range(due - sent):
            graph.publish(talker, "/joint_states", _state())
        spent_s += time.perf_counter() - began_s
        sent = due
    return Cost((time.process_time() - cpu_s) / sent * 1e6, spent_s / sent * 1e6, turns_s)


def _best(costs: list[Cost]) -> Cost:
    """Return the minimum of each figure over the runs: other load of the machine only ever adds to it."""
    return Cost(
        min(cost.cpu_us for cost in costs),
        min(cost.publish_us for cost in costs),
        min((cost.turns_s for cost in costs), key=sum),
        costs[0].file_bytes,
        max(cost.dropped for cost in costs),
    )


def _state() -> dict[str, Any]:
    return dict(JOINT_STATE)


def _encode(published: PublishedMessage) -> None:
    published.encoded("/joint_states", "none", "ros2", None)


def _row(rate_hz: int, recorded: str, cost: Cost, plain: Cost) -> list[str]:
    return [
        str(rate_hz),
        recorded,
        f"{cost.cpu_us:.1f}",
        f"{cost.cpu_us / plain.cpu_us:.2f}",
        f"{cost.publish_us:.1f}",
        f"{cost.publish_us / plain.publish_us:.2f}",
        *percentiles(cost.turns_s, 50, 99, 100),
        f"{cost.file_bytes:.0f}",
        str(cost.dropped),
    ]

"""Time from a server's start to its first answer, to its ready line, and to the first goal's motion.

``python -m benchmarks.start [CHECKOUT ...]`` compares checkouts, started in turn; without arguments, it
measures this one alone.
"""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.asyncio.client import connect

from harness.clients import GOAL_TYPES
from harness.figures import percentiles, print_table
from harness.server import READY, ROOT, free_port

STARTS = 9
TIMEOUT_S = 20.0
POLL_S = 0.005

MOVED_RAD = 0.02  # more than noise and backlash of a joint at rest

EVENTS = ("first answer", "ready line", "first joint state", "first goal's motion")

FRAMES: tuple[dict[str, Any], ...] = (
    {"op": "call_service", "service": "/rosapi/get_time", "id": "time"},
    {"op": "subscribe", "topic": "/joint_states", "type": "sensor_msgs/JointState"},
    {"op": "advertise", "topic": "/moveit_goal_joints", "type": GOAL_TYPES["/moveit_goal_joints"]},
    {"op": "publish", "topic": "/moveit_goal_joints", "msg": {"name": ["shoulder_pan"], "position": [0.5]}},
)


def run(checkouts: tuple[Path, ...] = (ROOT,)) -> None:
    """Start the server of each checkout in turn, and note the time of each event."""
    found: dict[Path, list[dict[str, float]]] = {checkout: [] for checkout in checkouts}
    for _ in range(STARTS):
        for checkout in checkouts:
            found[checkout].append(_times_s(checkout))
    for checkout in checkouts:
        print_table(
            f"From the start of the process [s], {STARTS} starts, {checkout}",
            ["until", "median", "max"],
            [
                [event, *percentiles((times[event] for times in found[checkout]), 50, 100, scale=1.0)]
                for event in EVENTS
            ],
        )


def _times_s(checkout: Path) -> dict[str, float]:
    """Return the time of each event since the start of the process [s]."""
    port = free_port()
    with _server(checkout, port) as (began_s, ready_s):
        times = asyncio.run(asyncio.wait_for(_ask(port, began_s), TIMEOUT_S))
        return {**times, "ready line": ready_s[0] - began_s}


@contextmanager
def _server(checkout: Path, port: int) -> Iterator[tuple[float, list[float]]]:
    """Run a server; yields the start time of its process and a list that gets the time of its ready line."""
    ready_s: list[float] = []
    began_s = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "server.cli", "serve", "--port", str(port)],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout)},
        stderr=subprocess.PIPE,
        text=True,
    )

    def read() -> None:
        assert process.stderr is not None
        ready_s.extend(time.monotonic() for line in process.stderr if READY.search(line))

    reader = threading.Thread(target=read)
    reader.start()
    try:
        yield began_s, ready_s
    finally:
        process.terminate()
        process.wait(TIMEOUT_S)
        reader.join()


async def _ask(port: int, began_s: float) -> dict[str, float]:
    """Send all requests at once, as soon as the port is open."""
    times: dict[str, float] = {}
    rest_rad: float | None = None
    await _until_port_is_there(port)
    async with connect(f"ws://127.0.0.1:{port}", open_timeout=TIMEOUT_S) as websocket:
        for frame in FRAMES:
            await websocket.send(json.dumps(frame))
        while "first goal's motion" not in times:
            answer = json.loads(await websocket.recv())
            now_s = time.monotonic() - began_s
            if answer["op"] == "service_response":
                times["first answer"] = now_s
            elif answer["op"] == "publish":
                times.setdefault("first joint state", now_s)
                pan_rad = answer["msg"]["position"][0]
                rest_rad = pan_rad if rest_rad is None else rest_rad
                if abs(pan_rad - rest_rad) > MOVED_RAD:
                    times["first goal's motion"] = now_s
    return times


async def _until_port_is_there(port: int) -> None:
    while True:
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            await asyncio.sleep(POLL_S)
        else:
            writer.close()
            return


if __name__ == "__main__":
    run(tuple(Path(each).resolve() for each in sys.argv[1:]) or (ROOT,))

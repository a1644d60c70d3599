"""How old a joint state is when a client has it."""

from __future__ import annotations

import asyncio
import json
import time

from websockets.asyncio.client import connect

from benchmarks.figures import percentiles, print_table
from tests.helpers.server import RunningServer

SECONDS = 10.0


def run() -> None:
    """Compare the stamp of each state with the time of its arrival; one machine, one clock."""
    with RunningServer() as server:
        ages_s = asyncio.run(_ages_s(server.url))
    print_table(
        "/joint_states: from the reading of the servos to the client [ms]",
        ["states", "p50", "p99", "max"],
        [[str(len(ages_s)), *percentiles(ages_s, 50, 99, 100)]],
    )


async def _ages_s(url: str) -> list[float]:
    ages_s = []
    async with connect(url) as websocket:
        await websocket.send(
            json.dumps({"op": "subscribe", "topic": "/joint_states", "type": "sensor_msgs/JointState"})
        )
        until_s = time.monotonic() + SECONDS
        while time.monotonic() < until_s:
            frame = await websocket.recv()
            arrived_s = time.time()
            stamp = json.loads(frame)["msg"]["header"]["stamp"]
            ages_s.append(arrived_s - stamp["sec"] - stamp["nanosec"] / 1e9)
    return ages_s

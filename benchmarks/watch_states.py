"""Client of ``/joint_states``: ``python -m benchmarks.watch_states URL SECONDS AFTER`` prints its observations as JSON.

It is a process of its own, so that other work of a benchmark does not delay it.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time

from websockets.asyncio.client import connect


async def watch(url: str, seconds: float, after_s: float = 0.0) -> dict[str, list[float]]:
    """Return the age of each state [s], and the time since the one before it [s]; client and server share one clock."""
    ages_s, intervals_s = [], []
    async with connect(url) as websocket:
        await websocket.send(json.dumps({"op": "subscribe", "topic": "/joint_states"}))
        before_s = time.monotonic()
        begin_s = before_s + after_s
        while before_s <= begin_s:
            await websocket.recv()
            before_s = time.monotonic()
        until_s = before_s + seconds
        while before_s < until_s:
            frame = await websocket.recv()
            wall_s, now_s = time.time(), time.monotonic()
            stamp = json.loads(frame)["msg"]["header"]["stamp"]
            ages_s.append(wall_s - stamp["sec"] - stamp["nanosec"] / 1e9)
            intervals_s.append(now_s - before_s)
            before_s = now_s
    return {"ages_s": ages_s, "intervals_s": intervals_s}


if __name__ == "__main__":
    print(json.dumps(asyncio.run(watch(sys.argv[1], float(sys.argv[2]), float(sys.argv[3])))))

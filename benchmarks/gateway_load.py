"""Clients that load a rosbridge server. Usage: ``python -m benchmarks.gateway_load PORT LOAD [ARGUMENT]``."""

from __future__ import annotations

import asyncio
import json
import statistics
import sys
import time
from typing import Any

import numpy as np
import uvloop
from websockets.asyncio.client import ClientConnection, connect

SECONDS = 4.0
RATE_HZ = 200.0
LARGE_BYTES = 1 << 20
LARGE_MESSAGES = 60
CALLS = 2000
FLOOD_MESSAGES = 20_000

# Longer than any queue between publisher and subscriber takes to empty.
DRAIN_S = 1.0

JOINT_STATE = {
    "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": ""},
    "name": ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"],
    "position": [0.123456789, -0.5, 0.5, 0.25, 0.0, 0.3],
    "velocity": [0.0, 0.1, -0.1, 0.0, 0.2, 0.0],
    "effort": [0.01, 0.06, 0.04, 0.0, 0.0, 0.0],
}


class Load:
    """Clients of one server."""

    def __init__(self, port: int) -> None:
        self._url = f"ws://127.0.0.1:{port}"
        self.received = 0

    async def client(self) -> ClientConnection:
        """Connect."""
        return await connect(self._url, compression=None, max_size=None, ping_interval=None)

    async def subscriber(self, topic: str, type_name: str) -> ClientConnection:
        """Connect and subscribe."""
        websocket = await self.client()
        await websocket.send(json.dumps({"op": "subscribe", "topic": topic, "type": type_name}))
        return websocket

    async def count(self, websocket: ClientConnection) -> None:
        """Count what comes."""
        async for _ in websocket:
            self.received += 1

    async def publisher(self, topic: str, type_name: str) -> ClientConnection:
        """Connect and advertise."""
        websocket = await self.client()
        await websocket.send(json.dumps({"op": "advertise", "topic": topic, "type": type_name}))
        await asyncio.sleep(0.2)
        return websocket

    async def fan_out(self, count: int) -> dict[str, Any]:
        """Publish joint states at a steady rate to so many subscribers."""
        topic = f"/fan_out_{count}"
        readers = [
            asyncio.create_task(self.count(await self.subscriber(topic, "sensor_msgs/JointState")))
            for _ in range(count)
        ]
        publisher = await self.publisher(topic, "sensor_msgs/JointState")
        frame = json.dumps({"op": "publish", "topic": topic, "msg": JOINT_STATE})
        await _at_rate(SECONDS, lambda: publisher.send(frame))
        await asyncio.sleep(DRAIN_S)
        for reader in readers:
            reader.cancel()
        return {"deliveries": self.received}

    async def flood(self) -> dict[str, Any]:
        """Publish as fast as the server takes it."""
        subscriber = await self.subscriber("/flood", "sensor_msgs/JointState")
        publisher = await self.publisher("/flood", "sensor_msgs/JointState")
        frame = json.dumps({"op": "publish", "topic": "/flood", "msg": JOINT_STATE})
        reading = asyncio.create_task(self.count(subscriber))
        started_s = time.monotonic()
        for _ in range(FLOOD_MESSAGES):
            await publisher.send(frame)
        last = -1
        while last != self.received:
            last, ended_s = self.received, time.monotonic()
            await asyncio.sleep(0.1)
        reading.cancel()
        return {"rate": self.received / (ended_s - started_s)}

    async def large(self) -> dict[str, Any]:
        """Publish long strings."""
        subscriber = await self.subscriber("/large", "std_msgs/String")
        publisher = await self.publisher("/large", "std_msgs/String")
        frame = json.dumps({"op": "publish", "topic": "/large", "msg": {"data": "x" * LARGE_BYTES}})
        for _ in range(LARGE_MESSAGES):
            await publisher.send(frame)
            await subscriber.recv()
        return {"deliveries": LARGE_MESSAGES}

    async def service(self) -> dict[str, Any]:
        """Call a service of another client."""
        provider, caller = await self.client(), await self.client()
        await provider.send(json.dumps({"op": "advertise_service", "service": "/switch", "type": "std_srvs/SetBool"}))
        serving = asyncio.create_task(_serve(provider))
        await asyncio.sleep(0.2)
        trips_s = []
        for number in range(CALLS):
            started_s = time.perf_counter()
            call = {"op": "call_service", "service": "/switch", "args": {"data": True}, "id": str(number)}
            await caller.send(json.dumps(call))
            await caller.recv()
            trips_s.append(time.perf_counter() - started_s)
        serving.cancel()
        return {"median_s": statistics.median(trips_s)}

    async def latency(self, deaf: int) -> dict[str, Any]:
        """Latency of eight subscribers, beside ``deaf`` ones that never read."""
        topic = f"/latency_{deaf}"
        latencies_s: list[float] = []
        readers = [
            asyncio.create_task(_latencies(await self.subscriber(topic, "std_msgs/String"), latencies_s))
            for _ in range(8)
        ]
        for _ in range(deaf):
            (await self.subscriber(topic, "std_msgs/String")).transport.pause_reading()
        publisher = await self.publisher(topic, "std_msgs/String")
        padding = " " * 4000
        await _at_rate(
            SECONDS,
            lambda: publisher.send(
                json.dumps({"op": "publish", "topic": topic, "msg": {"data": f"{time.monotonic()}{padding}"}})
            ),
        )
        for reader in readers:
            reader.cancel()
        return {"p99_s": float(np.percentile(latencies_s, 99))}


async def _at_rate(seconds: float, send: Any) -> None:
    due_s = time.monotonic()
    until_s = due_s + seconds
    while due_s < until_s:
        await send()
        due_s += 1.0 / RATE_HZ
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))


async def _serve(provider: ClientConnection) -> None:
    async for frame in provider:
        asked = json.loads(frame)
        values = {"success": True, "message": ""}
        answer = {"op": "service_response", "service": asked["service"], "values": values, "result": True}
        await provider.send(json.dumps({**answer, "id": asked["id"]}))


async def _latencies(subscriber: ClientConnection, latencies_s: list[float]) -> None:
    async for frame in subscriber:
        latency_s = time.monotonic() - float(json.loads(frame)["msg"]["data"])
        latencies_s.append(latency_s)


async def main(port: int, load: str, *arguments: str) -> None:
    """Run one load and print what it measured."""
    print(json.dumps(await getattr(Load(port), load)(*(int(argument) for argument in arguments))))


if __name__ == "__main__":
    uvloop.run(main(int(sys.argv[1]), *sys.argv[2:]))

"""Clients that load a rosbridge server. Usage: ``python -m benchmarks.gateway_load PORT PID LOAD [ARGUMENT]``.

PID is the server's process: its CPU time is read when the load begins and when it ends, so that connecting, subscribing
and closing are not counted. Where the server is to be the bottleneck, the clients do next to nothing: frames that are
sent are made beforehand, frames that come are counted by their bytes.
"""

from __future__ import annotations

import asyncio
import base64
import json
import random
import socket
import statistics
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import uvloop
from websockets.asyncio.client import ClientConnection, connect
from websockets.frames import CloseCode, Frame, Opcode

SECONDS = 2.0
RATE_HZ = 200.0
LARGE_BYTES = 1 << 20
LARGE_MESSAGES = 60
CALLS = 2000
FLOOD_MESSAGES = 20_000
CONNECTIONS = 3000

CONNECTING = 16  # clients that connect at the same time: enough for the server never to wait for one

# Number of frames that the kernel accepts at once; the publisher waits for its socket after each such piece.
FLOOD_PIECE = 64

QUIET_S = 0.5  # longer than any queue between publisher and subscriber takes to empty

JOINT_STATE = {
    "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": ""},
    "name": ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"],
    "position": [0.123456789, -0.5, 0.5, 0.25, 0.0, 0.3],
    "velocity": [0.0, 0.1, -0.1, 0.0, 0.2, 0.0],
    "effort": [0.01, 0.06, 0.04, 0.0, 0.0, 0.0],
}


# What a client of the load of connections sends.
UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
SUBSCRIBE = Frame(Opcode.TEXT, b'{"op":"subscribe","topic":"/first","type":"std_msgs/String"}').serialize(mask=True)
LEAVE = Frame(Opcode.CLOSE, CloseCode.NORMAL_CLOSURE.to_bytes(2)).serialize(mask=True)


class Client(ClientConnection):
    """Client that can count incoming data instead of reading it."""

    counting = False
    received_bytes = 0
    last_received_s = 0.0

    def data_received(self, data: bytes) -> None:
        """Count, or read on."""
        if not self.counting:
            super().data_received(data)
            return
        self.received_bytes += len(data)
        self.last_received_s = time.monotonic()


class Load:
    """Clients of one server."""

    def __init__(self, port: int, pid: int) -> None:
        self._url = f"ws://127.0.0.1:{port}"
        self._pid = pid

    async def client(self) -> Client:
        """Connect."""
        websocket = await connect(
            self._url, compression=None, max_size=None, ping_interval=None, create_connection=Client
        )
        if not isinstance(websocket, Client):
            raise TypeError(f"wanted a client of ours, got {websocket!r}")
        return websocket

    async def subscriber(self, topic: str, type_name: str) -> Client:
        """Connect and subscribe."""
        websocket = await self.client()
        await websocket.send(json.dumps({"op": "subscribe", "topic": topic, "type": type_name}))
        return websocket

    async def publisher(self, topic: str, type_name: str) -> Client:
        """Connect and advertise."""
        websocket = await self.client()
        await websocket.send(json.dumps({"op": "advertise", "topic": topic, "type": type_name}))
        await asyncio.sleep(0.2)
        return websocket

    async def fan_out(self, count: int) -> dict[str, float]:
        """Publish joint states at a steady rate to a number of subscribers."""
        topic = f"/fan_out_{count}"
        subscribers = [await self.subscriber(topic, "sensor_msgs/JointState") for _ in range(count)]
        publisher, frame, frame_bytes = await self._joint_state_publisher(topic, subscribers)
        began_s = server_cpu_s(self._pid)
        await _at_rate(SECONDS, lambda: publisher.transport.write(frame))
        await _until_quiet(subscribers)
        deliveries = sum(subscriber.received_bytes for subscriber in subscribers) / frame_bytes
        return {"cpu_us": (server_cpu_s(self._pid) - began_s) / deliveries * 1e6}

    async def flood(self) -> dict[str, float]:
        """Publish as fast as the server reads; returns messages per second, and the CPU time of each [us]."""
        subscriber = await self.subscriber("/flood", "sensor_msgs/JointState")
        publisher, frame, frame_bytes = await self._joint_state_publisher("/flood", [subscriber])
        began_s, started_s = server_cpu_s(self._pid), time.monotonic()
        for _ in range(FLOOD_MESSAGES // FLOOD_PIECE):
            publisher.transport.write(frame * FLOOD_PIECE)
            await publisher.drain()
        await _until_quiet([subscriber])
        received = subscriber.received_bytes / frame_bytes
        return {
            "rate": received / (subscriber.last_received_s - started_s),
            "cpu_us": (server_cpu_s(self._pid) - began_s) / received * 1e6,
        }

    async def _joint_state_publisher(self, topic: str, subscribers: list[Client]) -> tuple[Client, bytes, int]:
        """Connect a publisher; returns it, its frame on the wire, and the length of the frame that subscribers get."""
        publisher = await self.publisher(topic, "sensor_msgs/JointState")
        text = json.dumps({"op": "publish", "topic": topic, "msg": JOINT_STATE}).encode()
        frame = Frame(Opcode.TEXT, text).serialize(mask=True)
        publisher.transport.write(frame)
        for subscriber in subscribers:
            received = str(await subscriber.recv())
            subscriber.counting = True
        return publisher, frame, len(Frame(Opcode.TEXT, received.encode()).serialize(mask=False))

    async def large(self) -> dict[str, float]:
        """Publish long strings."""
        return await self._one_by_one("/large", "std_msgs/String", {"data": "x" * LARGE_BYTES})

    async def picture(self) -> dict[str, float]:
        """Publish pictures."""
        data = base64.b64encode(random.Random(0).randbytes(LARGE_BYTES)).decode()
        picture = {"header": JOINT_STATE["header"], "format": "jpeg", "data": data}
        return await self._one_by_one("/picture", "sensor_msgs/CompressedImage", picture)

    async def _one_by_one(self, topic: str, type_name: str, message: dict[str, Any]) -> dict[str, float]:
        """Publish a message again and again, each time when the one before has come back."""
        subscriber = await self.subscriber(topic, type_name)
        publisher = await self.publisher(topic, type_name)
        frame = json.dumps({"op": "publish", "topic": topic, "msg": message})
        began_s = server_cpu_s(self._pid)
        for _ in range(LARGE_MESSAGES):
            await publisher.send(frame)
            await subscriber.recv()
        return {"cpu_us": (server_cpu_s(self._pid) - began_s) / LARGE_MESSAGES * 1e6}

    async def service(self) -> dict[str, float]:
        """Call a service of another client; both are written as clients usually are."""
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
        return {"median_us": statistics.median(trips_s) * 1e6}

    async def connections(self) -> dict[str, float]:
        """Connect, subscribe, get the first message and leave, again and again; returns connections per second."""
        publisher = await self.publisher("/first", "std_msgs/String")
        await publisher.send(json.dumps({"op": "publish", "topic": "/first", "msg": {"data": "x"}, "latch": True}))
        await asyncio.sleep(QUIET_S)
        began_s, started_s = server_cpu_s(self._pid), time.monotonic()
        _connect(int(self._url.rpartition(":")[2]), CONNECTIONS)
        taken_s, cpu_s = time.monotonic() - started_s, server_cpu_s(self._pid) - began_s
        return {"rate": CONNECTIONS / taken_s, "cpu_us": cpu_s / CONNECTIONS * 1e6}

    async def latency(self, deaf: int) -> dict[str, float]:
        """Measure the latency of eight subscribers, beside ``deaf`` ones that never read."""
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

        def send() -> None:
            text = json.dumps({"op": "publish", "topic": topic, "msg": {"data": f"{time.monotonic()}{padding}"}})
            publisher.transport.write(Frame(Opcode.TEXT, text.encode()).serialize(mask=True))

        await _at_rate(2 * SECONDS, send)
        for reader in readers:
            reader.cancel()
        return {"p99_us": float(np.percentile(latencies_s, 99)) * 1e6}


def server_cpu_s(pid: int) -> float:
    """Return the CPU time of all threads of a process [s], to the nanosecond; the usual clock counts 10 ms ticks."""
    return sum(int(path.read_text().split()[0]) for path in Path(f"/proc/{pid}/task").glob("*/schedstat")) / 1e9


def _connect(port: int, count: int) -> None:
    """Be one client after the other, several at a time; without an event loop, which would cost more than the server.

    While one waits for its answer, the others take their next steps.
    """
    clients = deque(_one_client(port) for _ in range(count))
    present = deque(clients.popleft() for _ in range(CONNECTING))
    while present:
        client = present.popleft()
        if next(client, True):
            if clients:
                present.append(clients.popleft())
        else:
            present.append(client)


def _one_client(port: int) -> Iterator[bool]:
    """Connect, subscribe, get the first message and leave; yields False after each thing sent."""
    with socket.create_connection(("127.0.0.1", port)) as connection:
        for sent, wanted in ((UPGRADE, b" 101 "), (SUBSCRIBE, b'"x"'), (LEAVE, b"")):
            connection.sendall(sent)
            yield False
            answer = connection.recv(65_536)
            if wanted not in answer:
                raise ConnectionError(f"wanted {wanted!r}, got {answer!r}")
        while connection.recv(65_536):
            pass


async def _at_rate(seconds: float, send: Any) -> None:
    due_s = time.monotonic()
    until_s = due_s + seconds
    while due_s < until_s:
        send()
        due_s += 1.0 / RATE_HZ
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))


async def _until_quiet(subscribers: list[Client]) -> None:
    last = -1
    while last != (received := sum(subscriber.received_bytes for subscriber in subscribers)):
        last = received
        await asyncio.sleep(QUIET_S)


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


async def main(port: int, pid: int, load: str, *arguments: str) -> None:
    """Run one load and print its figures."""
    print(json.dumps(await getattr(Load(port, pid), load)(*(int(argument) for argument in arguments))))


if __name__ == "__main__":
    uvloop.run(main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:]))

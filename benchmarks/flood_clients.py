"""Client that floods a server as fast as the server reads: ``python -m benchmarks.flood_clients KIND URL S``."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import random
import sys
from collections.abc import Awaitable, Callable, Iterator

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidMessage

SEED = 4

# Topics of a flood of subscriptions; more than the server allows one client, so that it also rejects some.
TOPICS = 3000

# Clients that subscribe to all topics of the arm, send more requests, and read nothing.
DEAF_CLIENTS = 1
SUBSCRIBED = ("/joint_states", "/tf", "/diagnostics", "/rosout", "/moveit_goal_status")

# A connection that is refused is tried again: a flood does not wait, but its process lets others have the processor.
REFUSED_PAUSE_S = 0.001

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
GARBAGE_BYTES = (1, 10, 1000, 100_000)

Frames = Iterator[str | bytes]


async def flood(kind: str, url: str, seconds: float) -> None:
    """Flood for a while."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await FLOODS[kind](url)


async def _connections(url: str) -> None:
    while True:
        with contextlib.suppress(OSError, InvalidHandshake, InvalidMessage, EOFError, TimeoutError):
            async with connect(url, ping_interval=None) as websocket:
                await websocket.send('{"op":"subscribe","topic":"/joint_states"}')
        await asyncio.sleep(REFUSED_PAUSE_S)


async def _slow_reads(url: str) -> None:
    clients = [await _deaf(url) for _ in range(DEAF_CLIENTS)]
    while True:
        for number, client in enumerate(clients):
            try:
                await asyncio.wait_for(
                    client.send(json.dumps({"op": "call_service", "service": "/rosapi/topics"})), 0.1
                )
            except (ConnectionClosed, TimeoutError):
                client.transport.abort()
                clients[number] = await _deaf(url)
        await asyncio.sleep(REFUSED_PAUSE_S)


async def _deaf(url: str) -> ClientConnection:
    while True:
        with contextlib.suppress(OSError, InvalidHandshake, InvalidMessage, EOFError):
            deaf = await connect(url, ping_interval=None)
            for topic in SUBSCRIBED:
                await deaf.send(json.dumps({"op": "subscribe", "topic": topic}))
            deaf.transport.pause_reading()
            return deaf
        await asyncio.sleep(0.1)


def _sending(frames: Callable[[], Frames]) -> Callable[[str], Awaitable[None]]:
    """A flood of frames on one connection, opened anew when the server closes it."""

    async def send(url: str) -> None:
        while True:
            with contextlib.suppress(ConnectionClosed, OSError, InvalidHandshake, InvalidMessage):
                async with connect(url, ping_interval=None) as websocket:
                    reading = asyncio.create_task(_read(websocket))
                    try:
                        for frame in frames():
                            await websocket.send(frame)
                    finally:
                        reading.cancel()
            await asyncio.sleep(REFUSED_PAUSE_S)

    return send


async def _read(websocket: ClientConnection) -> None:
    with contextlib.suppress(ConnectionClosed):
        async for _ in websocket:
            pass


def _goals() -> Frames:
    chance = random.Random(SEED)
    yield '{"op":"advertise","topic":"/moveit_goal_joints","type":"sensor_msgs/JointState"}'
    yield '{"op":"subscribe","topic":"/moveit_goal_result"}'
    while True:
        msg = {"name": JOINTS, "position": [chance.uniform(-1.6, 1.6) for _ in JOINTS]}
        yield json.dumps({"op": "publish", "topic": "/moveit_goal_joints", "msg": msg})


def _messages() -> Frames:
    yield '{"op":"advertise","topic":"/flood","type":"sensor_msgs/JointState"}'
    while True:
        yield json.dumps({"op": "publish", "topic": "/flood", "msg": {"name": JOINTS, "position": [0.1] * len(JOINTS)}})


def _subscriptions() -> Frames:
    for number in itertools.cycle(range(TOPICS)):
        topic = f"/flood/topic_{number}"
        yield json.dumps({"op": "subscribe", "topic": topic, "type": "std_msgs/String"})
        yield json.dumps({"op": "unsubscribe", "topic": f"/flood/topic_{(number + TOPICS // 2) % TOPICS}"})


def _garbage() -> Frames:
    chance = random.Random(SEED)
    while True:
        size = chance.choice(GARBAGE_BYTES)
        yield chance.randbytes(size)
        yield "{" * size
        yield json.dumps({"op": "publish", "topic": "/moveit_goal_joints", "msg": {"name": "x" * size}})
        yield json.dumps({"op": "call_service", "service": "/nothing/" + "y" * min(size, 200), "args": [size]})


FLOODS: dict[str, Callable[[str], Awaitable[None]]] = {
    "goals": _sending(_goals),
    "messages": _sending(_messages),
    "subscriptions": _sending(_subscriptions),
    "connections": _connections,
    "garbage": _sending(_garbage),
    "slow reads": _slow_reads,
}


if __name__ == "__main__":
    asyncio.run(flood(sys.argv[1], sys.argv[2], float(sys.argv[3])))

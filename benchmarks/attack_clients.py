"""Two clients in processes of their own: one that is healthy and measures, and one that sends costly frames."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import multiprocessing
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidMessage

STOP_EVERY_S = 0.1

CONNECT_TIMEOUT_S = 600.0  # a handshake that the server does not answer is tried again: it may be held up
NICENESS = 19  # the attacker takes time from the others through the server's work for it, not through the scheduler

# Stands in the id of a call behind the attack: its answer shows that all before it has been carried out.
LAST = "the-last-operation"
_LAST_CALL = json.dumps({"op": "call_service", "service": "/rosapi/get_time", "id": LAST})

_SPAWN = multiprocessing.get_context("spawn")

Frame = str | bytes


@dataclass(frozen=True)
class Observation:
    """Longest pause between two joint states, longest round trip of a stop [s], and numbers of both."""

    pause_s: float
    stop_s: float
    states: int
    stops: int
    lost: int  # times that the server has closed the connection
    waiting_s: float  # time since the latest state, or the stop that is not answered, whichever is longer [s]


@dataclass(frozen=True)
class Order:
    """Frames for the attacker."""

    before: Sequence[Frame]  # frames whose answers it awaits before the attack begins
    frames: Sequence[Frame]  # the attack
    limit_s: float  # longest time to wait for the end of the attack [s]
    quiet_s: float  # time without an answer after which the attack is over [s]


@dataclass(frozen=True)
class Outcome:
    """End of an attack."""

    seconds: float  # time until the last operation was answered, or the limit [s]
    end: str  # the way in which it ended: done, closed or limit
    answers: int  # number of frames received


class ClientProcess:
    """Process of a client; the block ends it."""

    def __init__(self, main: Any, *arguments: object) -> None:
        self.pipe, self._far_end = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=main, args=(self._far_end, *arguments), daemon=True)

    def __enter__(self) -> Self:
        self._process.start()
        self._far_end.close()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._process.kill()
        self._process.join()
        self.pipe.close()

    def ask(self, request: object, timeout_s: float) -> Any:
        """Send a request and return the answer."""
        self.pipe.send(request)
        if not self.pipe.poll(timeout_s):
            raise TimeoutError(f"no answer of the client's process within {timeout_s:g} s")
        return self.pipe.recv()


@dataclass
class _Seen:
    """Observations since the last reset; times are monotonic [s]."""

    state_s: float
    asked_s: float | None = None
    pause_s: float = 0.0
    stop_s: float = 0.0
    states: int = 0
    stops: int = 0
    lost: int = 0
    answered: asyncio.Event = field(default_factory=asyncio.Event)

    def reset(self) -> None:
        self.pause_s = self.stop_s = 0.0
        self.states = self.stops = self.lost = 0

    def state(self) -> None:
        now_s = time.monotonic()
        self.pause_s = max(self.pause_s, now_s - self.state_s)
        self.state_s = now_s
        self.states += 1

    def stopped(self) -> None:
        if self.asked_s is not None:
            self.stop_s = max(self.stop_s, time.monotonic() - self.asked_s)
            self.asked_s = None
            self.stops += 1
            self.answered.set()

    def observation(self) -> Observation:
        """Return the observations, with the pause and the stop that have not ended."""
        now_s = time.monotonic()
        pause_s = now_s - self.state_s
        stop_s = 0.0 if self.asked_s is None else now_s - self.asked_s
        return Observation(
            max(self.pause_s, pause_s),
            max(self.stop_s, stop_s),
            self.states,
            self.stops,
            self.lost,
            max(pause_s, stop_s),
        )


def watch(pipe: Connection, url: str) -> None:
    """Watch ``/joint_states`` and stop the arm again and again; every request is answered with an observation."""
    asyncio.run(_watch(pipe, url))


async def _watch(pipe: Connection, url: str) -> None:
    seen = _Seen(time.monotonic())
    serving = asyncio.create_task(_stay_connected(url, seen))
    while not serving.done():
        begin = await asyncio.to_thread(pipe.recv)
        if begin:
            seen.reset()
        pipe.send(seen.observation())
    await serving


async def _stay_connected(url: str, seen: _Seen) -> None:
    while True:
        with contextlib.suppress(ConnectionClosed, OSError, InvalidHandshake, InvalidMessage, EOFError):
            async with _connected(url) as websocket:
                await websocket.send(json.dumps({"op": "subscribe", "topic": "/joint_states"}))
                stopping = asyncio.create_task(_stop(websocket, seen))
                try:
                    async for frame in websocket:
                        if json.loads(frame)["op"] == "publish":
                            seen.state()
                        else:
                            seen.stopped()
                finally:
                    stopping.cancel()
        seen.lost += 1
        await asyncio.sleep(0.01)


async def _stop(websocket: ClientConnection, seen: _Seen) -> None:
    with contextlib.suppress(ConnectionClosed):
        while True:
            seen.answered.clear()
            # A stop that a lost connection left unanswered has been waiting since then.
            seen.asked_s = seen.asked_s or time.monotonic()
            await websocket.send(json.dumps({"op": "call_service", "service": "/arm/stop", "id": "stop"}))
            await seen.answered.wait()
            await asyncio.sleep(STOP_EVERY_S)


def attack(pipe: Connection, url: str) -> None:
    """Send the frames of each order on a connection of its own; True means that it is ready, a request starts it."""
    os.nice(NICENESS)
    while True:
        order = pipe.recv()
        asyncio.run(_attack(pipe, url, order))


async def _attack(pipe: Connection, url: str, order: Order) -> None:
    async with _connected(url) as websocket:
        if order.before:
            await _send(websocket, order.before)
            await _read(websocket, order.limit_s, order.quiet_s)
        pipe.send(True)
        await asyncio.to_thread(pipe.recv)
        began_s = time.monotonic()
        sending = asyncio.create_task(_send(websocket, order.frames))
        end, answers, last_s = await _read(websocket, order.limit_s, order.quiet_s)
        sending.cancel()
        pipe.send(Outcome(last_s - began_s, end, answers))
        websocket.transport.abort()


def _connected(url: str) -> connect:
    # The server asks whether a client is there, and need not be asked; it compresses nothing.
    return connect(url, ping_interval=None, compression=None, max_size=None, open_timeout=CONNECT_TIMEOUT_S)


async def _send(websocket: ClientConnection, frames: Sequence[Frame]) -> None:
    with contextlib.suppress(ConnectionClosed):
        for frame in (*frames, _LAST_CALL):
            await websocket.send(frame)


async def _read(websocket: ClientConnection, limit_s: float, quiet_s: float) -> tuple[str, int, float]:
    """Read until the last operation is answered and nothing more comes; return end, answers and its time [s]."""
    until_s = time.monotonic() + limit_s
    last = _LastAnswer()
    answers, last_s = 0, math.nan
    while (now_s := time.monotonic()) < until_s:
        wait_s = min(quiet_s, until_s - now_s) if last.found else until_s - now_s
        try:
            frame = await asyncio.wait_for(websocket.recv(), wait_s)
        except TimeoutError:
            break
        except ConnectionClosed:
            return "closed", answers, time.monotonic()
        answers += 1
        last_s = time.monotonic()
        last.look(frame)
    return ("done" if last.found else "limit"), answers, last_s if last.found else time.monotonic()


class _LastAnswer:
    """Finds the answer of the last operation, also in fragments."""

    def __init__(self) -> None:
        self.found = False
        self._end = ""

    def look(self, frame: Frame) -> None:
        """Look into a frame."""
        if isinstance(frame, bytes):
            self.found |= LAST.encode() in frame
        elif frame.startswith('{"op":"fragment"'):
            self._end = (self._end + json.loads(frame)["data"])[-len(LAST) - 100 :]
            self.found |= LAST in self._end
        else:
            self.found |= LAST in frame


def crowd(pipe: Connection, url: str, clients: int, topics: int) -> None:
    """Connect clients that advertise topics, and stay; True tells that all of them are advertised."""
    os.nice(NICENESS)
    asyncio.run(_crowd(pipe, url, clients, topics))


async def _crowd(pipe: Connection, url: str, clients: int, topics: int) -> None:
    pipe.recv()
    async with contextlib.AsyncExitStack() as stack:
        for client in range(clients):
            websocket = await stack.enter_async_context(_connected(url))
            names = [f"/crowd/{client}/topic_{number}" for number in range(topics)]
            fields = {"op": "advertise", "type": "sensor_msgs/JointState"}
            frame = "".join(json.dumps({**fields, "topic": name}) for name in names)
            await _send(websocket, [frame])
            await _read(websocket, CONNECT_TIMEOUT_S, 0.0)
        pipe.send(True)
        await asyncio.to_thread(pipe.recv)

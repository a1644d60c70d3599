"""Rosbridge client that publishes the joints of a relaxed arm: the newest sample alone, and reconnecting."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException

from protocol.messages import Stamp
from robot.arm import Arm
from robot.messages import ArmState, Mode
from server.arm.setup import Description, arm_config
from server.config import Settings
from server.execution.monitors import ARM_START_TIMEOUT_S
from server.lifecycle import stop_signals

SAMPLE_TYPE = "sensor_msgs/JointState"

OPEN_TIMEOUT_S = 10.0

# A server that takes no sample within this time has left without a word.
TAKEN_TIMEOUT_S = 5.0

FIRST_DELAY_S, LAST_DELAY_S = 0.5, 5.0

# Samples on their way: the first ones of a slow network are still to be told of when the next leave. Beyond, samples
# are left out, so that no old one is behind a new one.
IN_FLIGHT = 8

# What a server answers to a client that only publishes is short.
MAX_ANSWER_BYTES = 1_000_000
MAX_COMPLAINTS = 20


@dataclass(frozen=True)
class LeaderOptions:
    """Options of a leader's client."""

    url: str
    topic: str
    token: str | None


class NewestSample:
    """The newest sample of the arm, which one reader waits for."""

    def __init__(self) -> None:
        self._state: ArmState | None = None
        self._arrived = asyncio.Event()

    def put(self, state: ArmState) -> None:
        """Keep a state of an arm that a hand can move, in place of the one before."""
        if state.mode is Mode.RELAXED and state.position_rad is not None:
            self._state = state
            self._arrived.set()

    async def take(self) -> ArmState:
        """Wait for a sample that has not been taken, and return it."""
        while (state := self._state) is None:
            self._arrived.clear()
            await self._arrived.wait()
        self._state = None
        return state


class LeaderClient:
    """Client of a server that publishes the arm's joints."""

    def __init__(self, options: LeaderOptions, tell: Callable[[str], None]) -> None:
        self.published = 0
        self._options = options
        self._tell = tell
        self._complaints: set[str] = set()

    async def run(self, samples: NewestSample) -> None:
        """Publish the arm's joints until cancelled, on one connection after the other."""
        url, delay_s = self._options.url, FIRST_DELAY_S
        while True:
            before = self.published
            try:
                async with connect(url, open_timeout=OPEN_TIMEOUT_S, max_size=MAX_ANSWER_BYTES) as websocket:
                    self._tell(f"connected to {url}")
                    await self._converse(websocket, samples)
            except (OSError, WebSocketException, TimeoutError) as error:
                if self.published > before:
                    delay_s = FIRST_DELAY_S
                self._tell(f"{url}: {str(error) or type(error).__name__}; trying again in {delay_s:g} s")
                await asyncio.sleep(delay_s)
                delay_s = min(2.0 * delay_s, LAST_DELAY_S)

    async def _converse(self, websocket: ClientConnection, samples: NewestSample) -> None:
        listening = asyncio.create_task(self._listen(websocket))
        try:
            await self.publish(websocket, samples)
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)

    async def publish(self, connection: ClientConnection, samples: NewestSample) -> None:
        """Publish samples on a connection until it ends.

        Every few samples a ping follows, whose pong says that the server has read all before it (RFC 6455, section
        5.5.2): so a slow network gets fewer samples, and never a queue of old ones.

        Raises:
            WebSocketException: the connection has ended.
            TimeoutError: the server takes no samples.
        """
        if self._options.token is not None:
            await connection.send(json.dumps({"op": "auth", "token": self._options.token}))
        await connection.send(json.dumps({"op": "advertise", "topic": self._options.topic, "type": SAMPLE_TYPE}))
        taken: Awaitable[float] | None = None
        since_ping = 0
        while True:
            state = await samples.take()
            async with asyncio.timeout(TAKEN_TIMEOUT_S):
                if since_ping >= IN_FLIGHT and taken is not None:
                    await taken
                    taken, since_ping = None, 0
                operation = {"op": "publish", "topic": self._options.topic, "msg": sample_message(state)}
                await connection.send(json.dumps(operation))
                self.published += 1
                since_ping += 1
                if taken is None:
                    taken, since_ping = await connection.ping(), 0

    async def _listen(self, websocket: ClientConnection) -> None:
        """Tell what the server complains about, each sentence once."""
        async for frame in websocket:
            with contextlib.suppress(ValueError):
                complaint = _complaint(json.loads(frame))
                if complaint and complaint not in self._complaints and len(self._complaints) < MAX_COMPLAINTS:
                    self._complaints.add(complaint)
                    self._tell(f"{self._options.url}: {complaint}")


def sample_message(state: ArmState) -> dict[str, Any]:
    """Return the sensor_msgs/JointState of a state with readings, stamped with the time of the reading."""
    position, velocity = state.position_rad, state.velocity_rad_s
    return {
        "header": {"stamp": Stamp.from_seconds(state.stamp_s).as_message(), "frame_id": ""},
        "name": list(state.joint_names),
        "position": [] if position is None else [round(value, 5) for value in position.tolist()],
        "velocity": [] if velocity is None else [round(value, 4) for value in velocity.tolist()],
    }


def _complaint(answer: Any) -> str:
    """Return the sentence of a status message with an error or a warning; empty for anything else."""
    if not isinstance(answer, dict) or answer.get("op") != "status" or answer.get("level") not in ("error", "warning"):
        return ""
    return str(answer.get("msg", ""))


async def publish_leader(options: LeaderOptions, settings: Settings, tell: Callable[[str], None]) -> bool:
    """Publish the joints of a relaxed arm until SIGINT or SIGTERM.

    Returns:
        True if a signal has ended it, False if the arm cannot be read.

    Raises:
        ConfigurationError: settings of the arm that cannot be used.
    """
    samples, told = NewestSample(), [""]

    def take(state: ArmState) -> None:
        said = str(state.fault or state.reason)
        if said and said != told[0]:
            tell(f"the arm: {said}")
        told[0] = said
        samples.put(state)

    arm = Arm(arm_config(settings, Description.read(settings.arm)), take)
    ending, _hurry = stop_signals()
    client = LeaderClient(options, tell)
    try:
        await arm.start(ARM_START_TIMEOUT_S)
        running, ended = asyncio.create_task(client.run(samples)), asyncio.create_task(ending.wait())
        await asyncio.wait([running, ended], return_when=asyncio.FIRST_COMPLETED)
        for task in (running, ended):
            task.cancel()
        await asyncio.gather(running, ended, return_exceptions=True)
    except TimeoutError:
        tell(f"the arm process did not start within {ARM_START_TIMEOUT_S:g} s")
    finally:
        await arm.close()
    return ending.is_set()

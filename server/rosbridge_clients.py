"""Rosbridge clients of commands, which call services of a running server, or publish on a topic of it."""

import asyncio
import contextlib
import itertools
import json
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection as BlockingConnection

from robot.errors import RobotError

# A server on the same network answers within milliseconds, a busy one within seconds.
ANSWER_TIMEOUT_S = 10.0


class ServerLost(RobotError):  # noqa: N818 - named by the fact
    """The server cannot be reached, refuses, or has left."""


class CallingClient:
    """Client on a connection; ``messages`` has the newest message of each topic."""

    def __init__(self, websocket: BlockingConnection) -> None:
        self.messages: dict[str, Any] = {}
        self._websocket = websocket
        self._numbers = itertools.count(1)

    def send(self, **operation: Any) -> None:
        self._websocket.send(json.dumps(operation))

    def subscribe(self, topic: str, type_name: str) -> None:
        self.send(op="subscribe", topic=topic, type=type_name)

    def call(self, service: str, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the response of a service; raises ServerLost where there is none."""
        number = str(next(self._numbers))
        self.send(op="call_service", service=service, id=number, args=request)
        until_s = time.monotonic() + ANSWER_TIMEOUT_S
        while (left_s := until_s - time.monotonic()) > 0.0:
            reply = self.receive(left_s)
            if reply.get("op") == "service_response" and reply.get("id") == number:
                if not reply["result"]:
                    raise ServerLost(str(reply["values"]))
                values: dict[str, Any] = reply["values"]
                return values
        raise ServerLost(f"the server did not answer {service} within {ANSWER_TIMEOUT_S:g} s")

    def receive(self, timeout_s: float) -> dict[str, Any]:
        """Return the next operation, which is empty when none comes in time [s]."""
        try:
            operation: dict[str, Any] = json.loads(self._websocket.recv(timeout_s))
        except TimeoutError:
            return {}
        if operation.get("op") == "publish":
            self.messages[operation["topic"]] = operation["msg"]
        return operation


OPEN_TIMEOUT_S = 10.0

# Times between two attempts to connect: doubled after each, up to the second.
FIRST_DELAY_S, LAST_DELAY_S = 0.5, 5.0

# What a server answers to a client that only publishes is short.
MAX_ANSWER_BYTES = 1_000_000

# Each complaint is printed once.
MAX_COMPLAINTS = 20


@dataclass(frozen=True)
class PublishedTopic:
    """Topic of a server at a URL; ``token`` is None where none is needed."""

    url: str
    topic: str
    token: str | None


class PublishingClient(ABC):
    """Client of a server that publishes messages of one type."""

    def __init__(self, target: PublishedTopic, type_name: str, report: Callable[[str], None]) -> None:
        self.published = 0
        self._target = target
        self._type_name = type_name
        self._report = report
        self._complaints: set[str] = set()

    @property
    def ended(self) -> bool:
        return False

    @abstractmethod
    async def publish(self, connection: ClientConnection) -> None:
        """Publish messages on a connection until it or the messages end; raises WebSocketException and TimeoutError."""

    async def run(self) -> None:
        """Publish until there is nothing more, and connect again after each end of a connection."""
        url, delay_s = self._target.url, FIRST_DELAY_S
        while not self.ended:
            before = self.published
            try:
                async with connect(url, open_timeout=OPEN_TIMEOUT_S, max_size=MAX_ANSWER_BYTES) as websocket:
                    self._report(f"connected to {url}")
                    listening = asyncio.create_task(self._listen(websocket))
                    try:
                        await self.announce(websocket)
                        await self.publish(websocket)
                    finally:
                        listening.cancel()
                        await asyncio.gather(listening, return_exceptions=True)
                        # Ended by a signal, `async with` would close it with 1011, an internal error.
                        await websocket.close()
            except (OSError, WebSocketException, TimeoutError) as error:
                if self.published > before:
                    delay_s = FIRST_DELAY_S
                self._report(f"{url}: {str(error) or type(error).__name__}; trying again in {delay_s:g} s")
                await asyncio.sleep(delay_s)
                delay_s = min(2.0 * delay_s, LAST_DELAY_S)

    async def announce(self, connection: ClientConnection) -> None:
        if self._target.token is not None:
            await connection.send(json.dumps({"op": "auth", "token": self._target.token}))
        # Refusals alone: a hint at a misspelt topic would be wrong as long as nobody subscribes to it.
        await connection.send(json.dumps({"op": "set_level", "level": "error"}))
        topic = {"topic": self._target.topic, "type": self._type_name}
        await connection.send(json.dumps({"op": "advertise", **topic}))

    async def send(self, connection: ClientConnection, message: Mapping[str, Any]) -> None:
        await connection.send(json.dumps({"op": "publish", "topic": self._target.topic, "msg": message}))

    async def _listen(self, connection: ClientConnection) -> None:
        """Report complaints of the server for as long as the connection lasts."""
        async for frame in connection:
            with contextlib.suppress(ValueError):
                self._complain(json.loads(frame))

    def _complain(self, answer: Any) -> None:
        """Report the text of a status message with an error or a warning, once; do nothing for any other message."""
        if isinstance(answer, dict) and answer.get("op") == "status" and answer.get("level") in ("error", "warning"):
            complaint = str(answer.get("msg", ""))
            if complaint and complaint not in self._complaints and len(self._complaints) < MAX_COMPLAINTS:
                self._complaints.add(complaint)
                self._report(f"{self._target.url}: {complaint}")

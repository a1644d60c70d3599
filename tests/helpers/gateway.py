"""The gateway without the rest of the server: clients on one graph, without sockets, and a listener on a free port."""

import asyncio
import json
import logging
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection

from harness.waiting import TIMEOUT_S, until
from protocol.interface_packages import read_packages
from protocol.limits import Limits
from protocol.publication import EncodedMessage, Frame
from protocol.session import Session
from server.access.authentication import AuthThrottle
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.execution.queue import RunningGoal
from server.gateway.admission import ConnectionLimiter
from server.gateway.client import Client
from server.gateway.client_context import ClientContext, Gateway
from server.gateway.http import HttpHandler
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.gateway.turns import Turns, encode_or_log
from server.graph.permissions import ANYONE, Identity, Node
from server.graph.topics import Graph
from server.rosapi import RosApi
from tests.conformance.cases import INTERFACES
from tests.helpers.clock import FakeClock
from tests.helpers.messages import REGISTRY
from tests.helpers.rules import with_server_rules

USER_REGISTRY = read_packages([INTERFACES]).registry()


class AtOnce:
    """Background that works in the foreground."""

    def run(self, job: Callable[[], Any], done: Callable[[Any, float], None], failed: Callable[[], None]) -> None:
        done(job(), 0.0)

    def encode(self, encoded: EncodedMessage, ready: Callable[[], None]) -> None:
        encode_or_log(encoded)
        ready()


class UnreadSocket:
    """Transport and connection of a client without a socket; ``held`` while it is not read."""

    def __init__(self, address: str = "") -> None:
        self.address = address
        self.held = False
        self.closed: str | None = None

    def wake(self) -> None:
        """What is queued is collected."""

    def limit_messages(self) -> None:
        """Messages have any size."""

    def disconnect(self, reason: str) -> None:
        self.closed = reason

    def hold_reading(self) -> None:
        self.held = True

    def release_reading(self) -> None:
        self.held = False

    def end_out_of_memory(self) -> None:
        raise AssertionError("no memory in a test that has enough")


class InProcess:
    """Clients, made with their first step, in a time of their own; plays conformance cases."""

    def __init__(
        self,
        limits: Limits | None = None,
        *,
        relay_unknown_types: bool = False,
        rosapi: bool = False,
        interfaces: bool = False,
        access: AccessSettings | None = None,
        arms: tuple[str, ...] = (),
    ) -> None:
        self.clock = FakeClock()
        registry = USER_REGISTRY if interfaces else REGISTRY
        self.graph = Graph(
            registry, self.clock, call_later=self.clock.call_later, relay_unknown_types=relay_unknown_types
        )
        with_server_rules(self.graph, *arms)
        if rosapi:
            RosApi(self.graph)
        self.busy: RunningGoal | None = None
        self.access = Access(
            access or AccessSettings(control="shared"),
            self.clock,
            self.clock,
            lambda: self.busy,
            arms=dict.fromkeys(arms, lambda: self.busy),
        )
        self.throttle = AuthThrottle(self.clock)
        turns = Turns(lambda callback: callback(), self.clock, AtOnce(), self.clock.call_later)
        self._gateway = Gateway(self.graph, self.access, self.throttle, turns, limits=limits or Limits())
        self._sockets: dict[str, UnreadSocket] = {}
        self._clients: dict[str, Client] = {}
        self._frames: dict[str, deque[Frame]] = {}

    def client(self, name: str) -> Client:
        return self._clients[name] if name in self._clients else self.enter(name, ANYONE)

    @property
    def closed(self) -> dict[str, str]:
        """The reason for which each disconnected client was disconnected."""
        return {name: socket.closed for name, socket in self._sockets.items() if socket.closed is not None}

    def enter(self, name: str, identity: Identity | None) -> Client:
        """A client that was admitted as somebody, or as nobody yet."""
        node, session = Node(name, remote=True, identity=identity), Session(self._gateway.limits)
        socket = self._sockets[name] = UnreadSocket()
        self._clients[name] = Client(ClientContext(node, session, self._gateway, socket, socket))
        self._frames[name] = deque()
        return self._clients[name]

    def say(self, client: str, /, **operation: Any) -> None:
        """Send an operation as JSON."""
        self.client(client).receive_frame(json.dumps(operation))
        self._collect()

    def heard(self, client: str) -> list[dict[str, Any]]:
        """Every operation that has come to a client since it was last asked, all of them JSON."""
        self._collect()
        frames = [json.loads(frame.data) for frame in self._frames[client]]
        self._frames[client].clear()
        return frames

    async def send(self, client: str, frame: str | bytes) -> None:
        self.client(client).receive_frame(frame)
        self._collect()

    async def next_frame(self, client: str) -> str | bytes | None:
        self.client(client)
        self._collect()
        if not self._frames[client]:
            return None
        frame = self._frames[client].popleft()
        return frame.data.decode("ascii") if frame.text else frame.data

    async def nothing_comes(self, client: str) -> bool:
        return await self.next_frame(client) is None

    async def close(self, client: str) -> None:
        self._clients.pop(client).leave()

    async def advance(self, seconds: float) -> None:
        self.clock.advance(seconds)
        self._collect()

    def _collect(self) -> None:
        for name, client in self._clients.items():
            for encoded in client.session.send_queue.take_unready():
                encode_or_log(encoded)
            while messages := client.session.data_to_send(self.clock()):
                self._frames[name] += [frame for encoded in messages for frame in encoded.frames]
                client.inbox.resume()


# What a client sends to become a WebSocket's, without the lines that tests are about.
UPGRADE = (
    "Upgrade: websocket",
    "Connection: Upgrade",
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    "Sec-WebSocket-Version: 13",
)


@asynccontextmanager
async def listening(
    settings: ServerSettings | None = None,
    http: HttpHandler | None = None,
    *,
    graph: Graph | None = None,
    access: Access | None = None,
) -> AsyncIterator[Listener]:
    """A listener that serves, on a free port without settings."""
    listener = Listener(graph or Graph(REGISTRY), settings or ServerSettings(port=0), http, access=access)
    await listener.bind()
    await listener.open()
    try:
        yield listener
    finally:
        await listener.close()


def limiter_of(listener: Listener) -> ConnectionLimiter:
    return listener._limiter


async def until_empty(listener: Listener) -> None:
    """Wait until no connection is open."""
    await until(lambda: not limiter_of(listener).open_count)


def request(*lines: str, path: str = "/", host: str | None = "localhost") -> bytes:
    """A request; ``host`` None leaves its header out."""
    named = () if host is None else (f"Host: {host}",)
    return "\r\n".join((f"GET {path} HTTP/1.1", *named, *lines, "", "")).encode("latin-1")


@asynccontextmanager
async def connected(port: int, sent: bytes = b"") -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    """A socket of a client that has sent these bytes."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(sent)
        yield reader, writer
    finally:
        writer.close()


async def exchange(port: int, sent: bytes) -> str:
    """Send, and read until the server ends the connection or has answered; empty for no answer."""
    async with connected(port, sent) as (reader, _):
        try:
            async with asyncio.timeout(TIMEOUT_S):
                head = await reader.readuntil(b"\r\n\r\n")
                body = b"" if head.startswith(b"HTTP/1.1 101") else await reader.read()
            return (head + body).decode()
        except (asyncio.IncompleteReadError, ConnectionError):
            return ""


async def say(client: ClientConnection, op: str, **fields: Any) -> None:
    """Send an operation over a WebSocket."""
    await client.send(json.dumps({"op": op, **fields}))


async def receive(client: ClientConnection) -> Any:
    """The next operation that comes over a WebSocket."""
    return json.loads(await asyncio.wait_for(client.recv(), TIMEOUT_S))


def status(answer: str) -> int:
    """The number of an answer; 0 for none."""
    return int(answer.split(" ", 2)[1]) if answer else 0


class FullTransport:
    """Transport that finds no memory for what is written."""

    def __init__(self, real: Any) -> None:
        self._real = real

    def write(self, _: object) -> None:
        raise MemoryError

    writelines = write

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)


def warnings_of(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Lines of the log from the level of warnings on."""
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]

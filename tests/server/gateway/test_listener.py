from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
from collections.abc import AsyncIterator
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin

from protocol.limits import Limits
from protocol.registry import Registry
from server.errors import ConfigurationError, StartError
from server.gateway.entrance.door import Door
from server.gateway.entrance.entrance import Entrance
from server.gateway.listener import Listener, tells_of_more_than_http
from server.graph import Graph
from server.rosapi import RosApi
from tests.helpers.conformance import cases, play

REGISTRY = Registry.load()

NOTHING_S = 0.02
FRAME_TIMEOUT_S = 30.0

# The server takes a frame from its queue and sends what comes of it in two or three.
TURNS = 10


class OverSockets:
    """Real clients of a real listener."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._clients: dict[str, ClientConnection] = {}

    async def connect(self, client: str) -> ClientConnection:
        if client not in self._clients:
            self._clients[client] = await connect(f"ws://127.0.0.1:{self._listener.port}/any/path?x=1")
        return self._clients[client]

    async def send(self, client: str, frame: str | bytes) -> None:
        websocket = await self.connect(client)
        await websocket.send(frame)
        # Once the pong is there, the server has the frame in its queue; it serves it in the next turns of its loop.
        await asyncio.wait_for(await websocket.ping(), FRAME_TIMEOUT_S)
        for _ in range(TURNS):
            await asyncio.sleep(0)

    async def next_frame(self, client: str) -> str | bytes | None:
        with contextlib.suppress(TimeoutError):
            return await asyncio.wait_for((await self.connect(client)).recv(), FRAME_TIMEOUT_S)
        return None

    async def nothing_comes(self, client: str) -> bool:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for((await self.connect(client)).recv(), NOTHING_S)
            return False
        return True

    async def close(self, client: str) -> None:
        clients = self._listener.traffic.clients
        await self._clients.pop(client).close()
        # The server's side of the close is not ordered with what other clients send next.
        async with asyncio.timeout(FRAME_TIMEOUT_S):
            while self._listener.traffic.clients == clients:
                await asyncio.sleep(0)

    async def advance(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    async def end(self) -> None:
        for websocket in self._clients.values():
            await websocket.close()


@contextlib.asynccontextmanager
async def open_listener(graph: Graph) -> AsyncIterator[Listener]:
    made = Listener(graph, "127.0.0.1", 0)
    await made.bind()
    await made.open()
    yield made
    await made.close()


@pytest.fixture
async def listener() -> AsyncIterator[Listener]:
    async with open_listener(Graph(REGISTRY)) as made:
        yield made


@pytest.mark.parametrize("case", cases(), ids=lambda case: case["name"])
async def test_conformance_over_sockets(case: dict[str, Any]) -> None:
    graph = Graph(REGISTRY, relay_unknown_types=case.get("relay_unknown_types", False))
    if case.get("rosapi", False):
        RosApi(graph)
    async with open_listener(graph) as listener:
        player = OverSockets(listener)
        try:
            await play(case, player)
        finally:
            await player.end()


async def test_any_subprotocol_may_be_offered(listener: Listener) -> None:
    async with connect(f"ws://127.0.0.1:{listener.port}", subprotocols=["anything"]) as websocket:  # type: ignore[list-item]
        assert websocket.subprotocol is None


async def test_a_message_in_1024_byte_frames_is_one_message(listener: Listener) -> None:
    async with connect(f"ws://127.0.0.1:{listener.port}", max_size=None) as websocket:
        await websocket.send(json.dumps({"op": "subscribe", "topic": "/t", "type": "std_msgs/String"}))
        frame = json.dumps({"op": "publish", "topic": "/t", "msg": {"data": "x" * 6_000_000}})
        await websocket.send(frame[start : start + 1024] for start in range(0, len(frame), 1024))
        received = await asyncio.wait_for(websocket.recv(), FRAME_TIMEOUT_S)
    assert len(json.loads(received)["msg"]["data"]) == 6_000_000


async def test_a_message_over_the_limit_is_refused_and_the_connection_lives_on(
    listener: Listener, caplog: pytest.LogCaptureFixture
) -> None:
    limit = Limits().max_message_bytes
    async with connect(f"ws://127.0.0.1:{listener.port}", max_size=None) as websocket:
        await websocket.send(json.dumps({"op": "set_level", "level": "error"}))
        await websocket.send("x" * (limit + 1))
        told = json.loads(await asyncio.wait_for(websocket.recv(), FRAME_TIMEOUT_S))
    assert told == {"op": "status", "level": "error", "msg": f"message of {limit + 1} bytes, the limit is {limit}"}


async def test_the_limits_that_are_set_are_those_of_a_client() -> None:
    made = Listener(Graph(REGISTRY), "127.0.0.1", 0, limits=Limits(max_message_bytes=100_000))
    await made.bind()
    await made.open()
    async with connect(f"ws://127.0.0.1:{made.port}", max_size=None) as websocket:
        await websocket.send(json.dumps({"op": "set_level", "level": "error"}))
        await websocket.send("x" * 100_001)
        told = json.loads(await asyncio.wait_for(websocket.recv(), FRAME_TIMEOUT_S))
    await made.close()
    assert told["msg"] == "message of 100001 bytes, the limit is 100000"


async def test_who_is_not_let_in_is_counted_by_why(listener: Listener) -> None:
    for origin in ("https://evil.example", "https://evil.example"):
        with pytest.raises(InvalidStatus):
            await connect(f"ws://127.0.0.1:{listener.port}", origin=Origin(origin))
    assert listener.refused_connections() == {"origin": 2, "limit": 0}


async def test_a_taken_port_is_told_with_its_number() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(StartError, match=f"port in use: 127.0.0.1:{port}"):
            await Listener(Graph(REGISTRY), "127.0.0.1", port).bind()


async def test_an_address_that_is_not_ours_is_told() -> None:
    with pytest.raises(StartError, match=r"cannot listen on 192\.0\.2\.1:0"):
        await Listener(Graph(REGISTRY), "192.0.2.1", 0, entrance=Entrance(Door(insecure=True))).bind()


async def test_an_address_that_others_reach_is_not_even_bound_without_a_word_about_it() -> None:
    listener = Listener(Graph(REGISTRY), "0.0.0.0", 0)
    with pytest.raises(ConfigurationError, match="--insecure"):
        await listener.bind()
    assert listener.port == 0


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
async def test_the_listener_tells_where_it_is(host: str) -> None:
    listener = Listener(Graph(REGISTRY), host, 0)
    await listener.bind()
    assert listener.url == f"ws://{host}:{listener.port}"
    assert listener.page_url == f"http://{host}:{listener.port}/"
    await listener.close()


def test_an_address_of_ipv6_has_its_brackets() -> None:
    assert Listener(Graph(REGISTRY), "::1", 9090).url == "ws://[::1]:9090"


async def test_without_a_certificate_there_is_nothing_to_read_again(
    listener: Listener, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    listener.reload_certificate()
    assert "nothing to read again: there is no certificate (server.tls_certificate)" in caplog.text


async def test_closing_ends_every_connection(listener: Listener) -> None:
    websocket = await connect(f"ws://127.0.0.1:{listener.port}")
    await asyncio.wait_for(listener.close(), FRAME_TIMEOUT_S)
    await asyncio.wait_for(websocket.wait_closed(), FRAME_TIMEOUT_S)
    assert websocket.close_code == 1001


@pytest.mark.parametrize(
    ("line", "told"),
    [("connection rejected (%d %s)", False), ("HTTP response sent (%d %s)", False), ("connection open", True)],
)
def test_pages_that_load_are_no_news(line: str, told: bool) -> None:
    record = logging.LogRecord("websockets.server", logging.INFO, "", 0, line, (200, "OK"), None)
    assert tells_of_more_than_http(record) is told

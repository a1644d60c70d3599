from __future__ import annotations

import json
from collections import deque
from typing import Any

import pytest

from protocol.limits import Limits
from protocol.registry import Registry
from server.gateway.client import Client
from server.graph import Graph
from tests.helpers.conformance import cases, play

REGISTRY = Registry.load()


class InProcess:
    """Clients on one graph, without sockets, in a time of their own."""

    def __init__(self, limits: Limits | None = None) -> None:
        self.now_s = 50.0
        self.graph = Graph(REGISTRY, lambda: self.now_s)
        self._limits = limits or Limits()
        self._clients: dict[str, Client] = {}
        self._frames: dict[str, deque[bytes]] = {}

    def client(self, name: str) -> Client:
        if name not in self._clients:
            self._clients[name] = Client(name, self.graph, self._limits, lambda: self.now_s, lambda: None)
            self._frames[name] = deque()
        return self._clients[name]

    async def send(self, client: str, frame: str | bytes) -> None:
        self.client(client).receive_frame(frame)
        self._collect()

    async def next_frame(self, client: str) -> bytes | None:
        self.client(client)
        self._collect()
        frames = self._frames[client]
        return frames.popleft() if frames else None

    async def close(self, client: str) -> None:
        self._clients.pop(client).leave()

    async def advance(self, seconds: float) -> None:
        self.now_s += seconds
        self._collect()

    def _collect(self) -> None:
        for name, client in self._clients.items():
            self._frames[name] += client.session.data_to_send(self.now_s)


@pytest.mark.parametrize("case", cases(), ids=lambda case: case["name"])
async def test_conformance_in_process(case: dict[str, Any]) -> None:
    await play(case, InProcess())


@pytest.fixture
def world() -> InProcess:
    return InProcess(Limits(max_subscriptions=2, max_publications=2))


async def say(world: InProcess, client: str, **operation: Any) -> None:
    await world.send(client, json.dumps(operation))


@pytest.mark.parametrize("op", ["subscribe", "advertise"])
async def test_what_is_over_the_limit_leaves_no_trace_in_the_graph(
    world: InProcess, op: str, caplog: pytest.LogCaptureFixture
) -> None:
    for topic in ("/a", "/b", "/c"):
        await say(world, "x", op=op, topic=topic, type="std_msgs/String")
    assert list(world.graph.topic_types()) == ["/a", "/b"]
    assert "limit is 2" in caplog.text


async def test_an_operation_at_the_limit_keeps_what_the_client_has_on_that_topic(world: InProcess) -> None:
    for mark in ("1", "2", "3"):
        await say(world, "x", op="subscribe", topic="/a", type="std_msgs/String", id=mark)
    await say(world, "y", op="publish", topic="/a", msg={"data": "hello"})
    assert await world.next_frame("x") is not None


async def test_a_refusal_is_logged_with_client_operation_and_reason(
    world: InProcess, caplog: pytest.LogCaptureFixture
) -> None:
    await say(world, "x", op="publish", topic="/nobody", msg={})
    assert "x: refused: publish: topic /nobody" in caplog.text


async def test_a_latched_message_comes_with_the_first_subscription_only(world: InProcess) -> None:
    await say(world, "x", op="advertise", topic="/a", type="std_msgs/String", latch=True)
    await say(world, "x", op="publish", topic="/a", msg={"data": "kept"})
    for mark in ("1", "2"):
        await say(world, "y", op="subscribe", topic="/a", id=mark)
    assert await world.next_frame("y") is not None
    assert await world.next_frame("y") is None


async def test_a_client_that_left_gets_nothing(world: InProcess) -> None:
    await say(world, "x", op="subscribe", topic="/a", type="std_msgs/String")
    left = world.client("x")
    await world.close("x")
    await say(world, "y", op="publish", topic="/a", msg={"data": "late"})
    assert left.session.data_to_send(world.now_s) == []

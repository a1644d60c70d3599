from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator

import pytest
from websockets.asyncio.client import connect

from protocol.registry import Registry
from server.gateway.listener import Listener
from server.graph import Graph, Node

TALKER = Node("talker")


@pytest.fixture
async def graph() -> Graph:
    made = Graph(Registry.load())
    made.advertise(TALKER, "/t", "std_msgs/String")
    return made


@pytest.fixture
async def url(graph: Graph) -> AsyncIterator[str]:
    listener = Listener(graph, "127.0.0.1", 0)
    await listener.bind()
    await listener.open()
    yield f"ws://127.0.0.1:{listener.port}"
    await listener.close()


async def until_subscribed(graph: Graph, count: int) -> None:
    async with asyncio.timeout(5.0):
        while len(graph._topics["/t"].subscribers) < count:
            await asyncio.sleep(0.005)


SUBSCRIBE = json.dumps({"op": "subscribe", "topic": "/t"})


async def test_a_client_that_never_reads_costs_others_nothing_and_a_bounded_amount(
    graph: Graph, url: str, caplog: pytest.LogCaptureFixture
) -> None:
    async with connect(url) as reading:
        await reading.send(SUBSCRIBE)
        deaf = await connect(url)
        deaf.transport.pause_reading()
        await deaf.send(SUBSCRIBE)
        await until_subscribed(graph, 2)
        payload = "x" * 10_000
        for number in range(2000):
            graph.publish(TALKER, "/t", {"data": f"{number} {payload}"})
            assert json.loads(await asyncio.wait_for(reading.recv(), 5.0))["msg"]["data"].startswith(f"{number} ")
        deaf.transport.abort()
        async with asyncio.timeout(5.0):
            while "messages were dropped" not in caplog.text:
                await asyncio.sleep(0.01)


async def test_a_throttled_message_leaves_when_it_is_due(graph: Graph, url: str) -> None:
    async with connect(url) as client:
        await client.send(json.dumps({"op": "subscribe", "topic": "/t", "throttle_rate": 100, "queue_length": 1}))
        await until_subscribed(graph, 1)
        for data in ("first", "dropped", "last"):
            graph.publish(TALKER, "/t", {"data": data})
            await asyncio.sleep(0.01)
        got = [json.loads(await asyncio.wait_for(client.recv(), 1.0))["msg"]["data"] for _ in range(2)]
    assert got == ["first", "last"]


async def test_a_client_that_breaks_off_is_taken_out_of_the_graph(graph: Graph, url: str) -> None:
    client = await connect(url)
    await client.send(SUBSCRIBE)
    await until_subscribed(graph, 1)
    client.transport.abort()
    async with asyncio.timeout(5.0):
        while graph._topics["/t"].subscribers:
            await asyncio.sleep(0.005)

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass

from websockets.asyncio.client import connect

from protocol.registry import Registry
from server.gateway.listener import Listener
from server.gateway.traffic import Traffic, TrafficCounts
from server.graph.node import Node
from server.graph.topics import Graph

TALKER = Node("talker")


@dataclass(eq=False)
class Talk:
    """A connection as it is looked at."""

    said: TrafficCounts
    queued_bytes: int = 0

    def counts(self) -> TrafficCounts:
        return self.said


def test_who_has_left_is_still_counted() -> None:
    traffic, first, second = Traffic(), Talk(TrafficCounts(1, 10, 2, 20, 3, 4)), Talk(TrafficCounts(5, 50, 6, 60, 7, 8))
    traffic.add(first)
    traffic.add(second)
    both = TrafficCounts(6, 60, 8, 80, 10, 12)
    assert (traffic.counts(), traffic.clients, traffic.connections) == (both, 2, 2)
    traffic.remove(first)
    assert (traffic.counts(), traffic.clients, traffic.connections) == (both, 1, 2)


def test_what_waits_is_told_of_all_and_of_the_slowest() -> None:
    traffic = Traffic()
    assert traffic.queued_bytes() == (0, 0)
    for queued_bytes in (5, 70, 6):
        traffic.add(Talk(TrafficCounts(), queued_bytes))
    assert traffic.queued_bytes() == (81, 70)


async def test_a_real_client_is_counted_by_what_it_says_and_hears() -> None:
    graph = Graph(Registry.load())
    graph.advertise(TALKER, "/t", "std_msgs/String")
    listener = Listener(graph, "127.0.0.1", 0)
    await listener.bind()
    await listener.open()
    text = json.dumps({"op": "subscribe", "topic": "/t"})
    async with connect(f"ws://127.0.0.1:{listener.port}", compression=None) as client:
        await client.send(text)
        async with asyncio.timeout(30.0):
            while not graph.subscribers("/t"):
                await asyncio.sleep(0.005)
        sent_bytes = 0
        for _ in range(3):
            graph.publish(TALKER, "/t", {"data": "x" * 200})
            # Two bytes of a frame's head, and two of its length.
            sent_bytes += len(await client.recv()) + 4
        counts = listener.traffic.counts()
        assert (listener.traffic.clients, counts.received_messages, counts.sent_messages) == (1, 1, 3)
        assert counts.sent_bytes == sent_bytes
        assert len(text) < counts.received_bytes < len(text) + 1000
        assert (counts.dropped_messages, counts.refused_operations, listener.traffic.queued_bytes()) == (0, 0, (0, 0))
        for nonsense in ("{", json.dumps({"op": "publish", "topic": "/t", "msg": {"data": 1}})):
            await client.send(nonsense)
        async with asyncio.timeout(30.0):
            while listener.traffic.counts().refused_operations < 2:
                await asyncio.sleep(0.005)
    await listener.close()
    assert (listener.traffic.clients, listener.traffic.counts().sent_messages) == (0, 3)

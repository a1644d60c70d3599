from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from typing import Any

import pytest

from protocol.registry import Registry
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.rosout import MAX_WAITING, TOPIC, Rosout

LOG = logging.getLogger("armbridge.test")


@pytest.fixture
async def heard() -> AsyncIterator[list[Any]]:
    graph = Graph(Registry.load())
    rosout = Rosout(graph, asyncio.get_running_loop())
    rosout.open()
    messages: list[Any] = []
    graph.subscribe(Node("test"), TOPIC, None, Subscriber(lambda publication: messages.append(publication.msg)))
    yield messages
    rosout.close()


async def test_a_record_is_published_with_level_name_and_place(heard: list[Any]) -> None:
    LOG.warning("too %s", "hot")
    await asyncio.sleep(0)
    assert [(m["level"], m["name"], m["msg"], m["file"]) for m in heard] == [
        (30, "armbridge.test", "too hot", "test_rosout.py")
    ]


async def test_a_record_of_another_thread_is_published(heard: list[Any]) -> None:
    await asyncio.to_thread(LOG.error, "from afar")
    async with asyncio.timeout(30.0):
        while not heard:
            await asyncio.sleep(0)
    assert [m["msg"] for m in heard] == ["from afar"]


async def test_a_token_is_not_published(heard: list[Any]) -> None:
    LOG.warning("refused: %s", "/?token=s3cret")
    await asyncio.sleep(0)
    assert [m["msg"] for m in heard] == ["refused: /?token=***"]


async def test_a_burst_is_bounded(heard: list[Any]) -> None:
    for number in range(MAX_WAITING + 500):
        LOG.warning("%d", number)
    await asyncio.sleep(0)
    assert len(heard) == MAX_WAITING
    LOG.warning("after the burst")
    await asyncio.sleep(0)
    assert heard[-1]["msg"] == "after the burst"

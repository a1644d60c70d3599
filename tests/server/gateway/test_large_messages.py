"""Large messages over real sockets: to readers, and to clients that stand still."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from types import SimpleNamespace

import pytest
from websockets.asyncio.client import ClientConnection, connect

from harness.waiting import TIMEOUT_S, until
from protocol.limits import Limits
from protocol.publication import EncodedMessage
from server.gateway import connection
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.gateway.turns import MessageThreads, encode_or_log
from server.graph.permissions import Node
from server.graph.topics import Graph
from tests.helpers.gateway import listening, receive, say
from tests.helpers.messages import REGISTRY

TALKER = Node("talker")


class World:
    """A server with real sockets; publishes strings on /t."""

    def __init__(self, listener: Listener, graph: Graph) -> None:
        self.listener = listener
        self.graph = graph
        self.clients = contextlib.AsyncExitStack()

    async def connect(self) -> ClientConnection:
        return await self.clients.enter_async_context(connect(self.listener.url, compression=None, max_size=None))

    async def reader(self) -> ClientConnection:
        client = await self.connect()
        count = len(self.graph._topics["/t"].subscribers)
        await say(client, "subscribe", topic="/t")
        await until(lambda: len(self.graph._topics["/t"].subscribers) > count)
        return client

    async def deaf(self) -> ClientConnection:
        client = await self.reader()
        client.transport.pause_reading()
        # Closing it properly would wait for what it does not read.
        self.clients.callback(client.transport.abort)
        return client

    def publish(self, count: int, size_bytes: int) -> None:
        for number in range(count):
            self.graph.publish(TALKER, "/t", {"data": f"{number} {'x' * size_bytes}"})

    @property
    def used_bytes(self) -> int:
        return self.listener._gateway.budget.used_bytes


async def numbers(client: ClientConnection, count: int) -> list[int]:
    return [int((await receive(client))["msg"]["data"].split()[0]) for _ in range(count)]


@contextlib.asynccontextmanager
async def world_with(limits: Limits | None = None, max_queued_bytes: int = 256_000_000) -> AsyncIterator[World]:
    graph = Graph(REGISTRY)
    graph.advertise(TALKER, "/t", "std_msgs/String")
    settings = ServerSettings(port=0, limits=limits or Limits(), max_queued_bytes=max_queued_bytes)
    async with listening(settings, graph=graph) as listener:
        world = World(listener, graph)
        async with world.clients:
            yield world


async def test_large_answers_that_come_at_once_all_arrive(monkeypatch: pytest.MonkeyPatch) -> None:
    # A busy machine is no client that does not read.
    monkeypatch.setattr(connection, "UNREAD_TIMEOUT_S", TIMEOUT_S)
    async with world_with() as world:
        client, provider = await world.connect(), await world.connect()
        await say(provider, "advertise_service", service="/s", type="std_srvs/Trigger")
        await until(lambda: "/s" in world.graph.services.names.types())
        for number in range(30):
            await say(client, "call_service", service="/s", id=str(number))
        client.transport.pause_reading()
        values = {"success": True, "message": "x" * 400_000}
        for mark in [(await receive(provider))["id"] for _ in range(30)]:
            await say(provider, "service_response", service="/s", id=mark, values=values, result=True)
        await until(lambda: world.used_bytes > 5_000_000)
        client.transport.resume_reading()
        answers = [await receive(client) for _ in range(30)]
        assert {answer["id"] for answer in answers if answer["result"]} == {str(number) for number in range(30)}


async def test_a_message_that_was_encoded_for_longer_than_it_may_wait_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    def encode_late(_: MessageThreads, encoded: EncodedMessage, _ready: Callable[[], None]) -> None:
        # As on a busy machine: the event loop looks at what waits before it learns that the message is there.
        asyncio.get_running_loop().call_later(0.3, encode_or_log, encoded)

    monkeypatch.setattr(MessageThreads, "encode", encode_late)
    async with world_with(Limits(max_topic_delay_s=0.1)) as world:
        reader = await world.reader()
        world.publish(1, 3_000_000)
        assert await numbers(reader, 1) == [0]


async def test_a_slow_reader_of_one_large_message_keeps_the_messages_behind_it(monkeypatch: pytest.MonkeyPatch) -> None:
    ahead_s, looks = [0.0], []
    check = connection.Connection._check_reading

    def look(self: connection.Connection, taken_bytes: int, since_s: float) -> None:
        looks.append(since_s)
        check(self, taken_bytes, since_s)

    monkeypatch.setattr(connection, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + ahead_s[0]))
    monkeypatch.setattr(connection, "UNREAD_TIMEOUT_S", 60.0)
    monkeypatch.setattr(connection, "LOOKS", 6000)
    monkeypatch.setattr(connection.Connection, "_check_reading", look)
    async with world_with(Limits(max_topic_delay_s=60.0)) as world:
        reader = await world.deaf()
        world.publish(1, 30_000_000)
        await until(lambda: world.listener.traffic.counts().sent_messages > 0)
        world.publish(3, 1000)
        receiving = asyncio.create_task(numbers(reader, 4))
        # Two minutes, of which a message may wait one with a client that stands still: it reads a piece at a time.
        for _ in range(8):
            ahead_s[0] += 15.0
            reader.transport.resume_reading()
            for _ in range(3):
                await asyncio.sleep(0)  # turns of the loop, in which it reads
            reader.transport.pause_reading()
            looks.clear()
            await until(lambda: looks)
        reader.transport.resume_reading()
        assert await receiving == [0, 0, 1, 2]


async def test_a_client_that_stands_still_gives_its_memory_back_though_nothing_more_comes() -> None:
    async with world_with(Limits(max_topic_delay_s=0.2)) as world:
        await world.deaf()
        world.publish(50, 400_000)
        assert world.used_bytes > 1_000_000
        await until(lambda: world.used_bytes == 0)
        assert world.listener.traffic.counts().dropped_messages > 20


async def test_clients_that_leave_return_what_waited_for_them() -> None:
    async with world_with() as world:
        for _ in range(3):
            deaf = [await world.deaf() for _ in range(3)]
            world.publish(20, 400_000)
            assert world.used_bytes > 0
            for client in deaf:
                client.transport.abort()
            await until(lambda: not world.listener.traffic.clients)
            assert world.used_bytes == 0


async def test_answers_that_stay_in_the_sockets_of_clients_that_do_not_read_close_them_and_nobody_else() -> None:
    limits = Limits(max_queued_bytes=8_000_000, max_topic_delay_s=0.2)
    async with world_with(limits, max_queued_bytes=30_000_000) as world:
        world.graph.services.offer(TALKER, "/s", "std_srvs/Trigger", lambda _: {"message": "x" * 7_000_000})
        reader = await world.connect()
        for _ in range(6):
            client = await world.deaf()
            await say(client, "call_service", service="/s")
        for _ in range(10):
            await say(reader, "call_service", service="/s")
            assert (await receive(reader))["result"]
        await until(lambda: world.listener.traffic.clients <= 5)
        assert world.used_bytes <= 30_000_000

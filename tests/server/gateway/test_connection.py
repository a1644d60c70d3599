import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from harness.waiting import until
from protocol.limits import Limits
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.gateway import connection
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.graph.node import Node
from server.graph.topics import Graph
from tests.helpers.gateway import TIMEOUT_S, listening, warnings_of
from tests.helpers.messages import REGISTRY

TALKER = Node("talker")


@pytest.fixture
async def graph() -> Graph:
    made = Graph(REGISTRY)
    made.advertise(TALKER, "/t", "std_msgs/String")
    return made


@pytest.fixture
async def url(graph: Graph) -> AsyncIterator[str]:
    async with listening(graph=graph) as listener:
        yield listener.url


async def until_subscribed(graph: Graph, count: int) -> None:
    await until(lambda: len(graph._topics["/t"].subscribers) >= count)


async def receive(client: ClientConnection) -> dict[str, Any]:
    """The next operation."""
    operation: dict[str, Any] = json.loads(await asyncio.wait_for(client.recv(), TIMEOUT_S))
    return operation


SUBSCRIBE = json.dumps({"op": "subscribe", "topic": "/t"})


async def test_a_client_that_never_reads_costs_a_bounded_amount(graph: Graph, caplog: pytest.LogCaptureFixture) -> None:
    settings = ServerSettings(port=0, limits=Limits(max_queued_bytes=500_000))
    async with listening(settings, graph=graph) as listener, connect(listener.url) as reading:
        await reading.send(SUBSCRIBE)
        deaf = await connect(listener.url)
        deaf.transport.pause_reading()
        await deaf.send(SUBSCRIBE)
        await until_subscribed(graph, 2)
        payload = "x" * 100_000
        for number in range(200):
            graph.publish(TALKER, "/t", {"data": f"{number} {payload}"})
            assert (await receive(reading))["msg"]["data"].startswith(f"{number} ")
        deaf.transport.abort()
        await until(lambda: "messages were dropped" in caplog.text)


async def test_an_aborted_client_leaves_the_graph(graph: Graph, url: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    client = await connect(url)
    await client.send(SUBSCRIBE)
    await until_subscribed(graph, 1)
    client.transport.abort()
    await until(lambda: not graph._topics["/t"].subscribers)
    await until(lambda: " left" in caplog.text)
    assert warnings_of(caplog) == []
    assert all(vars(line)["client"] for line in caplog.records if line.name == "armbridge.gateway")


async def test_a_client_that_does_not_read_its_replies_is_closed_with_a_code_and_a_log_line(
    graph: Graph, url: str, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "UNREAD_TIMEOUT_S", 0.2)
    graph.services.offer(TALKER, "/long", "std_srvs/Trigger", lambda _: {"message": "x" * 5_000_000})
    deaf = await connect(url, max_size=None)
    deaf.transport.pause_reading()
    for _ in range(4):
        await deaf.send(json.dumps({"op": "call_service", "service": "/long"}))
    await until(lambda: "does not read its replies; closing" in caplog.text)
    deaf.transport.resume_reading()
    async with asyncio.timeout(TIMEOUT_S):
        with contextlib.suppress(ConnectionClosed):
            while True:
                await deaf.recv()
    assert deaf.close_code == 1008


@pytest.mark.parametrize(
    ("version", "query", "stamp"),
    [
        (2, "?ros=1", {"secs": 1, "nsecs": 2}),
        (2, "?x=1", {"sec": 1, "nanosec": 2}),
        (1, "?x=1", {"secs": 1, "nsecs": 2}),
        (1, "?ros=2&x=1", {"sec": 1, "nanosec": 2}),
    ],
)
async def test_clients_get_the_spelling_of_their_url_or_of_the_setting(
    graph: Graph, version: int, query: str, stamp: dict[str, int]
) -> None:
    graph.advertise(TALKER, "/h", "std_msgs/Header", latch=True)
    graph.publish(TALKER, "/h", {"stamp": {"sec": 1, "nanosec": 2}})
    async with (
        listening(ServerSettings(port=0, ros_version=version), graph=graph) as listener,
        connect(f"{listener.url}/{query}") as client,
    ):
        await client.send(json.dumps({"op": "subscribe", "topic": "/h"}))
        assert (await receive(client))["msg"]["stamp"] == stamp


async def test_the_messages_of_a_topic_are_numbered_for_ros1(graph: Graph, url: str) -> None:
    graph.advertise(TALKER, "/joints", "sensor_msgs/JointState", latch=True)
    graph.publish(TALKER, "/joints", {})
    async with connect(f"{url}/?ros=1") as client:
        await client.send(json.dumps({"op": "subscribe", "topic": "/joints"}))
        numbers = [(await receive(client))["msg"]["header"]["seq"]]
        for _ in range(2):
            graph.publish(TALKER, "/joints", {})
            numbers.append((await receive(client))["msg"]["header"]["seq"])
    assert numbers == [1, 2, 3]


async def test_a_call_that_runs_does_not_hold_up_what_the_client_says_next(graph: Graph, url: str) -> None:
    answer = asyncio.Event()

    async def slow(_request: dict[str, Any]) -> dict[str, Any]:
        await answer.wait()
        return {}

    graph.services.offer(TALKER, "/slow", "std_srvs/Trigger", slow)
    async with connect(url) as client:
        for service in ("/slow", "/nobody"):
            await client.send(json.dumps({"op": "call_service", "service": service}))
        assert (await receive(client))["service"] == "/nobody"
        answer.set()
        assert (await receive(client))["service"] == "/slow"


@pytest.mark.parametrize(
    ("query", "ends"), [("", False), ("?on_disconnect=stop", True), ("?on_disconnect=finish", False)]
)
async def test_the_url_decides_if_goals_end_with_a_client(graph: Graph, url: str, query: str, *, ends: bool) -> None:
    async with connect(f"{url}/{query}") as client:
        await client.send(SUBSCRIBE)
        await until_subscribed(graph, 1)
        assert [node.takes_goals_along for node in graph.subscribers("/t")] == [ends]


class TestGuarded:
    """A server with tokens, and clients that show theirs by the op ``auth``."""

    TOKEN = "ada-0123456789abcdef"
    SCREEN = "screen-0123456789abcdef"

    @pytest.fixture
    async def guarded(self, graph: Graph) -> AsyncIterator[Listener]:
        settings = AccessSettings.model_validate(
            {"admin_tokens": {"ada": self.TOKEN}, "view_tokens": {"screen": self.SCREEN}}
        )
        async with listening(graph=graph, access=Access(settings)) as listener:
            yield listener

    @pytest.fixture
    def guarded_url(self, guarded: Listener) -> str:
        return guarded.url

    async def closed(self, client: ClientConnection) -> tuple[int | None, str | None]:
        await asyncio.wait_for(client.wait_closed(), TIMEOUT_S)
        return client.close_code, client.close_reason

    async def test_anything_else_first_closes_it(self, guarded_url: str, graph: Graph) -> None:
        async with connect(guarded_url) as client:
            await client.send(SUBSCRIBE)
            code, reason = await self.closed(client)
        assert (code, reason) == (1008, "the first message must be auth, with a token of this server")
        assert graph.subscribers("/t") == []

    async def test_silence_closes_it(self, guarded_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(connection, "AUTH_TIMEOUT_S", 0.05)
        async with connect(guarded_url) as client:
            assert await self.closed(client) == (1008, "the op auth is wanted within 0.05 s")

    async def test_a_large_message_closes_it_before_it_is_read(self, guarded_url: str) -> None:
        async with connect(guarded_url) as client:
            await client.send("x" * 200_000)
            code, _ = await self.closed(client)
        assert code == 1009

    async def test_a_token_lifts_the_client_s_limits(self, guarded: Listener, guarded_url: str, graph: Graph) -> None:
        async with connect(guarded_url, max_size=None) as client:
            await client.send(json.dumps({"op": "auth", "token": self.TOKEN}))
            await client.send(SUBSCRIBE)
            for size in (100_000, 1_500_000):
                await client.send(json.dumps({"op": "publish", "topic": "/t", "msg": {"data": "x" * size}}))
                assert len(await asyncio.wait_for(client.recv(), TIMEOUT_S)) > size
            (served,) = guarded.traffic._open
            # What happens when the time for it is over.
            assert isinstance(served, connection.Connection)
            served._check_authenticated()
            await asyncio.wait_for(await client.ping(), TIMEOUT_S)
            assert [str(node).startswith("ada (127.0.0.1:") for node in graph.subscribers("/t")] == [True]

    @pytest.mark.parametrize("by_header", [True, False])
    async def test_a_viewer_that_floods_is_not_read_for_a_second(self, guarded_url: str, by_header: bool) -> None:
        header = {"Authorization": f"Bearer {self.SCREEN}"} if by_header else {}
        async with connect(guarded_url, additional_headers=header) as client:
            await client.send(json.dumps({"op": "auth", "token": self.SCREEN}))
            await client.send("x" * (connection.MAX_VIEW_BYTES + 1))
            assert (await self.closed(client))[0] == 1009

    async def test_a_token_in_the_handshake_needs_no_authentication(self, guarded_url: str, graph: Graph) -> None:
        async with connect(guarded_url, additional_headers={"Authorization": f"Bearer {self.TOKEN}"}) as client:
            await client.send(SUBSCRIBE)
            await until_subscribed(graph, 1)
            assert str(graph.subscribers("/t")[0]).startswith("ada (127.0.0.1:")


async def test_a_client_that_hears_little_costs_no_task_of_its_own(graph: Graph, url: str) -> None:
    async with connect(url) as client:
        await client.send(SUBSCRIBE)
        await until_subscribed(graph, 1)
        graph.publish(TALKER, "/t", {"data": "hello"})
        await asyncio.wait_for(client.recv(), TIMEOUT_S)
        assert not [task for task in asyncio.all_tasks() if task.get_name().startswith("write to")]


async def test_a_real_client_is_counted_by_what_it_says_and_hears(graph: Graph) -> None:
    async with listening(graph=graph) as listener, connect(listener.url, compression=None) as client:
        await client.send(SUBSCRIBE)
        await until_subscribed(graph, 1)
        sent_bytes = 0
        for _ in range(3):
            graph.publish(TALKER, "/t", {"data": "x" * 200})
            # Two bytes of a frame's head, and two of its length.
            sent_bytes += len(await client.recv()) + 4
        counts = listener.traffic.counts()
        assert (listener.traffic.clients, counts.received_messages, counts.sent_messages) == (1, 1, 3)
        assert counts.sent_bytes == sent_bytes
        assert len(SUBSCRIBE) < counts.received_bytes < len(SUBSCRIBE) + 1000
        assert (counts.dropped_messages, counts.refused_operations, listener.traffic.queued_bytes()) == (0, 0, (0, 0))
        for nonsense in ("{", json.dumps({"op": "publish", "topic": "/t", "msg": {"data": 1}})):
            await client.send(nonsense)
        await until(lambda: listener.traffic.counts().refused_operations == 2)
    assert (listener.traffic.clients, listener.traffic.counts().sent_messages) == (0, 3)

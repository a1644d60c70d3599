import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from harness.waiting import until
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.gateway import connection
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.graph.permissions import Node
from server.graph.topics import Graph
from tests.helpers.gateway import TIMEOUT_S, listening, receive, say, warnings_of
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


SUBSCRIBE = json.dumps({"op": "subscribe", "topic": "/t"})


@contextlib.asynccontextmanager
async def subscribed(graph: Graph, url: str, **options: Any) -> AsyncIterator[ClientConnection]:
    """A client of /t."""
    async with connect(url, **options) as client:
        await client.send(SUBSCRIBE)
        await until(lambda: graph._topics["/t"].subscribers)
        yield client


async def test_an_aborted_client_leaves_the_graph(graph: Graph, url: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    async with subscribed(graph, url) as client:
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
        await say(deaf, "call_service", service="/long")
    await until(lambda: "does not read its replies; closing" in caplog.text)
    deaf.transport.resume_reading()
    async with asyncio.timeout(TIMEOUT_S):
        with contextlib.suppress(ConnectionClosed):
            while True:
                await deaf.recv()
    assert deaf.close_code == 1008


@pytest.mark.parametrize(
    ("version", "query", "ros1"), [(2, "?ros=1", True), (2, "?x=1", False), (1, "?x=1", True), (1, "?ros=2&x=1", False)]
)
async def test_clients_get_the_spelling_of_their_url_or_of_the_setting_and_ros1_numbers(
    graph: Graph, version: int, query: str, ros1: bool
) -> None:
    message = {"header": {"stamp": {"sec": 1, "nanosec": 2}}}
    graph.advertise(TALKER, "/joints", "sensor_msgs/JointState", latch=True)
    graph.publish(TALKER, "/joints", message)
    async with (
        listening(ServerSettings(port=0, ros_version=version), graph=graph) as listener,
        connect(f"{listener.url}/{query}") as client,
    ):
        await say(client, "subscribe", topic="/joints")
        headers = [(await receive(client))["msg"]["header"]]
        for _ in range(2):
            graph.publish(TALKER, "/joints", message)
            headers.append((await receive(client))["msg"]["header"])
    spelled = {"secs": 1, "nsecs": 2} if ros1 else {"sec": 1, "nanosec": 2}
    assert [header["stamp"] for header in headers] == [spelled] * 3
    assert [header.get("seq") for header in headers] == ([1, 2, 3] if ros1 else [None] * 3)


@pytest.mark.parametrize(
    ("query", "ends"), [("", False), ("?on_disconnect=stop", True), ("?on_disconnect=finish", False)]
)
async def test_the_url_decides_if_goals_end_with_a_client(graph: Graph, url: str, query: str, *, ends: bool) -> None:
    async with subscribed(graph, f"{url}/{query}"):
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

    async def closed(self, client: ClientConnection) -> tuple[int | None, str | None]:
        await asyncio.wait_for(client.wait_closed(), TIMEOUT_S)
        return client.close_code, client.close_reason

    async def test_anything_else_first_closes_it(self, guarded: Listener, graph: Graph) -> None:
        async with connect(guarded.url) as client:
            await client.send(SUBSCRIBE)
            reason = "the first message must be auth, with a token of this server"
            assert await self.closed(client) == (1008, reason)
        assert graph.subscribers("/t") == []

    async def test_silence_closes_it(self, guarded: Listener, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(connection, "AUTH_TIMEOUT_S", 0.05)
        async with connect(guarded.url) as client:
            assert await self.closed(client) == (1008, "the op auth is wanted within 0.05 s")

    @pytest.mark.parametrize(
        ("shown", "by_header", "size"),
        [
            ("", False, connection.MAX_UNKNOWN_BYTES),
            (SCREEN, True, connection.MAX_VIEW_BYTES),
            (SCREEN, False, connection.MAX_VIEW_BYTES),
        ],
    )
    async def test_a_message_beyond_the_limit_of_the_role_closes_it_before_it_is_read(
        self, guarded: Listener, shown: str, by_header: bool, size: int
    ) -> None:
        header = {"Authorization": f"Bearer {shown}"} if by_header else {}
        async with connect(guarded.url, additional_headers=header) as client:
            if shown:
                await say(client, "auth", token=shown)
            await client.send("x" * (size + 1))
            assert (await self.closed(client))[0] == 1009

    async def test_a_token_lifts_the_client_s_limits(self, guarded: Listener, graph: Graph) -> None:
        async with connect(guarded.url, max_size=None) as client:
            await say(client, "auth", token=self.TOKEN)
            await client.send(SUBSCRIBE)
            for size in (100_000, 1_500_000):
                await say(client, "publish", topic="/t", msg={"data": "x" * size})
                assert len((await receive(client))["msg"]["data"]) == size
            (served,) = guarded.traffic._open
            # What happens when the time for it is over.
            assert isinstance(served, connection.Connection)
            served._check_authenticated()
            await asyncio.wait_for(await client.ping(), TIMEOUT_S)
            assert [str(node).startswith("ada (127.0.0.1:") for node in graph.subscribers("/t")] == [True]

    async def test_a_token_in_the_handshake_needs_no_authentication(self, guarded: Listener, graph: Graph) -> None:
        async with subscribed(graph, guarded.url, additional_headers={"Authorization": f"Bearer {self.TOKEN}"}):
            assert str(graph.subscribers("/t")[0]).startswith("ada (127.0.0.1:")


async def test_a_real_client_is_counted_by_what_it_says_and_hears_and_costs_no_task_of_its_own(graph: Graph) -> None:
    async with listening(graph=graph) as listener, subscribed(graph, listener.url, compression=None) as client:
        sent_bytes = 0
        for _ in range(3):
            graph.publish(TALKER, "/t", {"data": "x" * 200})
            # Two bytes of a frame's head, and two of its length.
            sent_bytes += len(await client.recv()) + 4
        assert not [task for task in asyncio.all_tasks() if task.get_name().startswith("write to")]
        counts = listener.traffic.counts()
        assert (listener.traffic.clients, counts.received_messages, counts.sent_messages) == (1, 1, 3)
        assert counts.sent_bytes == sent_bytes
        assert len(SUBSCRIBE) < counts.received_bytes < len(SUBSCRIBE) + 1000
        assert (counts.dropped_messages, listener.traffic.queued_bytes()) == (0, 0)
    assert (listener.traffic.clients, listener.traffic.counts().sent_messages) == (0, 3)

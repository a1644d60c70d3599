from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import ssl
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

import bson
import pytest

from protocol.limits import Limits
from protocol.publication import EncodedMessage, Frame
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.errors import StartError
from server.gateway import connection, transport
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.gateway.transport import OUT_OF_MEMORY, TcpStream
from server.graph.permissions import Node
from server.graph.topics import Graph
from tests.conformance.players import TURNS, serving, streams_of, until_read
from tests.helpers.gateway import REGISTRY, TIMEOUT_S, until_empty, warnings_of
from tests.helpers.raw_tcp import RawClient
from tests.helpers.resources import make_pair

TALKER = Node("talker")


def port_of(listener: Listener) -> int:
    assert listener.tcp_port is not None
    return listener.tcp_port


@pytest.fixture
async def graph() -> Graph:
    made = Graph(REGISTRY)
    made.advertise(TALKER, "/t", "std_msgs/String", latch=True)
    made.publish(TALKER, "/t", {"data": "hello"})
    made.services.offer(TALKER, "/trigger", "std_srvs/Trigger", lambda _: {"success": True, "message": "done"})
    return made


@pytest.fixture
async def listener(graph: Graph) -> AsyncIterator[Listener]:
    async with serving(graph, limits=Limits(max_message_bytes=1_000_000)) as made:
        yield made


@contextlib.asynccontextmanager
async def attended(listener: Listener) -> AsyncIterator[tuple[RawClient, TcpStream]]:
    """A client of JSON that is served, and the server's end of its connection."""
    async with await RawClient.connect(port_of(listener)) as client:
        client.send(op="call_service", service="/nobody")
        await client.receive()
        (stream,) = streams_of(listener)
        yield client, stream


both = pytest.mark.parametrize("speaks_bson", [True, False], ids=["bson", "json"])


async def test_clients_get_the_spelling_of_the_generation_that_is_set() -> None:
    graph = Graph(REGISTRY)
    graph.advertise(TALKER, "/h", "std_msgs/Header", latch=True)
    graph.publish(TALKER, "/h", {"stamp": {"sec": 1, "nanosec": 2}})
    async with (
        serving(graph, tcp_ros_version=1) as listener,
        await RawClient.connect(port_of(listener), speaks_bson=True) as client,
    ):
        client.send(op="subscribe", topic="/h")
        header = await client.until_topic("/h")
        assert (header["stamp"], "seq" in header) == ({"secs": 1, "nsecs": 2}, True)


@pytest.mark.parametrize("turn_s", [0.0, 60.0])
@pytest.mark.parametrize("piece_bytes", [7, 1_000_000])
@both
async def test_a_flood_is_carried_out_in_order_however_it_is_cut_and_however_long_a_turn_is(
    listener: Listener, monkeypatch: pytest.MonkeyPatch, turn_s: float, piece_bytes: int, *, speaks_bson: bool
) -> None:
    monkeypatch.setattr(transport, "TURN_S", turn_s)
    numbers = [str(number) for number in range(300)]
    said = [{"op": "publish", "topic": "/numbers", "msg": {"data": number}} for number in numbers]
    flood = b"".join(bson.encode(each) if speaks_bson else json.dumps(each).encode() for each in said)
    async with await RawClient.connect(port_of(listener), speaks_bson=speaks_bson) as client:
        client.send(op="subscribe", topic="/numbers", type="std_msgs/String")
        await until_read(listener, client)
        (stream,) = streams_of(listener)
        for begin in range(0, len(flood), piece_bytes):
            stream.data_received(flood[begin : begin + piece_bytes])
        assert [(await client.until_topic("/numbers"))["data"] for _ in numbers] == numbers


@pytest.mark.parametrize(
    ("stream", "sentence"),
    [
        (b"POST / HTTP/1.1\r\n\r\n" + b'{"op":"publish","topic":"/t","msg":{"data":"x"}}', "port of their own"),
        ((2**26).to_bytes(4, "little"), "a BSON document of 67108864 bytes, the limits are 5 and 1000000"),
        (b'{"op": "call_service", "service": "/trigger", "id": "before"}#', "wanted"),
    ],
    ids=["http", "long document", "behind an operation"],
)
async def test_a_stream_that_cannot_be_cut_is_told_why_and_closed(
    graph: Graph, listener: Listener, caplog: pytest.LogCaptureFixture, stream: bytes, sentence: str
) -> None:
    async with await RawClient.connect(port_of(listener), speaks_bson=stream[3] in (0, 4)) as client:
        client.write(stream)
        if b"before" in stream:
            assert (await client.receive())["id"] == "before"
        status = await client.receive()
        assert (status["op"], status["level"]) == ("status", "error")
        assert sentence in status["msg"]
        assert await client.next_frame() is None
    await until_empty(listener)
    assert status["msg"] in caplog.text
    assert list(graph.publishers("/t")) == [TALKER]


class FullMemory(bytearray):
    """Bytes to which none can be added."""

    def __iadd__(self, _: object) -> FullMemory:  # type: ignore[override, misc]
        raise MemoryError


async def test_a_connection_whose_bytes_cannot_be_kept_is_told_so_and_closed_with_one_line(
    listener: Listener, caplog: pytest.LogCaptureFixture
) -> None:
    async with attended(listener) as (client, stream):
        stream._splitter._data = FullMemory()
        client.send(op="publish", topic="/t", msg={"data": "own"})
        assert await client.receive() == {"op": "status", "level": "error", "msg": OUT_OF_MEMORY}
    await until_empty(listener)
    (line,) = warnings_of(caplog)
    assert line.endswith(f"connection closed: {OUT_OF_MEMORY}")


class TurnsOfTheLoop:
    """Transport that notes the turn of the loop in which each frame is written."""

    def __init__(self, real: Any) -> None:
        self._real = real
        self._turn = 0
        self.turns: list[int] = []
        self._count()

    def _count(self) -> None:
        self._turn += 1
        asyncio.get_running_loop().call_soon(self._count)

    def writelines(self, frames: Sequence[bytes]) -> None:
        self.turns += [self._turn for _ in frames]
        self._real.writelines(frames)

    def write(self, frame: bytes) -> None:
        """On the Pythons of `WRITELINES_NEVER_PAUSES`."""
        self.turns.append(self._turn)
        self._real.write(frame)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)


async def test_each_message_is_a_send_of_its_own(graph: Graph, listener: Listener) -> None:
    async with await RawClient.connect(port_of(listener)) as client:
        client.send(op="subscribe", topic="/t")
        await client.receive()
        (stream,) = streams_of(listener)
        stream._transport = noted = TurnsOfTheLoop(stream._transport)  # type: ignore[assignment]
        for number in range(20):
            graph.publish(TALKER, "/t", {"data": str(number)})
        assert [(await client.until_topic("/t"))["data"] for _ in range(20)] == [str(number) for number in range(20)]
    assert len(set(noted.turns)) == len(noted.turns) == 20


async def test_a_subscription_begins_with_the_newest_message_at_most(graph: Graph, listener: Listener) -> None:
    graph.advertise(TALKER, "/recent", "std_msgs/String")
    for number in range(5):
        graph.publish(TALKER, "/recent", {"data": str(number)}, lifespan_s=60.0)
    async with await RawClient.connect(port_of(listener)) as client:
        client.send(op="subscribe", topic="/recent")
        client.send(op="call_service", service="/trigger", id="then")
        assert (await client.receive())["msg"] == {"data": "4"}
        assert (await client.receive())["id"] == "then"


# A call a turn, so that most of them wait when the client's end is seen; and answers longer than what is sent at once.
@pytest.mark.parametrize(("turn_s", "length"), [(0.0, 1), (transport.TURN_S, 100_000)])
async def test_a_half_closed_client_gets_its_answers(
    graph: Graph, listener: Listener, monkeypatch: pytest.MonkeyPatch, turn_s: float, length: int
) -> None:
    monkeypatch.setattr(transport, "TURN_S", turn_s)
    graph.services.offer(TALKER, "/long", "std_srvs/Trigger", lambda _: {"success": True, "message": "x" * length})
    async with await RawClient.connect(port_of(listener)) as client:
        for number in range(50):
            client.send(op="call_service", service="/long", id=str(number))
        client.writer.write_eof()
        assert [(await client.receive())["id"] for _ in range(50)] == [str(number) for number in range(50)]
        assert await client.next_frame() is None


async def test_a_client_that_goes_on_sending_is_told_why_it_is_closed(listener: Listener) -> None:
    async with await RawClient.connect(port_of(listener)) as client:
        for _ in range(100):
            client.write(b"#" * 100_000)
        assert "wanted a JSON object" in (await client.receive())["msg"]
        # Its end comes, not a reset, which would take the message with it on some systems.
        assert await asyncio.wait_for(client.reader.read(), TIMEOUT_S) == b""


async def test_a_client_that_closes_its_side_is_let_go(listener: Listener, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "END_TIMEOUT_S", 10 * TIMEOUT_S)
    async with attended(listener) as (client, stream):
        stream.hold_reading()
        stream.end("enough")
        assert (await client.receive())["msg"] == "enough"
    await until_empty(listener)


async def test_the_writer_waits_while_the_client_reads_nothing(listener: Listener) -> None:
    encoded = EncodedMessage(Frame(b"x" * 100_000, text=True))
    async with attended(listener) as (client, stream):
        client.writer.transport.pause_reading()  # type: ignore[attr-defined]
        for _ in range(1000):
            stream.send_at_once(encoded)
            await asyncio.sleep(0)
        draining = asyncio.create_task(stream.drain())
        for _ in range(TURNS):
            await asyncio.sleep(0)
        assert not draining.done()
        client.writer.transport.resume_reading()  # type: ignore[attr-defined]
        await asyncio.wait_for(draining, TIMEOUT_S)


async def test_a_client_that_leaves_is_taken_out_of_the_graph_and_counted(graph: Graph, listener: Listener) -> None:
    client = await RawClient.connect(port_of(listener))
    client.send(op="subscribe", topic="/t")
    await client.receive()
    client.writer.transport.abort()
    await client.close()
    await until_empty(listener)
    assert not graph.subscribers("/t")
    sent_bytes = len(b'{"op":"publish","topic":"/t","msg":{"data":"hello"}}')
    assert listener.traffic.counts()[:4] == (1, client.sent_bytes, 1, sent_bytes)


async def test_connections_of_both_ports_count_together() -> None:
    async with serving(Graph(REGISTRY), max_clients=1) as listener, await RawClient.connect(port_of(listener)) as first:
        first.send(op="call_service", service="/nobody")
        await first.receive()
        async with await RawClient.connect(port_of(listener)) as second:
            status = await second.receive()
            assert "1 connections are open, the limit is 1 (server.max_clients)" in status["msg"]
            assert await second.next_frame() is None


async def test_the_system_asks_idle_clients_whether_they_are_there_and_delays_no_message() -> None:
    pings = {"ping_interval_s": 7.0, "ping_timeout_s": 5.0}
    async with serving(Graph(REGISTRY), **pings) as listener, attended(listener) as (_, stream):
        accepted = stream._transport.get_extra_info("socket")
        options = (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_USER_TIMEOUT)
        assert accepted.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 1
        assert [accepted.getsockopt(socket.IPPROTO_TCP, option) for option in options] == [7, 2, 12_000]


async def test_closing_ends_every_connection_at_once(listener: Listener, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "END_TIMEOUT_S", 10 * TIMEOUT_S)
    async with attended(listener) as (client, _):
        await asyncio.wait_for(listener.close(), TIMEOUT_S)
        assert await client.next_frame() is None
    assert not streams_of(listener)
    assert listener.traffic.clients == 0


async def test_a_port_that_is_taken_is_told_with_its_option() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        listener = Listener(Graph(REGISTRY), ServerSettings(port=0, tcp_port=port))
        with pytest.raises(StartError, match=f"port in use: 127.0.0.1:{port} .* --tcp-port"):
            await listener.bind()
        await listener.close()


async def test_with_a_certificate_the_port_is_encrypted(tmp_path: Path, graph: Graph) -> None:
    pair = make_pair(tmp_path)
    trusting = ssl.create_default_context(cafile=str(pair.certificate))
    async with serving(graph, tls_certificate=pair.certificate, tls_key=pair.key) as listener:
        assert str(listener.tcp_url).startswith("tls://")
        client = await RawClient.connect(port_of(listener), ssl=trusting, server_hostname="localhost")
        async with client:
            client.send(op="call_service", service="/trigger", id="1")
            assert (await client.receive())["result"] is True
            client.write(b"#")
            assert (await client.receive())["op"] == "status"
            assert await client.next_frame() is None


class TestGuarded:
    """A server with tokens, which clients show by the op ``auth``."""

    TOKEN = "ada-0123456789abcdef"

    @pytest.fixture
    async def guarded(self, graph: Graph) -> AsyncIterator[Listener]:
        tokens = {"admin_tokens": {"ada": self.TOKEN}}
        async with serving(graph, access=Access(AccessSettings.model_validate(tokens))) as made:
            yield made

    @both
    async def test_a_client_that_shows_its_token_first_is_served(self, guarded: Listener, *, speaks_bson: bool) -> None:
        async with await RawClient.connect(port_of(guarded), speaks_bson=speaks_bson) as client:
            client.send(op="auth", token=self.TOKEN)
            client.send(op="call_service", service="/trigger", id="1")
            assert (await client.receive())["result"] is True

    async def test_a_long_message_without_a_token_is_not_read(self, guarded: Listener) -> None:
        async with await RawClient.connect(port_of(guarded), speaks_bson=True) as client:
            client.write((200_000).to_bytes(4, "little"))
            assert f"the limits are 5 and {connection.MAX_UNKNOWN_BYTES}" in (await client.receive())["msg"]

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import logging
import select
import socket
import weakref
from collections.abc import AsyncIterator
from typing import NamedTuple

import pytest
from pydantic import SecretStr
from websockets.asyncio.client import ClientConnection, connect
from websockets.frames import Frame, Opcode

from harness.waiting import until
from protocol.publication import EncodedMessage, PublishedMessage
from protocol.publication import Frame as Payload
from robot.stop_epochs import STOP_EPOCHS
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.arrival import arrival_epoch
from server.gateway import listener as listener_module
from server.gateway import transport, turns, websocket
from server.gateway.connection import MAX_UNKNOWN_BYTES, Connection
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.gateway.transport import OUT_OF_MEMORY, WRITE_LIMIT_BYTES
from server.gateway.websocket import WebSocket
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from tests.helpers.gateway import (
    TIMEOUT_S,
    UPGRADE,
    FullTransport,
    connected,
    exchange,
    limiter_of,
    listening,
    receive,
    request,
    say,
    status,
    until_empty,
    warnings_of,
)
from tests.helpers.messages import REGISTRY

TALKER = Node("talker")
TOKENS = AccessSettings(token=SecretStr("right-" * 6))
NUMBERS = [str(number) for number in range(300)]


class Link(NamedTuple):
    """A real client, the server's end of its socket, and the graph behind it."""

    client: ClientConnection
    server: WebSocket
    graph: Graph

    async def received(self, count: int) -> list[str]:
        return [(await receive(self.client))["msg"]["data"] for _ in range(count)]


@contextlib.asynccontextmanager
async def linked() -> AsyncIterator[Link]:
    """A client that has subscribed to /t."""
    graph = Graph(REGISTRY)
    graph.advertise(TALKER, "/t", "std_msgs/String")
    async with listening(graph=graph) as listener, connect(listener.url, compression=None) as client:
        await say(client, "subscribe", topic="/t")
        await until(lambda: graph.subscribers("/t"))
        (server,) = listener._transports
        assert isinstance(server, WebSocket)
        yield Link(client, server, graph)


def frame(data: bytes, opcode: Opcode = Opcode.TEXT, *, fin: bool = True) -> bytes:
    """A frame as clients send it."""
    return Frame(opcode, data, fin).serialize(mask=True)


def publication(data: str) -> bytes:
    return json.dumps({"op": "publish", "topic": "/t", "msg": {"data": data}}).encode()


def flood_of(numbers: list[str]) -> bytes:
    return b"".join(frame(publication(number)) for number in numbers)


FLOOD = flood_of(NUMBERS)


@pytest.mark.parametrize("turn_s", [0.0, 60.0])
@pytest.mark.parametrize("piece_bytes", [1, 7, 10_000, len(FLOOD)])
async def test_a_flood_is_carried_out_in_order_however_it_is_cut_and_however_long_a_turn_is(
    monkeypatch: pytest.MonkeyPatch, turn_s: float, piece_bytes: int
) -> None:
    monkeypatch.setattr(transport, "TURN_S", turn_s)
    numbers = NUMBERS if piece_bytes > 7 else NUMBERS[:30]
    flood = flood_of(numbers)
    async with linked() as link:
        for begin in range(0, len(flood), piece_bytes):
            link.server.data_received(flood[begin : begin + piece_bytes])
        assert await link.received(len(numbers)) == numbers
        assert not link.server._data


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each frame is carried out as it is handed over, also where the machine is busy."""
    monkeypatch.setattr(turns, "TURN_S", 60.0)
    monkeypatch.setattr(transport, "TURN_S", 60.0)
    monkeypatch.setattr(turns, "ROUND_S", 60.0)


def heard_epochs(link: Link) -> list[int]:
    """The epochs of the publications on /t, to be filled; "stop" is a stop of the client itself."""
    epochs: list[int] = []

    def hear(published: PublishedMessage) -> None:
        epochs.append(arrival_epoch())
        if published.msg["data"] == "stop":
            STOP_EPOCHS.begin()

    link.graph.subscribe(TALKER, "/t", "std_msgs/String", Subscriber(hear))
    return epochs


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("own", [False, True], ids=["another client's", "its own"])
async def test_what_waits_for_its_turn_when_a_stop_comes_is_older_unless_it_came_behind_the_clients_own(
    monkeypatch: pytest.MonkeyPatch, *, own: bool
) -> None:
    monkeypatch.setattr(transport, "TURN_S", 0.0)
    async with linked() as link:
        epochs, before = heard_epochs(link), STOP_EPOCHS.present
        link.server.data_received(flood_of(["stop" if own else "1", "2", "3"]))
        assert len(epochs) == 1
        if not own:
            STOP_EPOCHS.begin()
        await until(lambda: len(epochs) == 3)
        later = STOP_EPOCHS.present if own else before
        assert epochs == [before, later, later]


@pytest.mark.usefixtures("at_once")
async def test_what_the_socket_held_unread_when_another_client_stopped_is_older_than_the_stop() -> None:
    async with linked() as link:
        epochs, before = heard_epochs(link), STOP_EPOCHS.present
        link.server._transport.pause_reading()
        await link.client.send(publication("1").decode())
        descriptor = link.server._transport.get_extra_info("socket").fileno()
        await until(lambda: bool(select.select([descriptor], [], [], 0)[0]))
        STOP_EPOCHS.begin()
        await link.client.send(publication("2").decode())
        link.server._transport.resume_reading()
        await until(lambda: len(epochs) == 2)
        await link.client.send(publication("3").decode())
        await until(lambda: len(epochs) == 3)
        assert epochs == [before, STOP_EPOCHS.present, STOP_EPOCHS.present]


@pytest.mark.usefixtures("at_once")
async def test_what_comes_on_a_connection_that_waited_to_be_accepted_when_a_stop_came_is_older() -> None:
    graph = Graph(REGISTRY)
    graph.advertise(TALKER, "/t", "std_msgs/String")
    heard: dict[str, int] = {}

    def hear(published: PublishedMessage) -> None:
        heard[published.msg["data"]] = arrival_epoch()

    graph.subscribe(TALKER, "/t", "std_msgs/String", Subscriber(hear))
    listener = Listener(graph, ServerSettings(port=0))
    await listener.bind()
    with socket.create_connection(("127.0.0.1", listener.port)) as waiting:
        before = STOP_EPOCHS.present
        waiting.sendall(request(*UPGRADE) + frame(publication("waiting")))
        STOP_EPOCHS.begin()
        await listener.open()
        await until(lambda: len(heard) == 1)
        waiting.sendall(frame(publication("later")))
        with socket.create_connection(("127.0.0.1", listener.port)) as new:
            new.sendall(request(*UPGRADE) + frame(publication("new")))
            await until(lambda: len(heard) == 3)
        await listener.close()
    assert heard == {"waiting": before, "later": STOP_EPOCHS.present, "new": STOP_EPOCHS.present}


@pytest.mark.usefixtures("at_once")
async def test_what_the_socket_held_unread_behind_the_clients_own_stop_is_later() -> None:
    async with linked() as link:
        epochs, before = heard_epochs(link), STOP_EPOCHS.present
        link.server._transport.pause_reading()
        # More than the event loop reads at once.
        for each in ("stop", *["x" * 2_000] * 199):
            await link.client.send(publication(each).decode())
        link.server._transport.resume_reading()
        await link.received(200)
        assert epochs == [before, *[STOP_EPOCHS.present] * 199]


@pytest.mark.parametrize("piece_bytes", [1, 10_000])
async def test_long_messages_fragments_and_pings_keep_their_order_among_whole_messages(piece_bytes: int) -> None:
    wanted = ["one", "x" * 70_000, "two", "in pieces", "", "three"]
    whole = [frame(publication(data)) for data in wanted]
    pieces = [publication("in pieces")[begin : begin + 30] for begin in range(0, 90, 30)]
    whole[3] = (
        frame(pieces[0], fin=False)
        + frame(b"", Opcode.CONT, fin=False)
        + frame(b"still there?", Opcode.PING)
        + frame(pieces[1], Opcode.CONT, fin=False)
        + frame(pieces[2], Opcode.CONT)
    )
    sent = b"".join(whole)
    async with linked() as link:
        for begin in range(0, len(sent), piece_bytes):
            link.server.data_received(sent[begin : begin + piece_bytes])
        assert await link.received(len(wanted)) == wanted


async def test_frames_that_come_along_with_the_request_are_carried_out() -> None:
    call = frame(b'{"op": "call_service", "service": "/none", "id": "a"}')
    async with listening() as listener:
        for lines in (UPGRADE, (*UPGRADE, "Sec-WebSocket-Protocol: any")):
            async with connected(listener.port) as (reader, writer), asyncio.timeout(TIMEOUT_S):
                for part in (request(*lines)[:-3], request(*lines)[-3:] + call[:5], call[5:]):
                    writer.write(part)
                    await writer.drain()
                assert b" 101 " in await reader.readuntil(b"\r\n\r\n")
                assert b'"id":"a"' in await reader.readuntil(b"}")


async def test_a_connection_that_is_held_reads_on_where_it_stopped() -> None:
    async with linked() as link:
        link.server.hold_reading()
        link.server.data_received(FLOOD)
        assert link.server._data == FLOOD
        link.server.release_reading()
        assert await link.received(len(NUMBERS)) == NUMBERS


class FullMemory(bytes):
    """Bytes to which none can be added."""

    def __getitem__(self, _: object) -> FullMemory:  # type: ignore[override]
        return self

    def __add__(self, _: bytes) -> bytes:  # type: ignore[override]
        raise MemoryError


def full(*_: object, **__: object) -> None:
    raise MemoryError


async def refused_for_memory(link: Link, caplog: pytest.LogCaptureFixture) -> None:
    await asyncio.wait_for(link.client.wait_closed(), TIMEOUT_S)
    await until(lambda: warnings_of(caplog))
    (line,) = warnings_of(caplog)
    assert OUT_OF_MEMORY in line


@pytest.mark.parametrize("place", ["kept", "read", "thread"])
async def test_a_connection_whose_message_finds_no_memory_is_closed_with_one_line(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    async with linked() as link:
        if place == "kept":
            link.server._data = FullMemory(b"{")
        else:
            name = "server.gateway.websocket.apply_mask" if place == "read" else "protocol.codecs.json.orjson.loads"
            monkeypatch.setattr(name, full)
        await link.client.send(publication("x" * 3_000_000).decode() if place == "thread" else "{}")
        await refused_for_memory(link, caplog)
        assert (link.client.close_code, link.client.close_reason) == (1011, OUT_OF_MEMORY)


@pytest.mark.parametrize("burst_s", [-1.0, 60.0], ids=["at once", "at the end of the turn"])
async def test_a_message_that_cannot_be_written_for_want_of_memory_ends_its_connection_alone(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, burst_s: float
) -> None:
    monkeypatch.setattr(transport, "BURST_S", burst_s)
    async with linked() as link:
        link.graph.publish(TALKER, "/t", {"data": "before"})
        link.server._transport = FullTransport(link.server._transport)  # type: ignore[assignment]
        link.graph.publish(TALKER, "/t", {"data": "hello"})
        await refused_for_memory(link, caplog)


@pytest.mark.parametrize(
    ("sent", "code"),
    [
        pytest.param(frame(b"\xff"), 1007, id="no UTF-8"),
        pytest.param(frame(b"\xff", fin=False) + frame(b"", Opcode.CONT), 1007, id="no UTF-8 in pieces"),
        pytest.param(b"\x81\x02{}", 1002, id="no mask"),
        # FIN, RSV1 and text, as compressed frames have it; masked by zeros.
        pytest.param(b"\xc1\x84\x00\x00\x00\x00bomb", 1002, id="compressed"),
        pytest.param(frame(b"{", fin=False) + frame(b"{}"), 1002, id="interleaved"),
        pytest.param(frame(b"{", Opcode.CONT), 1002, id="no beginning"),
    ],
)
async def test_a_frame_against_the_rules_ends_its_connection_with_a_code(sent: bytes, code: int) -> None:
    async with linked() as link:
        link.client.transport.write(sent)
        await asyncio.wait_for(link.client.wait_closed(), TIMEOUT_S)
        assert link.client.close_code == code


async def test_who_has_not_authenticated_sends_no_long_message_in_pieces_either() -> None:
    async with listening(access=Access(TOKENS)) as listener, connect(listener.url, compression=None) as client:
        client.transport.write(frame(b"x" * 1000, fin=False))
        for _ in range(MAX_UNKNOWN_BYTES // 1000):
            client.transport.write(frame(b"x" * 1000, Opcode.CONT, fin=False))
        await asyncio.wait_for(client.wait_closed(), TIMEOUT_S)
        assert client.close_code == 1009


@pytest.mark.parametrize("burst_s", [-1.0, 60.0])
async def test_messages_of_one_turn_arrive_in_order(monkeypatch: pytest.MonkeyPatch, burst_s: float) -> None:
    monkeypatch.setattr(transport, "BURST_S", burst_s)
    async with linked() as link:
        for number in NUMBERS:
            link.graph.publish(TALKER, "/t", {"data": number})
        assert await link.received(len(NUMBERS)) == NUMBERS


async def test_what_waits_for_the_end_of_a_turn_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "BURST_S", 60.0)
    encoded = EncodedMessage(Payload(b"x" * 1000, text=True))
    async with linked() as link:
        waiting_bytes = []
        for _ in range(100):
            assert link.server.send_at_once(encoded)
            waiting_bytes.append(link.server._unsent_bytes)
        assert WRITE_LIMIT_BYTES - 1004 < max(waiting_bytes) <= WRITE_LIMIT_BYTES
        assert [len(await link.client.recv()) for _ in range(100)] == [1000] * 100


async def test_a_connection_that_ends_drops_unread_frames_and_takes_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "TURN_S", 0.0)
    async with linked() as link:
        link.server.data_received(FLOOD)
        link.server.abort()
        await asyncio.wait_for(link.server.wait_ended(), TIMEOUT_S)
        assert not link.server._data
        assert not link.server.send_at_once(EncodedMessage(Payload(b"{}", text=True)))


LOWEST_S = 0.1


async def read_to_end(reader: asyncio.StreamReader) -> bytes:
    async with asyncio.timeout(TIMEOUT_S):
        try:
            return await reader.read()
        except ConnectionError:
            return b""


@contextlib.asynccontextmanager
async def upgraded(
    listener: Listener, sent: bytes = b"", path: str = "/"
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    """A WebSocket whose handshake was answered, as its socket; the bytes come along with the request."""
    async with connected(listener.port, request(*UPGRADE, path=path) + sent) as (reader, writer):
        assert status((await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), TIMEOUT_S)).decode()) == 101
        yield reader, writer


HALF_A_REQUEST = (b"G", b"GET / HTTP/1.1\r\n", b"GET / HTTP/1.1\r\nHost: localhost\r\n")


async def answered(listener: Listener, sent: bytes, *, ended: bool) -> str:
    """The answer to half a request, after which the connection ends."""
    async with connected(listener.port, sent) as (reader, writer):
        if ended:
            writer.write_eof()
        answer = (await read_to_end(reader)).decode()
        await until_empty(listener)
    return answer


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that waits for no end of a client."""
    monkeypatch.setattr(transport, "END_TIMEOUT_S", LOWEST_S)


@pytest.fixture
def hasty(impatient: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that waits for no request, either."""
    monkeypatch.setattr(websocket, "REQUEST_TIMEOUT_S", LOWEST_S)


@pytest.mark.usefixtures("hasty")
async def test_a_client_with_half_a_request_is_answered_400_and_disconnected() -> None:
    for ended, reason in (
        (False, f"the request was not complete within {LOWEST_S:g} s\n"),
        (True, "this is no complete HTTP request: connection closed while reading HTTP"),
    ):
        async with listening() as listener:
            # Without a byte of a request nothing is answered.
            assert await answered(listener, b"", ended=ended) == ""
            for sent in HALF_A_REQUEST:
                answer = await answered(listener, sent, ended=ended)
                assert status(answer) == 400, sent
                assert reason in answer, sent


@pytest.mark.usefixtures("hasty")
async def test_a_client_that_sends_its_request_by_letters_is_disconnected() -> None:
    async with listening() as listener, connected(listener.port) as (reader, writer), asyncio.timeout(TIMEOUT_S):
        ended = asyncio.create_task(read_to_end(reader))
        while not ended.done():
            writer.write(b"x")
            await asyncio.sleep(LOWEST_S / 10)


async def test_a_path_that_is_no_url_opens_a_websocket_with_its_query() -> None:
    async with listening() as listener, upgraded(listener, path="//[?ros=1"):
        (server,) = listener._transports
        assert server.is_open
        assert server.query == {"ros": ["1"]}


async def test_a_request_is_answered_or_its_connection_ends_and_others_are_served() -> None:
    for sent, answer in (
        (request(f"X: {'x' * 40_000}"), 431),
        (b"\x16\x03\x01 this is TLS\r\n\r\n", 400),
        (b"\x00" * 100_000, 414),
        (request(host="evil.com"), 421),
        (request(*UPGRADE, "Origin: http://localhost:3000"), 101),
        (request(*UPGRADE), 101),
        (request(*UPGRADE, path="/../../etc/passwd"), 101),
        (request(path="/../../etc/passwd"), 404),
    ):
        async with listening() as listener, connect(f"ws://127.0.0.1:{listener.port}") as client:
            assert status(await exchange(listener.port, sent)) == answer
            await asyncio.wait_for(await client.ping(), TIMEOUT_S)


async def test_a_client_whose_machine_is_gone_is_let_go(caplog: pytest.LogCaptureFixture) -> None:
    # More often than the settings allow.
    pings = {"ping_interval_s": LOWEST_S / 2, "ping_timeout_s": LOWEST_S / 2}
    async with listening(ServerSettings(port=0).model_copy(update=pings)) as listener:
        async with connected(listener.port, request(*UPGRADE)) as (reader, _):
            assert (await read_to_end(reader)).startswith(b"HTTP/1.1 101")
        await until(lambda: "connection closed" in caplog.text)
    assert "keepalive ping timeout" in caplog.text


async def test_no_token_gets_into_the_log_whatever_its_level(caplog: pytest.LogCaptureFixture) -> None:
    for name in ("", "websockets"):
        caplog.set_level(logging.DEBUG, name)
    token = "correct-horse-battery"
    async with listening() as listener:
        for sent in (request(*UPGRADE, f"Authorization: Bearer {token}"), request(path=f"/nothing?token={token}")):
            assert await exchange(listener.port, sent)
        auth = frame(f'{{"op": "auth", "token": "{token}"}}'.encode())
        async with upgraded(listener, auth, f"/?token={token}"):
            pass
    ours = [record for record in caplog.records if not record.name.startswith("websockets.client")]
    assert ours
    assert not [record for record in ours if token in record.getMessage()]


async def test_the_end_of_the_server_waits_for_no_client_that_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    async with listening() as listener, upgraded(listener) as (reader, _):
        await listener.close()
        # The last of it is the code of an endpoint that goes away (RFC 6455, section 7.4.1).
        assert (await read_to_end(reader)).endswith((1001).to_bytes(2))
    monkeypatch.setattr(listener_module, "CLOSE_TIMEOUT_S", 2 * TIMEOUT_S)
    async with listening() as listener, connected(listener.port, b"GET / HTTP/1.1\r\n"):
        await until(lambda: limiter_of(listener).open_count)
        await asyncio.wait_for(listener.close(), TIMEOUT_S)


async def test_an_answer_names_no_program_nor_compression_and_is_in_full_whatever_follows_its_request() -> None:
    async with listening() as listener:
        upgraded = await exchange(listener.port, request(*UPGRADE, "Sec-WebSocket-Extensions: permessage-deflate"))
        assert status(upgraded) == 101
        assert "Extensions" not in upgraded
        assert "Server:" not in upgraded + await exchange(listener.port, request())
    async with listening() as listener:
        for behind in (b"GET / HTTP/1.1\r\n\r\n", frame(b"{}")):
            answer = await exchange(listener.port, request(path="/nothing") + behind)
            assert (status(answer), answer.count("HTTP/1.1"), answer[-1]) == (404, 1, "\n")
        async with connected(listener.port, request(path="/nothing")) as (reader, writer):
            writer.write_eof()
            assert status((await read_to_end(reader)).decode()) == 404


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("sent", [request(path="/nothing"), b"what\r\n\r\n"])
async def test_a_client_staying_after_an_answer_is_disconnected(sent: bytes, caplog: pytest.LogCaptureFixture) -> None:
    async with listening() as listener, connected(listener.port, sent) as (reader, _):
        assert (await read_to_end(reader)).count(b"HTTP/1.1 4") == 1
        await until_empty(listener)
        gc.collect()
        assert "never retrieved" not in caplog.text


PING_SIZE = 6


async def test_a_client_that_answers_pings_stays_and_a_pong_to_none_counts_for_nothing() -> None:
    pings = {"ping_interval_s": LOWEST_S / 10, "ping_timeout_s": LOWEST_S}
    async with (
        listening(ServerSettings(port=0).model_copy(update=pings)) as listener,
        upgraded(listener) as (reader, writer),
        asyncio.timeout(TIMEOUT_S),
    ):
        asked = set()
        # Longer than the server waits for an answer to the first.
        for _ in range(20):
            ping = await reader.readexactly(PING_SIZE)
            assert ping[:2] == b"\x89\x04"
            asked.add(ping[2:])
            writer.write(frame(b"none", Opcode.PONG) + frame(ping[2:], Opcode.PONG))
        assert len(asked) == 20
        await reader.readexactly(PING_SIZE)
        writer.write(frame(b"none", Opcode.PONG))
        # Close, 1011.
        assert (await reader.read()).startswith(b"\x88\x18\x03\xf3keepalive ping timeout")


@pytest.mark.usefixtures("impatient")
async def test_a_client_that_has_said_goodbye_and_stays_is_disconnected() -> None:
    async with listening() as listener, upgraded(listener) as (_, writer):
        writer.write(b"\x88\x80" + bytes(4))
        await until_empty(listener)


async def test_a_client_that_has_left_is_freed_without_the_garbage_collector() -> None:
    async with listening() as listener:
        gc.collect()
        gc.disable()
        try:
            async with connect(f"ws://127.0.0.1:{listener.port}", compression=None) as client:
                await say(client, "subscribe", topic="/t", type="std_msgs/String")
                (each,) = listener._transports
                (connection,) = listener.traffic._open
                assert isinstance(connection, Connection)
                parts = (each, connection, connection._client, connection._client.topics)
                left = [weakref.ref(part) for part in parts]
                del each, connection, parts
            await until_empty(listener)
            await until(lambda: all(reference() is None for reference in left))
        finally:
            gc.enable()

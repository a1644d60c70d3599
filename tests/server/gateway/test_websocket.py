from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from typing import NamedTuple

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode

from protocol.parcel import Frame as Payload
from protocol.parcel import Parcel
from protocol.registry import Registry
from server.gateway import websocket
from server.gateway.listener import Listener
from server.gateway.websocket import WRITE_LIMIT_BYTES, WebSocket
from server.graph import Graph
from server.node import Node

TALKER = Node("talker")
TIMEOUT_S = 30.0


class Link(NamedTuple):
    """A real client, the server's end of its socket, and the graph behind it."""

    client: ClientConnection
    server: WebSocket
    graph: Graph

    async def subscribe(self) -> None:
        await self.client.send(json.dumps({"op": "subscribe", "topic": "/t"}))
        async with asyncio.timeout(TIMEOUT_S):
            while not self.graph.subscribers("/t"):
                await asyncio.sleep(0.005)

    async def received(self, count: int) -> list[str]:
        async with asyncio.timeout(TIMEOUT_S):
            return [json.loads(await self.client.recv())["msg"]["data"] for _ in range(count)]


@contextlib.asynccontextmanager
async def linked() -> AsyncIterator[Link]:
    graph = Graph(Registry.load())
    graph.advertise(TALKER, "/t", "std_msgs/String")
    listener = Listener(graph, "127.0.0.1", 0)
    await listener.bind()
    await listener.open()
    try:
        async with connect(f"ws://127.0.0.1:{listener.port}", compression=None) as client:
            (websockets_server,) = listener._servers
            (server,) = websockets_server.connections
            assert isinstance(server, WebSocket)
            yield Link(client, server, graph)
    finally:
        await listener.close()


NUMBERS = [str(number) for number in range(1000)]


@pytest.mark.parametrize("turn_s", [0.0, 0.0001, 60.0])
async def test_a_flood_is_carried_out_in_order_however_long_a_turn_is(
    monkeypatch: pytest.MonkeyPatch, turn_s: float
) -> None:
    monkeypatch.setattr(websocket, "TURN_S", turn_s)
    async with linked() as link:
        await link.subscribe()
        frames = (json.dumps({"op": "publish", "topic": "/t", "msg": {"data": number}}) for number in NUMBERS)
        link.client.transport.write(
            b"".join(Frame(Opcode.TEXT, frame.encode()).serialize(mask=True) for frame in frames)
        )
        assert await link.received(1000) == NUMBERS


async def test_what_comes_after_the_clients_turn_waits_and_is_not_overtaken(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = Frame(Opcode.TEXT, b"{}").serialize(mask=True)
    async with linked() as link:
        await link.subscribe()
        carried_out: list[str | bytes] = []
        link.server.on_message = carried_out.append
        for turn_s in (60.0, 0.0, 60.0):
            monkeypatch.setattr(websocket, "TURN_S", turn_s)
            link.server.data_received(frame)
        assert carried_out == ["{}"]
        assert len(link.server.recv_messages.frames) == 2


async def test_text_that_is_no_utf8_ends_the_connection_with_its_code() -> None:
    async with linked() as link:
        link.client.transport.write(Frame(Opcode.TEXT, b"\xff").serialize(mask=True))
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(link.client.recv(), TIMEOUT_S)
        assert link.client.close_code == 1007


@pytest.mark.parametrize("burst_s", [-1.0, 0.0001, 60.0])
async def test_what_leaves_in_one_turn_of_the_loop_arrives_in_order(
    monkeypatch: pytest.MonkeyPatch, burst_s: float
) -> None:
    monkeypatch.setattr(websocket, "BURST_S", burst_s)
    async with linked() as link:
        await link.subscribe()
        for number in NUMBERS:
            link.graph.publish(TALKER, "/t", {"data": number})
        assert await link.received(1000) == NUMBERS


async def test_in_one_turn_of_the_loop_no_more_is_taken_than_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(websocket, "BURST_S", 60.0)
    parcel = Parcel(Payload(b"x" * 1000, text=True))
    async with linked() as link:
        taken = 0
        while taken < 1000 and link.server.send_at_once(parcel):
            taken += 1
        # The first one has left already, and the last one may go beyond.
        assert WRITE_LIMIT_BYTES < taken * len(parcel.on_wire) <= WRITE_LIMIT_BYTES + 2 * len(parcel.on_wire)
        await link.client.ping()
        assert [len(await link.client.recv()) for _ in range(taken)] == [1000] * taken
        assert link.server.send_at_once(parcel)


async def test_a_connection_that_is_closed_takes_nothing() -> None:
    async with linked() as link:
        await link.client.close()
        await asyncio.wait_for(link.server.wait_closed(), TIMEOUT_S)
        assert not link.server.send_at_once(Parcel(Payload(b"{}", text=True)))


def flood_of(count: int) -> bytes:
    frames = (json.dumps({"op": "publish", "topic": "/t", "msg": {"data": str(number)}}) for number in range(count))
    return b"".join(Frame(Opcode.TEXT, frame.encode()).serialize(mask=True) for frame in frames)


async def test_of_a_flood_that_comes_at_once_only_a_turns_worth_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(websocket, "TURN_S", 0.0)
    async with linked() as link:
        await link.subscribe()
        # As if there were time for each message, so that no queue of them fills up first.
        monkeypatch.setattr(WebSocket, "_may_go_first", lambda _websocket: True)
        flood = flood_of(1000)
        link.server.data_received(flood)
        assert len(link.server._unread) == len(flood) - websocket.PIECE_BYTES
        async with asyncio.timeout(TIMEOUT_S):
            while link.server._unread:
                await asyncio.sleep(0)
        assert await link.received(1000) == NUMBERS


async def test_a_flood_is_carried_out_in_order_while_the_queue_fills_again_and_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(websocket, "TURN_S", 0.0)
    async with linked() as link:
        await link.subscribe()
        flood = flood_of(1000)
        for begin in range(0, len(flood), 10_000):
            link.server.data_received(flood[begin : begin + 10_000])
        assert await link.received(1000) == NUMBERS
        assert not link.server._unread


async def test_a_large_message_is_not_read_in_small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    pieces: list[int] = []
    read = websocket.ServerConnection.data_received

    def count(self: WebSocket, data: bytes) -> None:
        pieces.append(len(data))
        read(self, data)

    async with linked() as link:
        monkeypatch.setattr(websocket, "TURN_S", 60.0)
        monkeypatch.setattr(websocket, "PIECE_BYTES", 2048)
        monkeypatch.setattr(websocket.ServerConnection, "data_received", count)
        link.server.data_received(Frame(Opcode.TEXT, b"x" * 200_000).serialize(mask=True))
    assert pieces[:4] == [websocket.PIECE_BYTES * websocket.GROWTH**number for number in range(4)]
    assert len(pieces) < 8


async def test_what_was_not_read_before_a_connection_ends_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(websocket, "TURN_S", 0.0)
    async with linked() as link:
        link.server.data_received(flood_of(1000))
        link.server.transport.abort()
        await asyncio.wait_for(link.server.wait_closed(), TIMEOUT_S)
        await asyncio.sleep(0)
        assert not link.server._unread


async def test_a_connection_forgets_what_was_said_before_it_was_let_in() -> None:
    async with linked() as link:
        assert link.server.request is not None
        assert not link.server.request.headers
        assert link.server.response is None

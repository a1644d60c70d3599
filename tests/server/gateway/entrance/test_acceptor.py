from __future__ import annotations

import asyncio
import json
import socket
import ssl
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import uvloop
from websockets.asyncio.client import connect

from server.gateway import listener as listener_module
from server.gateway.entrance.entrance import Entrance
from server.gateway.entrance.tls import Tls
from server.gateway.entrance.turnstile import BURST_TIME_S, ConnectionLimits, Turnstile
from server.gateway.listener import Listener
from tests.helpers.certificates import Pair, make_pair
from tests.helpers.listener import TIMEOUT_S, exchange, listening, request, status

# Addresses of one machine, each with its own count.
OTHER = ("127.0.0.2", 0)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return make_pair(tmp_path_factory.mktemp("tls"))


@pytest.fixture
async def encrypted(pair: Pair) -> AsyncIterator[Listener]:
    async with listening(Entrance(tls=Tls(*pair))) as listener:
        yield listener


def trusting(pair: Pair) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=pair.certificate)


async def until_empty(listener: Listener) -> None:
    async with asyncio.timeout(TIMEOUT_S):
        while turnstile_of(listener).present:
            await asyncio.sleep(0.005)


def turnstile_of(listener: Listener) -> Turnstile:
    return listener._turnstile


async def is_ended(reader: asyncio.StreamReader) -> bool:
    """Whether the server ends a connection, in whichever way."""
    try:
        async with asyncio.timeout(TIMEOUT_S):
            return await reader.read() == b""
    except ConnectionError:
        return True


async def test_who_is_one_too_many_is_answered_and_comes_in_when_there_is_room() -> None:
    async with listening(Entrance(limits=ConnectionLimits(max_clients_per_address=2))) as listener:
        url = f"ws://127.0.0.1:{listener.port}"
        async with connect(url), connect(url):
            answer = await exchange(listener.port, request("Upgrade: websocket"))
            assert status(answer) == 429
            assert "Retry-After: 5\r\n" in answer
            assert "the limit is 2 (server.max_clients_per_address)" in answer
            async with connect(url, local_addr=OTHER):
                pass
        await until_empty(listener)
        async with connect(url):
            pass


async def test_a_connection_counts_before_it_asks_for_anything() -> None:
    async with listening(Entrance(limits=ConnectionLimits(max_clients=1))) as listener:
        _, writer = await asyncio.open_connection("127.0.0.1", listener.port)
        async with asyncio.timeout(TIMEOUT_S):
            while not turnstile_of(listener).present:
                await asyncio.sleep(0.005)
        assert status(await exchange(listener.port, request())) == 503
        writer.close()
        await until_empty(listener)


async def test_a_flood_of_connections_from_one_address_holds_nobody_else_up(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with listening(Entrance(limits=ConnectionLimits(connections_per_s=5.0))) as listener:
        # The kernel makes the connections, whatever the server does with them.
        flood = [socket.create_connection(("127.0.0.1", listener.port)) for _ in range(300)]
        async with connect(f"ws://127.0.0.1:{listener.port}", local_addr=OTHER) as client:
            await asyncio.wait_for(await client.ping(), TIMEOUT_S)
        # As many as may come at once, and a few seconds' worth more.
        assert turnstile_of(listener).present < 5 * BURST_TIME_S + 50
        with pytest.raises(ConnectionResetError):
            flood[-1].recv(1)
        for each in flood:
            each.close()
        await until_empty(listener)
    assert caplog.text.count("new connections come too often; the limit is 5 a second") == 1


async def talk(url: str, tls: ssl.SSLContext | None, topic: str = "/t") -> None:
    """Send and hear large messages, and many small ones at once."""
    async with connect(url, ssl=tls) as client, asyncio.timeout(TIMEOUT_S):
        await client.send(json.dumps({"op": "subscribe", "topic": topic, "type": "std_msgs/String"}))
        for sizes in ([500_000], [1_000_000], [1] * 300):
            for size in sizes:
                await client.send(json.dumps({"op": "publish", "topic": topic, "msg": {"data": "x" * size}}))
            heard = [json.loads(await client.recv())["msg"]["data"] for _ in sizes]
            assert [len(data) for data in heard] == sizes


async def test_messages_go_both_ways_over_tls(encrypted: Listener, pair: Pair) -> None:
    assert encrypted.url.startswith("wss://127.0.0.1:")
    assert encrypted.page_url.startswith("https://127.0.0.1:")
    await talk(encrypted.url, trusting(pair))


@pytest.mark.parametrize("over_tls", [False, True], ids=["plain", "tls"])
def test_the_event_loop_of_the_server_carries_both(over_tls: bool, pair: Pair) -> None:
    async def serve_and_talk() -> None:
        limits = ConnectionLimits(max_clients_per_address=1)
        async with listening(Entrance(limits=limits, tls=Tls(*pair) if over_tls else None)) as listener:
            await talk(listener.url, trusting(pair) if over_tls else None)
            await until_empty(listener)
            # What is abandoned in its handshake makes room as well.
            _, writer = await asyncio.open_connection("127.0.0.1", listener.port)
            writer.close()
            await until_empty(listener)
            await talk(listener.url, trusting(pair) if over_tls else None, "/u")

    uvloop.run(serve_and_talk())


async def test_who_begins_no_tls_handshake_is_let_go_and_takes_no_place(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener_module, "TLS_HANDSHAKE_TIMEOUT_S", 0.5)
    async with listening(Entrance(limits=ConnectionLimits(max_clients=1), tls=Tls(*pair))) as listener:
        reader, writer = await asyncio.open_connection("127.0.0.1", listener.port)
        async with connect(listener.url, ssl=trusting(pair)):
            assert turnstile_of(listener).present == 1
        assert await is_ended(reader)
        writer.close()
        await until_empty(listener)


async def test_who_speaks_no_tls_is_told_of_in_the_log(encrypted: Listener, caplog: pytest.LogCaptureFixture) -> None:
    for _ in range(2):
        assert await exchange(encrypted.port, request()) == ""
    assert caplog.text.count("a client speaks ws:// or http://, and here is wss:// and https://") == 1


async def test_a_new_certificate_is_for_new_connections(pair: Pair, tmp_path: Path) -> None:
    used, new = Pair(tmp_path / "certificate.pem", tmp_path / "key.pem"), make_pair(tmp_path / "new")
    for source, target in zip(pair, used, strict=True):
        target.write_bytes(source.read_bytes())
    async with listening(Entrance(tls=Tls(*used))) as listener, connect(listener.url, ssl=trusting(pair)) as client:
        for source, target in zip(new, used, strict=True):
            target.write_bytes(source.read_bytes())
        listener.reload_certificate()
        async with connect(listener.url, ssl=trusting(new)):
            await asyncio.wait_for(await client.ping(), TIMEOUT_S)

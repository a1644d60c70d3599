from __future__ import annotations

import asyncio
import gc
import logging

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode

from server.gateway import listener as listener_module
from server.gateway import websocket
from server.gateway.entrance.entrance import Entrance, Pings
from tests.helpers.listener import TIMEOUT_S, UPGRADE, exchange, listening, request, status

LOWEST_S = 0.1

# FIN, RSV1 and text; masked by zeros.
COMPRESSED_FRAME = b"\xc1\x84\x00\x00\x00\x00bomb"


async def read_to_end(reader: asyncio.StreamReader) -> bytes:
    async with asyncio.timeout(TIMEOUT_S):
        try:
            return await reader.read()
        except ConnectionError:
            return b""


@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\nHost: localhost\r\n"], ids=["nothing", "half"])
async def test_who_does_not_finish_its_request_is_let_go(sent: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(websocket, "REQUEST_TIMEOUT_S", LOWEST_S)
    async with listening() as listener:
        reader, writer = await asyncio.open_connection("127.0.0.1", listener.port)
        writer.write(sent)
        assert await read_to_end(reader) == b""
        writer.close()


async def test_who_sends_its_request_letter_by_letter_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(websocket, "REQUEST_TIMEOUT_S", LOWEST_S)
    async with listening() as listener:
        reader, writer = await asyncio.open_connection("127.0.0.1", listener.port)
        ended = asyncio.create_task(read_to_end(reader))
        async with asyncio.timeout(TIMEOUT_S):
            while not ended.done():
                writer.write(b"x")
                await asyncio.sleep(LOWEST_S / 10)
        writer.close()


async def test_who_is_in_stays_in_however_long_ago_it_came(monkeypatch: pytest.MonkeyPatch) -> None:
    # A handshake takes its time on a busy machine.
    monkeypatch.setattr(websocket, "REQUEST_TIMEOUT_S", 0.5)
    async with listening() as listener, connect(f"ws://127.0.0.1:{listener.port}") as client:
        await asyncio.sleep(0.6)
        await asyncio.wait_for(await client.ping(), TIMEOUT_S)


@pytest.mark.parametrize(
    ("sent", "answer"),
    [
        (request(f"X: {'x' * 10_000}"), 431),
        (request(*(f"X-{number}: x" for number in range(200))), 431),
        (request(path=f"/{'x' * 10_000}"), 414),
        (request("Content-Length: 5"), 0),
        (request("Transfer-Encoding: chunked"), 0),
        (b"\x16\x03\x01 this is TLS\r\n\r\n", 0),
        (b"\x00" * 100_000, 414),
        (b"GET / HTTP/2\r\n\r\n", 0),
        (request(host=None), 400),
        (request(host="evil.com"), 421),
        (request("Host: localhost"), 400),
        (request(*UPGRADE, host="evil.com"), 421),
        (request(*UPGRADE, "Origin: http://evil.com"), 403),
        (request(*UPGRADE, "Origin: null"), 403),
        (request(*UPGRADE, "Origin: http://localhost:3000"), 101),
        (request(*UPGRADE), 101),
        (request(*UPGRADE, path="/../../etc/passwd"), 101),
        (request(path="/../../etc/passwd"), 404),
    ],
)
async def test_a_request_is_answered_or_its_connection_ends_and_others_are_served(sent: bytes, answer: int) -> None:
    async with listening() as listener, connect(f"ws://127.0.0.1:{listener.port}") as client:
        assert status(await exchange(listener.port, sent)) == answer
        await asyncio.wait_for(await client.ping(), TIMEOUT_S)


async def test_compression_is_not_agreed_to_and_a_compressed_frame_ends_the_connection() -> None:
    async with listening() as listener, connect(f"ws://127.0.0.1:{listener.port}") as client:
        assert client.response is not None
        assert client.request is not None
        assert "permessage-deflate" in client.request.headers["Sec-WebSocket-Extensions"]
        assert "Sec-WebSocket-Extensions" not in client.response.headers
        client.transport.write(COMPRESSED_FRAME)
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(client.recv(), TIMEOUT_S)
        assert client.close_code == 1002


async def test_a_client_whose_machine_is_gone_is_let_go(caplog: pytest.LogCaptureFixture) -> None:
    async with listening(Entrance(pings=Pings(LOWEST_S / 2, LOWEST_S / 2))) as listener:
        reader, writer = await asyncio.open_connection("127.0.0.1", listener.port)
        writer.write(request(*UPGRADE))
        assert (await read_to_end(reader)).startswith(b"HTTP/1.1 101")
        writer.close()
        async with asyncio.timeout(TIMEOUT_S):
            while "connection closed" not in caplog.text:
                await asyncio.sleep(0.01)
    assert "keepalive ping timeout" in caplog.text


async def test_no_token_gets_into_the_log_whatever_its_level(caplog: pytest.LogCaptureFixture) -> None:
    for name in ("", "websockets", "websockets.server"):
        caplog.set_level(logging.DEBUG, name)
    token = "correct-horse-battery"
    async with listening() as listener:
        url = f"ws://127.0.0.1:{listener.port}/?token={token}"
        for sent in (request(*UPGRADE, f"Authorization: Bearer {token}"), request(path=f"/nothing?token={token}")):
            assert await exchange(listener.port, sent)
        reader, writer = await asyncio.open_connection("127.0.0.1", listener.port)
        writer.write(request(*UPGRADE, path=f"/?token={token}"))
        writer.write(Frame(Opcode.TEXT, f'{{"op": "auth", "token": "{token}"}}'.encode()).serialize(mask=True))
        await reader.readuntil(b"\r\n\r\n")
        writer.close()
        assert url
    ours = [record for record in caplog.records if not record.name.startswith("websockets.client")]
    assert ours
    assert not [record for record in ours if token in record.getMessage()]


async def test_the_end_of_the_server_does_not_wait_for_those_who_have_asked_nothing_yet(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(listener_module, "CLOSE_TIMEOUT_S", 2 * TIMEOUT_S)
    async with listening() as listener:
        _, writer = await asyncio.open_connection("127.0.0.1", listener.port)
        writer.write(b"GET / HTTP/1.1\r\n")
        await asyncio.sleep(0.02)
        await asyncio.wait_for(listener.close(), TIMEOUT_S)
        writer.close()


async def test_the_end_of_the_server_ends_a_client_that_does_not_listen() -> None:
    async with listening() as listener:
        reader, writer = await asyncio.open_connection("127.0.0.1", listener.port)
        writer.write(request(*UPGRADE))
        await reader.readuntil(b"\r\n\r\n")
        await listener.close()
        assert await read_to_end(reader)
        writer.close()


async def test_no_header_tells_which_program_serves() -> None:
    async with listening() as listener:
        for sent in (request(), request(*UPGRADE)):
            assert "Server:" not in await exchange(listener.port, sent)


async def test_who_keeps_its_end_open_after_an_answer_is_let_go_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(listener_module, "CLOSE_TIMEOUT_S", LOWEST_S)
    async with listening() as listener:
        _, writer = await asyncio.open_connection("127.0.0.1", listener.port)
        writer.write(request(path="/nothing"))
        await asyncio.sleep(3 * LOWEST_S)
        gc.collect()
        assert "never retrieved" not in caplog.text
        writer.close()

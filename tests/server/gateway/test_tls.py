from __future__ import annotations

import asyncio
import contextlib
import json
import re
import shlex
import ssl
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import uvloop
from websockets.asyncio.client import connect

from server.errors import ConfigurationError
from server.gateway import listener as listener_module
from server.gateway.connection_limits import ConnectionLimiter, ConnectionLimits
from server.gateway.listener import Listener, ListenerSettings
from server.gateway.tls import Tls
from tests.helpers.certificates import Pair, make_pair, openssl
from tests.helpers.listener import TIMEOUT_S, UPGRADE, exchange, listening, request
from tests.helpers.server import ROOT


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Pair, Pair]:
    return make_pair(tmp_path_factory.mktemp("one")), make_pair(tmp_path_factory.mktemp("other"))


def test_nothing_older_than_tls_1_2_is_spoken(pairs: tuple[Pair, Pair]) -> None:
    assert Tls(*pairs[0]).context.minimum_version is ssl.TLSVersion.TLSv1_2


def test_a_key_of_another_certificate_is_named(pairs: tuple[Pair, Pair]) -> None:
    one, other = pairs
    with pytest.raises(ConfigurationError) as refused:
        Tls(one.certificate, other.key)
    assert str(refused.value) == (
        f"server.tls_key: {other.key} is not the key of the certificate in {one.certificate} (server.tls_certificate)"
    )


@pytest.mark.parametrize("missing", ["certificate", "key"])
def test_a_file_that_cannot_be_read_is_named(pairs: tuple[Pair, Pair], missing: str) -> None:
    pair = pairs[0]._replace(**{missing: Path("/nowhere.pem")})
    with pytest.raises(ConfigurationError, match=f"server.tls_{missing}: /nowhere.pem cannot be read: No such file"):
        Tls(*pair)


@pytest.mark.parametrize(
    ("which", "kind"), [("certificate", "CERTIFICATE"), ("key", "PRIVATE KEY")], ids=["certificate", "key"]
)
def test_a_file_of_something_else_is_named(pairs: tuple[Pair, Pair], which: str, kind: str, tmp_path: Path) -> None:
    (tmp_path / "x.pem").write_bytes(b"\xff\x00 nothing of that kind")
    pair = pairs[0]._replace(**{which: tmp_path / "x.pem"})
    with pytest.raises(ConfigurationError, match=f"server.tls_{which}: .*x.pem has no {kind} in PEM format"):
        Tls(*pair)


def test_a_key_with_a_passphrase_is_refused_and_nobody_is_asked_for_it(
    pairs: tuple[Pair, Pair], tmp_path: Path
) -> None:
    locked = tmp_path / "locked.pem"
    openssl("pkey", "-in", str(pairs[0].key), "-aes256", "-passout", "pass:secret", "-out", str(locked))
    with pytest.raises(ConfigurationError, match="the key has a passphrase") as refused:
        Tls(pairs[0].certificate, locked)
    assert "openssl pkey -in KEY -out NEW" in str(refused.value)


def certificate_shown(tls: Tls) -> bytes:
    """The certificate, in DER, that a client gets that names no server."""
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = trusting.wrap_bio(to_client, to_server)
    server = tls.context.wrap_bio(to_server, to_client, server_side=True)
    for side in (client, server, client, server):
        with contextlib.suppress(ssl.SSLWantReadError):
            side.do_handshake()
    return client.getpeercert(binary_form=True) or b""


def test_a_new_pair_is_taken_and_a_broken_one_is_not(
    pairs: tuple[Pair, Pair], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    one, other = pairs
    used = Pair(tmp_path / "certificate.pem", tmp_path / "key.pem")
    used.certificate.write_bytes(one.certificate.read_bytes())
    used.key.write_bytes(one.key.read_bytes())
    tls = Tls(*used)
    first = certificate_shown(tls)
    assert first == ssl.PEM_cert_to_DER_cert(one.certificate.read_text())
    used.certificate.write_bytes(other.certificate.read_bytes())
    tls.reload()
    assert certificate_shown(tls) == first
    assert "the certificate stays as it was: server.tls_key:" in caplog.text
    used.key.write_bytes(other.key.read_bytes())
    tls.reload()
    assert certificate_shown(tls) == ssl.PEM_cert_to_DER_cert(other.certificate.read_text())


def test_the_command_of_the_security_page_makes_a_pair(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "security.md").read_text()
    found = re.search(r"openssl (req (?:.|\\\n)*?)\n```", text)
    assert found is not None
    words = shlex.split(found[1].replace("\\\n", " "))
    openssl(*(str(tmp_path / word) if word.startswith("arm.") else word for word in words))
    Tls(tmp_path / "arm.pem", tmp_path / "arm.key")


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return make_pair(tmp_path_factory.mktemp("tls"))


@pytest.fixture
async def encrypted(pair: Pair) -> AsyncIterator[Listener]:
    async with listening(ListenerSettings(tls=Tls(*pair))) as listener:
        yield listener


def trusting(pair: Pair) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=pair.certificate)


async def until_empty(listener: Listener) -> None:
    async with asyncio.timeout(TIMEOUT_S):
        while limiter_of(listener).open_count:
            await asyncio.sleep(0.005)


def limiter_of(listener: Listener) -> ConnectionLimiter:
    return listener._limiter


async def is_ended(reader: asyncio.StreamReader) -> bool:
    """Whether the server ends a connection, in whichever way."""
    try:
        async with asyncio.timeout(TIMEOUT_S):
            return await reader.read() == b""
    except ConnectionError:
        return True


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
        async with listening(ListenerSettings(limits=limits, tls=Tls(*pair) if over_tls else None)) as listener:
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
    async with listening(ListenerSettings(limits=ConnectionLimits(max_clients=1), tls=Tls(*pair))) as listener:
        reader, writer = await asyncio.open_connection("127.0.0.1", listener.port)
        async with connect(listener.url, ssl=trusting(pair)):
            assert limiter_of(listener).open_count == 1
        assert await is_ended(reader)
        writer.close()
        await until_empty(listener)


@pytest.mark.parametrize("over_tls", [False, True], ids=["plain", "tls"])
async def test_a_connection_that_gets_no_answer_ends_at_once_and_is_not_read(
    over_tls: bool, pair: Pair, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(ConnectionLimiter, "acquire", lambda *_: None)
    async with listening(ListenerSettings(tls=Tls(*pair) if over_tls else None)) as listener:
        with contextlib.suppress(ConnectionError):
            reader, writer = await asyncio.open_connection(
                "127.0.0.1", listener.port, ssl=trusting(pair) if over_tls else None
            )
            writer.write(request(*UPGRADE))
            assert await is_ended(reader)
            writer.close()
        assert not listener._connections
    assert "Error" not in caplog.text


async def test_who_speaks_no_tls_is_told_of_in_the_log(encrypted: Listener, caplog: pytest.LogCaptureFixture) -> None:
    for _ in range(2):
        assert await exchange(encrypted.port, request()) == ""
    assert caplog.text.count("a client speaks ws:// or http://, and here is wss:// and https://") == 1


async def test_a_new_certificate_is_for_new_connections(pair: Pair, tmp_path: Path) -> None:
    used, new = Pair(tmp_path / "certificate.pem", tmp_path / "key.pem"), make_pair(tmp_path / "new")
    for source, target in zip(pair, used, strict=True):
        target.write_bytes(source.read_bytes())
    async with (
        listening(ListenerSettings(tls=Tls(*used))) as listener,
        connect(listener.url, ssl=trusting(pair)) as client,
    ):
        for source, target in zip(new, used, strict=True):
            target.write_bytes(source.read_bytes())
        listener.reload_certificate()
        async with connect(listener.url, ssl=trusting(new)):
            await asyncio.wait_for(await client.ping(), TIMEOUT_S)

import asyncio
import contextlib
import errno
import resource
import socket
import ssl
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import uvloop
from websockets.asyncio.client import connect

from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.errors import ConfigurationError, StartError
from server.gateway import listener as listener_module
from server.gateway.admission import ConnectionLimiter
from server.gateway.listener import LIST_PERIOD_S, SPARE_FILES, ClientList, Listener, SocketAddress, Tls, listen
from server.gateway.settings import ServerSettings
from server.graph.permissions import Node
from server.graph.topics import Graph
from tests.helpers.clock import FakeClock
from tests.helpers.gateway import (
    TIMEOUT_S,
    UPGRADE,
    connected,
    exchange,
    limiter_of,
    listening,
    receive,
    request,
    say,
    status,
    until_empty,
)
from tests.helpers.graph import listen as subscribe
from tests.helpers.messages import REGISTRY
from tests.helpers.resources import Pair, make_pair, openssl


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Pair, Pair]:
    return make_pair(tmp_path_factory.mktemp("one")), make_pair(tmp_path_factory.mktemp("other"))


def test_a_pair_that_is_missing_none_or_locked_is_named(pairs: tuple[Pair, Pair], tmp_path: Path) -> None:
    one, other = pairs
    for which in ("certificate", "key"):
        pair = one._replace(**{which: tmp_path / "none.pem"})
        with pytest.raises(ConfigurationError, match=f"server.tls_{which}: .*none.pem cannot be read: No such file"):
            Tls(*pair)
    nothing, locked = tmp_path / "nothing.pem", tmp_path / "locked.pem"
    nothing.write_bytes(b"\xff\x00 nothing of that kind")
    openssl("pkey", "-in", str(one.key), "-aes256", "-passout", "pass:secret", "-out", str(locked))
    for pair in (Pair(one.certificate, other.key), Pair(nothing, one.key), Pair(one.certificate, locked)):
        with pytest.raises(ConfigurationError, match="of this certificate, and without a passphrase") as refused:
            Tls(*pair)
        assert all(str(file) in str(refused.value) for file in pair)


def copied(pair: Pair, target: Pair) -> Pair:
    for source, file in zip(pair, target, strict=True):
        file.write_bytes(source.read_bytes())
    return target


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


def test_only_a_sound_pair_is_taken(pairs: tuple[Pair, Pair], tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    one, other = pairs
    used = copied(one, Pair(tmp_path / "certificate.pem", tmp_path / "key.pem"))
    tls = Tls(*used)
    assert tls.context.minimum_version is ssl.TLSVersion.TLSv1_2
    first = certificate_shown(tls)
    assert first == ssl.PEM_cert_to_DER_cert(one.certificate.read_text())
    used.certificate.write_bytes(other.certificate.read_bytes())
    tls.reload()
    assert certificate_shown(tls) == first
    assert "the certificate stays as it was: server.tls_key:" in caplog.text
    used.key.write_bytes(other.key.read_bytes())
    tls.reload()
    assert certificate_shown(tls) == ssl.PEM_cert_to_DER_cert(other.certificate.read_text())


@pytest.fixture
def pair(pairs: tuple[Pair, Pair]) -> Pair:
    return pairs[0]


def over_tls_with(pair: Pair | None, **limits: Any) -> ServerSettings:
    """Settings of a listener on a free port; None for one that does not encrypt."""
    files = {} if pair is None else {"tls_certificate": pair.certificate, "tls_key": pair.key}
    return ServerSettings(port=0, **files, **limits)


def trusting(pair: Pair) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=pair.certificate)


async def is_ended(reader: asyncio.StreamReader) -> bool:
    """Return true if the server ends a connection in any way."""
    try:
        async with asyncio.timeout(TIMEOUT_S):
            return await reader.read() == b""
    except ConnectionError:
        return True


async def talk(url: str, tls: ssl.SSLContext | None, topic: str = "/t") -> None:
    """Send and hear large messages, and many small ones at once."""
    async with connect(url, ssl=tls) as client:
        await say(client, "subscribe", topic=topic, type="std_msgs/String")
        for sizes in ([500_000], [1_000_000], [1] * 300):
            for size in sizes:
                await say(client, "publish", topic=topic, msg={"data": "x" * size})
            assert [len((await receive(client))["msg"]["data"]) for _ in sizes] == sizes


@pytest.mark.parametrize("over_tls", [False, True], ids=["plain", "tls"])
def test_the_event_loop_of_the_server_carries_both(over_tls: bool, pair: Pair) -> None:
    async def serve_and_talk() -> None:
        async with listening(over_tls_with(pair if over_tls else None, max_clients_per_address=1)) as listener:
            s = "s" if over_tls else ""
            assert listener.url.startswith(f"ws{s}://127.0.0.1:")
            assert listener.page_url.startswith(f"http{s}://127.0.0.1:")
            await talk(listener.url, trusting(pair) if over_tls else None)
            await until_empty(listener)
            # What is abandoned in its handshake makes room as well.
            _, writer = await asyncio.open_connection("127.0.0.1", listener.port)
            writer.close()
            await until_empty(listener)
            await talk(listener.url, trusting(pair) if over_tls else None, "/u")

    uvloop.run(serve_and_talk())


async def test_a_connection_without_a_tls_handshake_takes_no_slot(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listener_module, "TLS_HANDSHAKE_TIMEOUT_S", 0.5)
    async with listening(over_tls_with(pair, max_clients=1)) as listener:
        async with connected(listener.port) as (reader, _):
            async with connect(listener.url, ssl=trusting(pair)):
                assert limiter_of(listener).open_count == 1
            assert await is_ended(reader)
        await until_empty(listener)


@pytest.mark.parametrize("over_tls", [False, True], ids=["plain", "tls"])
async def test_a_connection_that_gets_no_answer_ends_at_once_and_is_not_read(
    over_tls: bool, pair: Pair, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(ConnectionLimiter, "acquire", lambda *_: None)
    async with listening(over_tls_with(pair if over_tls else None)) as listener:
        with contextlib.suppress(ConnectionError):
            reader, writer = await asyncio.open_connection(
                "127.0.0.1", listener.port, ssl=trusting(pair) if over_tls else None
            )
            writer.write(request(*UPGRADE))
            assert await is_ended(reader)
            writer.close()
        assert not listener._transports
    assert "Error" not in caplog.text


async def test_a_client_without_tls_is_logged_once(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    async with listening(over_tls_with(pair)) as listener:
        for _ in range(2):
            assert await exchange(listener.port, request()) == ""
    assert caplog.text.count("a client speaks ws:// or http://, and here is wss:// and https://") == 1


async def test_a_new_certificate_is_for_new_connections(pairs: tuple[Pair, Pair], tmp_path: Path) -> None:
    pair, new = pairs
    used = copied(pair, Pair(tmp_path / "certificate.pem", tmp_path / "key.pem"))
    async with listening(over_tls_with(used)) as listener, connect(listener.url, ssl=trusting(pair)) as client:
        copied(new, used)
        listener.reload_certificate()
        async with connect(listener.url, ssl=trusting(new)):
            await asyncio.wait_for(await client.ping(), TIMEOUT_S)


def test_clients_that_come_at_once_are_told_of_together_until_the_end_and_a_late_subscriber_gets_their_list() -> None:
    graph, clock = Graph(REGISTRY, wall_clock=lambda: 7.0), FakeClock()
    clients = ClientList(graph, clock.call_later)
    clients.open()
    counts, lists = subscribe(graph, listener_module.COUNT_TOPIC), subscribe(graph, listener_module.LIST_TOPIC)

    def told() -> list[tuple[int, int]]:
        return [(count["data"], len(each["clients"])) for count, each in zip(counts, lists, strict=True)]

    nodes = [Node(f"client {number}") for number in range(100)]
    for number, node in enumerate(nodes):
        clients.add(node, f"10.0.0.{number}")
    assert told() == [(0, 0), (1, 1)]
    clock.advance(LIST_PERIOD_S)
    assert told()[2:] == [(100, 100)]
    for node in nodes[:-1]:
        clients.remove(node)
    clock.advance(LIST_PERIOD_S)
    clock.advance(10 * LIST_PERIOD_S)
    assert told()[3:] == [(1, 1)]
    kept = {"clients": [{"ip_address": "10.0.0.99", "connection_time": {"sec": 7, "nanosec": 0}}]}
    assert subscribe(graph, listener_module.LIST_TOPIC) == [kept]
    for node in nodes[:2]:
        clients.add(node, "10.0.0.1")
    assert clock.waiting == 1
    clients.close()
    assert clock.waiting == 0


@pytest.fixture
async def listener() -> AsyncIterator[Listener]:
    async with listening() as made:
        yield made


async def test_the_listener_tells_where_it_is_and_binds_no_address_that_others_reach_without_a_word() -> None:
    listener = Listener(Graph(REGISTRY), ServerSettings(host="0.0.0.0", port=0))
    with pytest.raises(ConfigurationError, match="--insecure"):
        await listener.bind()
    assert listener.port == 0
    for host in ("127.0.0.1", "localhost"):
        listener = Listener(Graph(REGISTRY), ServerSettings(host=host, port=0))
        await listener.bind()
        assert listener.url == f"ws://{host}:{listener.port}"
        assert listener.page_url == f"http://{host}:{listener.port}/"
        assert (listener.tcp_port, listener.tcp_url) == (None, None)
        await listener.close()
    assert Listener(Graph(REGISTRY), ServerSettings(host="::1", port=9090)).url == "ws://[::1]:9090"


async def test_without_a_certificate_there_is_no_reload(listener: Listener, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    listener.reload_certificate()
    assert "TLS is not configured (server.tls_certificate); nothing to reload" in caplog.text


IPV4, IPV6 = (socket.AF_INET, ("127.0.0.1", 9090)), (socket.AF_INET6, ("::1", 9090, 0, 0))


def has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6) as tried:
            tried.bind(("::1", 0))
    except OSError:
        return False
    return True


async def test_a_host_is_all_its_addresses_no_host_those_of_the_machine_and_a_name_that_there_is_not_is_told() -> None:
    assert await listener_module.resolve("127.0.0.1", 9090) == [IPV4]
    assert await listener_module.resolve("::1", 9090) == [IPV6]
    assert IPV4 in await listener_module.resolve("localhost", 9090)
    assert "0.0.0.0" in {address[0] for _, address in await listener_module.resolve("", 9090)}
    with pytest.raises(StartError, match=r"cannot listen on no\.\.where:9090: this is no name of a host"):
        await listener_module.resolve("no..where", 9090)
    with pytest.raises(StartError, match=r"cannot listen on 127\.0\.0\.256:9090: "):
        await listener_module.resolve("127.0.0.256", 9090)


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
def test_both_families_get_the_same_free_port() -> None:
    one, two = listen([IPV4, IPV6], "localhost", 0)
    with one, two:
        assert one.getsockname()[1] == two.getsockname()[1] > 0
        for address in ("127.0.0.1", "::1"):
            socket.create_connection((address, one.getsockname()[1]), timeout=TIMEOUT_S).close()


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
def test_a_free_port_that_is_taken_in_the_other_family_is_given_up_for_another(monkeypatch: pytest.MonkeyPatch) -> None:
    tries: list[int] = []
    listen_on = listener_module._listen_on

    def listen_on_taken(place: SocketAddress, port: int, *, alone: bool) -> socket.socket:
        tries.append(port)
        if len(tries) == 2:
            raise OSError(errno.EADDRINUSE, "taken")
        return listen_on(place, port, alone=alone)

    monkeypatch.setattr(listener_module, "_listen_on", listen_on_taken)
    for made in listen([IPV4, IPV6], "localhost", 0):
        made.close()
    assert len(tries) == 4


def test_a_family_that_the_machine_has_not_is_left_out() -> None:
    elsewhere = socket.AF_INET, ("192.0.2.1", 0)
    (made,) = listen([elsewhere, IPV4], "both", 0)
    with made:
        assert made.getsockname()[0] == "127.0.0.1"
    with pytest.raises(StartError, match=r"cannot listen on nowhere:0: Cannot assign"):
        listen([elsewhere], "nowhere", 0)


def test_a_taken_port_is_told_and_nothing_stays_open(recwarn: pytest.WarningsRecorder) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(StartError, match=f"port in use: localhost:{port} is taken by another program"):
            listen([(socket.AF_INET, ("127.0.0.2", 0)), IPV4], "localhost", port)
    assert not recwarn.list


class Limit:
    """The limit of open files, without changing that of the tests."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, soft: int, hard: int) -> None:
        self.value = soft, hard
        monkeypatch.setattr(resource, "getrlimit", lambda _which: self.value)
        monkeypatch.setattr(resource, "setrlimit", self._set)

    def _set(self, which: int, value: tuple[int, int]) -> None:
        assert which == resource.RLIMIT_NOFILE
        self.value = value


# The limits, the clients that are wanted and those that fit, and the soft limit afterwards.
FILE_LIMITS = [
    (1024, 4096, 1000, 1000, 1000 + SPARE_FILES),
    (1024, resource.RLIM_INFINITY, 1000, 1000, 1000 + SPARE_FILES),
    (1024, 4096, 100, 100, 1024),
    (resource.RLIM_INFINITY, 4096, 100, 100, resource.RLIM_INFINITY),
    (256, 2048, 5000, 2048 - SPARE_FILES, 2048),
    (256, 300, 5000, 150, 300),
]


def test_the_limit_is_raised_as_far_as_is_needed_and_reduces_the_number_of_clients_where_that_is_not_enough(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for soft, hard, wanted, clients, raised in FILE_LIMITS:
        caplog.clear()
        limit = Limit(monkeypatch, soft, hard)
        assert listener_module.raise_file_limit(wanted) == clients
        assert limit.value == (raised, hard)
        reduced = f"it serves {clients} clients at a time, not server.max_clients = {wanted}"
        assert [reduced in line for line in caplog.messages] == [True] * (clients != wanted)


async def test_clients_beyond_the_system_s_limit_of_open_files_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    Limit(monkeypatch, 2, 4)
    async with listening(ServerSettings(port=0, max_clients=3, max_clients_per_address=3)) as listener:
        url = f"ws://127.0.0.1:{listener.port}"
        async with connect(url), connect(url):
            answer = await exchange(listener.port, request())
    assert status(answer) == 503
    assert "the limit is 2 (server.max_clients, reduced to the files that the system lets the server open)" in answer


async def test_other_machines_find_the_page_at_the_addresses_of_this_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.gateway.listener.host_addresses", lambda: ["10.0.0.2"])
    access = Access(AccessSettings(insecure=True))
    for host, urls in (("127.0.0.1", []), ("0.0.0.0", ["http://10.0.0.2:{port}/"])):
        listener = Listener(Graph(REGISTRY), ServerSettings(host=host, port=0), access=access)
        await listener.bind()
        try:
            assert listener.page_urls_elsewhere == [url.format(port=listener.port) for url in urls]
        finally:
            await listener.close()

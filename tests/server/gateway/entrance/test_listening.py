from __future__ import annotations

import errno
import socket

import pytest

from server.errors import StartError
from server.gateway.entrance import listening
from server.gateway.entrance.listening import Place, listen, resolve

IPV4, IPV6 = Place(socket.AF_INET, "127.0.0.1", 0), Place(socket.AF_INET6, "::1", 0)


def has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6) as tried:
            tried.bind(("::1", 0))
    except OSError:
        return False
    return True


async def test_an_address_is_one_place() -> None:
    assert await resolve("127.0.0.1", 9090) == [IPV4]
    assert await resolve("::1", 9090) == [IPV6]


async def test_a_name_is_all_its_addresses() -> None:
    assert IPV4 in await resolve("localhost", 9090)


async def test_no_name_is_every_address_of_the_machine() -> None:
    assert "0.0.0.0" in {place.address for place in await resolve("", 9090)}


async def test_a_name_that_there_is_not_is_told() -> None:
    with pytest.raises(StartError, match=r"cannot listen on no\.\.where:9090: this is no name of a host"):
        await resolve("no..where", 9090)
    with pytest.raises(StartError, match=r"cannot listen on 127\.0\.0\.256:9090: "):
        await resolve("127.0.0.256", 9090)


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
def test_both_families_get_the_same_free_port() -> None:
    one, two = listen([IPV4, IPV6], "localhost", 0)
    with one, two:
        assert one.getsockname()[1] == two.getsockname()[1] > 0
        for address in ("127.0.0.1", "::1"):
            socket.create_connection((address, one.getsockname()[1]), timeout=5.0).close()


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
def test_a_free_port_that_is_taken_in_the_other_family_is_given_up_for_another(monkeypatch: pytest.MonkeyPatch) -> None:
    tries: list[int] = []
    listen_on = listening._listen_on

    def listen_on_taken(place: Place, port: int, *, alone: bool) -> socket.socket:
        tries.append(port)
        if len(tries) == 2:
            raise OSError(errno.EADDRINUSE, "taken")
        return listen_on(place, port, alone=alone)

    monkeypatch.setattr(listening, "_listen_on", listen_on_taken)
    for made in listen([IPV4, IPV6], "localhost", 0):
        made.close()
    assert len(tries) == 4


def test_a_family_that_the_machine_has_not_is_left_out() -> None:
    elsewhere = Place(socket.AF_INET, "192.0.2.1", 0)
    (made,) = listen([elsewhere, IPV4], "both", 0)
    with made:
        assert made.getsockname()[0] == "127.0.0.1"
    with pytest.raises(StartError, match=r"cannot listen on nowhere:0: Cannot assign"):
        listen([elsewhere], "nowhere", 0)


def test_a_taken_port_is_told_and_nothing_stays_open(recwarn: pytest.WarningsRecorder) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(StartError, match=f"port in use: localhost:{port} is taken by another program"):
            listen([Place(socket.AF_INET, "127.0.0.2", 0), IPV4], "localhost", port)
    assert not recwarn.list

import asyncio
import socket
from http import HTTPStatus

import pytest
from websockets.asyncio.client import connect

from server.gateway import admission as admission_module
from server.gateway.admission import ANSWERS_PER_S, BURST_TIME_S, ConnectionLimiter, ConnectionSlot
from server.gateway.settings import ServerSettings
from tests.helpers.gateway import TIMEOUT_S, limiter_of, listening, until_empty

HERE, THERE = "192.0.2.1", "192.0.2.2"
MANY = 100_000


def limits(clients: int = MANY, per_address: int = MANY, per_s: float = 1000.0) -> ConnectionLimiter:
    return ConnectionLimiter(
        ServerSettings(max_clients=clients, max_clients_per_address=per_address, connections_per_s=per_s)
    )


def acquire(limiter: ConnectionLimiter, address: str = HERE, now_s: float = 0.0) -> ConnectionSlot:
    slot = limiter.acquire(address, now_s)
    assert slot is not None
    return slot


def refusal(slot: ConnectionSlot) -> tuple[HTTPStatus, str]:
    assert slot.rejection is not None
    assert slot.rejection.headers["Retry-After"] == "5"
    return slot.rejection.status, slot.rejection.body.decode().removesuffix("\n")


def test_five_hundred_idle_clients_of_one_address_fit_by_default_and_leave_room_for_others() -> None:
    limiter = ConnectionLimiter(ServerSettings())
    assert all(acquire(limiter).rejection is None for _ in range(500))
    for number in range(500):
        limiter.acquire(HERE, float(number))
    assert acquire(limiter, THERE).rejection is None


def test_one_connection_too_many_from_an_address_or_in_all_is_told_the_limit() -> None:
    limiter = limits(per_address=2)
    acquire(limiter)
    acquire(limiter)
    assert refusal(acquire(limiter)) == (
        HTTPStatus.TOO_MANY_REQUESTS,
        "2 connections are open from this address, the limit is 2 (server.max_clients_per_address)",
    )
    assert acquire(limiter, THERE).rejection is None
    limiter = limits(clients=2)
    acquire(limiter)
    acquire(limiter, THERE)
    assert refusal(acquire(limiter, "192.0.2.3")) == (
        HTTPStatus.SERVICE_UNAVAILABLE,
        "2 connections are open, the limit is 2 (server.max_clients)",
    )


def test_one_address_leaves_room_for_others_also_of_fewer_clients_unless_the_settings_give_it_all() -> None:
    limiter = ConnectionLimiter(ServerSettings())
    limiter.reduce(100)
    for number in range(100):
        limiter.acquire(HERE, float(number))
    assert limiter.open_count == 80
    assert "the limit is 80 (server.max_clients_per_address, reduced" in refusal(acquire(limiter, HERE, 100.0))[1]
    assert acquire(limiter, THERE, 100.0).rejection is None
    limiter = limits(clients=1000, per_address=1000)
    limiter.reduce(100)
    assert all(acquire(limiter).rejection is None for _ in range(100))
    assert "the limit is 100 (server.max_clients, reduced" in refusal(acquire(limiter))[1]


def test_a_slot_released_twice_makes_room_once() -> None:
    limiter = limits(clients=1)
    slot = acquire(limiter)
    slot.release()
    assert limiter.open_count == 0
    acquire(limiter)
    assert acquire(limiter).rejection is not None


def test_an_address_may_come_so_often_in_the_long_run_and_others_are_not_held_up() -> None:
    limiter = limits(per_s=10.0)
    for _ in range(10 * BURST_TIME_S):
        acquire(limiter).release()
    assert refusal(acquire(limiter)) == (
        HTTPStatus.TOO_MANY_REQUESTS,
        "new connections come too often; the limit is 10 a second (server.connections_per_s)",
    )
    assert acquire(limiter, THERE).rejection is None
    came = [acquire(limiter, now_s=1.0).rejection is None for _ in range(11)]
    assert came.count(True) == 10


def test_a_flood_gets_a_few_answers_a_second() -> None:
    limiter = limits(per_address=1)
    acquire(limiter)
    for now_s in (0.0, 1.0):
        assert sum(limiter.acquire(HERE, now_s) is not None for _ in range(1000)) == ANSWERS_PER_S


def test_addresses_that_have_gone_are_forgotten_in_the_end_and_a_flood_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(admission_module, "MAX_ABSENT", 3)
    limiter = limits()
    for number in range(10):
        acquire(limiter, f"192.0.2.{number}").release()
    assert len(limiter._absent) == 3
    assert not limiter._present
    limiter = limits(clients=1, per_s=1.0)
    acquire(limiter, THERE)
    for _ in range(BURST_TIME_S):
        limiter.acquire(HERE, 0.0)
    slot = limiter.acquire(HERE, 0.5)
    assert slot is None or "too often" in refusal(slot)[1]
    assert len(limiter._absent) == 1


# Addresses of one machine, each with its own count.
OTHER = ("127.0.0.2", 0)


async def test_a_flood_of_connections_from_one_address_holds_nobody_else_up(caplog: pytest.LogCaptureFixture) -> None:
    async with listening(ServerSettings(port=0, connections_per_s=5.0)) as listener:
        # The kernel makes the connections, whatever the server does with them.
        flood = [socket.create_connection(("127.0.0.1", listener.port)) for _ in range(300)]
        async with connect(f"ws://127.0.0.1:{listener.port}", local_addr=OTHER) as client:
            await asyncio.wait_for(await client.ping(), TIMEOUT_S)
        # As many as may come at once, and a few seconds' worth more.
        assert limiter_of(listener).open_count < 5 * BURST_TIME_S + 50
        with pytest.raises(ConnectionResetError):
            flood[-1].recv(1)
        for each in flood:
            each.close()
        await until_empty(listener)
    assert caplog.text.count("new connections come too often; the limit is 5 a second") == 1

from __future__ import annotations

from http import HTTPStatus

import pytest

from server.gateway.entrance import turnstile
from server.gateway.entrance.turnstile import (
    ANSWERS_PER_S,
    BURST_TIME_S,
    MAX_ANSWERED,
    ConnectionLimits,
    Turnstile,
    Visit,
)

HERE, THERE = "192.0.2.1", "192.0.2.2"
MANY = 100_000


def limits(clients: int = MANY, per_address: int = MANY, per_s: float = 1000.0) -> Turnstile:
    return Turnstile(ConnectionLimits(clients, per_address, per_s))


def enter(gate: Turnstile, address: str = HERE, now_s: float = 0.0) -> Visit:
    visit = gate.enter(address, now_s)
    assert visit is not None
    return visit


def refusal(visit: Visit) -> tuple[HTTPStatus, str]:
    assert visit.turned_away is not None
    return visit.turned_away.status, visit.turned_away.sentence


def test_five_hundred_idle_clients_of_one_address_fit_by_default() -> None:
    gate = Turnstile()
    assert all(enter(gate).turned_away is None for _ in range(500))


def test_one_address_leaves_room_for_others_by_default() -> None:
    gate = Turnstile()
    for number in range(1000):
        gate.enter(HERE, float(number))
    assert enter(gate, THERE).turned_away is None


def test_who_is_one_too_many_from_an_address_hears_the_limit_and_others_come_in() -> None:
    gate = limits(per_address=2)
    enter(gate)
    enter(gate)
    assert refusal(enter(gate)) == (
        HTTPStatus.TOO_MANY_REQUESTS,
        "2 connections are open from this address, the limit is 2 (server.max_clients_per_address)",
    )
    assert enter(gate, THERE).turned_away is None


def test_who_is_one_too_many_in_all_hears_the_limit() -> None:
    gate = limits(clients=2)
    enter(gate)
    enter(gate, THERE)
    assert refusal(enter(gate, "192.0.2.3")) == (
        HTTPStatus.SERVICE_UNAVAILABLE,
        "2 connections are open, the limit is 2 (server.max_clients)",
    )


def test_who_leaves_makes_room_once() -> None:
    gate = limits(clients=1)
    visit = enter(gate)
    visit.end()
    visit.end()
    assert gate.present == 0
    enter(gate)
    assert enter(gate).turned_away is not None


def test_the_one_who_is_turned_away_takes_nobodys_place() -> None:
    gate = limits(clients=1)
    inside = enter(gate)
    enter(gate).end()
    inside.end()
    assert gate.present == 0
    assert enter(gate).turned_away is None


def test_an_address_may_come_so_often_in_the_long_run_and_others_are_not_held_up() -> None:
    gate = limits(per_s=10.0)
    for _ in range(10 * BURST_TIME_S):
        enter(gate).end()
    assert refusal(enter(gate)) == (
        HTTPStatus.TOO_MANY_REQUESTS,
        "new connections come too often; the limit is 10 a second (server.connections_per_s)",
    )
    assert enter(gate, THERE).turned_away is None
    came = [enter(gate, now_s=1.0).turned_away is None for _ in range(11)]
    assert came.count(True) == 10


def test_leaving_and_coming_again_does_not_reset_the_rate() -> None:
    gate = limits(per_s=1.0)
    visits = [enter(gate) for _ in range(BURST_TIME_S)]
    for visit in visits:
        visit.end()
    assert enter(gate).turned_away is not None


def test_a_flood_gets_a_few_answers_and_then_none() -> None:
    gate = limits(per_address=1)
    enter(gate)
    answered = [visit for _ in range(1000) if (visit := gate.enter(HERE, 0.0)) is not None]
    assert len(answered) == ANSWERS_PER_S


def test_only_so_many_answers_are_on_their_way() -> None:
    gate = limits(per_address=1)
    enter(gate)
    answered = [visit for second in range(100) if (visit := gate.enter(HERE, float(second))) is not None]
    assert len(answered) == MAX_ANSWERED
    assert gate.turned_away == 100
    answered[0].end()
    assert gate.enter(HERE, 200.0) is not None


def test_addresses_that_have_gone_are_forgotten_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turnstile, "MAX_ABSENT", 3)
    gate = limits()
    for number in range(10):
        enter(gate, f"192.0.2.{number}").end()
    assert len(gate._absent) == 3
    assert not gate._visitors


def test_a_flood_from_an_address_without_a_connection_is_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = limits(clients=1, per_s=1.0)
    enter(gate, THERE)
    for _ in range(BURST_TIME_S):
        gate.enter(HERE, 0.0)
    visit = gate.enter(HERE, 0.5)
    assert visit is None or "too often" in refusal(visit)[1]
    assert len(gate._absent) == 1

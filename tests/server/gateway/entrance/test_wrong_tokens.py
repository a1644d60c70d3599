from __future__ import annotations

import pytest

from server.gateway.entrance import wrong_tokens
from server.gateway.entrance.wrong_tokens import MAX_WRONG, WINDOW_S, WrongTokens
from tests.helpers.clock import FakeClock

GUESSER = "192.0.2.1"


def after_wrong_ones(count: int, clock: FakeClock) -> WrongTokens:
    made = WrongTokens(clock)
    for number in range(count):
        made.add(GUESSER, number)
    return made


def test_who_errs_a_few_times_is_still_heard() -> None:
    assert after_wrong_ones(MAX_WRONG - 1, FakeClock()).refusal(GUESSER) is None


def test_who_guesses_is_not_heard_for_a_while_and_hears_how_long() -> None:
    clock = FakeClock()
    made = after_wrong_ones(MAX_WRONG, clock)
    clock.now_s += WINDOW_S - 10.0
    assert made.refusal(GUESSER) == (
        f"{MAX_WRONG} wrong tokens came from this address, the limit is {MAX_WRONG}; try again in 10 s"
    )
    assert made.wait_s(GUESSER) == 10.0
    clock.now_s += 10.0
    assert made.refusal(GUESSER) is None
    assert made.wait_s(GUESSER) == 0.0


def test_the_wait_begins_with_the_last_wrong_one() -> None:
    clock = FakeClock()
    made = after_wrong_ones(MAX_WRONG - 1, clock)
    clock.now_s += WINDOW_S - 1.0
    made.add(GUESSER, "last")
    assert made.wait_s(GUESSER) == WINDOW_S


def test_what_is_long_ago_is_forgotten() -> None:
    clock = FakeClock()
    made = after_wrong_ones(MAX_WRONG - 1, clock)
    clock.now_s += WINDOW_S
    made.add(GUESSER, "new")
    assert made.refusal(GUESSER) is None


def test_others_are_heard_but_not_the_guessers_neighbours_in_ipv6() -> None:
    made = WrongTokens(FakeClock())
    for number in range(MAX_WRONG):
        made.add(f"2001:db8::{number + 1:x}", number)
    assert made.refusal("2001:db8::ffff") is not None
    assert made.refusal("2001:db8:0:1::1") is None
    assert made.refusal(GUESSER) is None


def test_only_so_many_addresses_are_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wrong_tokens, "MAX_ADDRESSES", 3)
    made = after_wrong_ones(MAX_WRONG, FakeClock())
    for number in range(2, 5):
        made.add(f"192.0.2.{number}", number)
    assert len(made._wrong) == 3
    assert made.refusal(GUESSER) is None


def test_an_old_token_that_is_tried_for_ever_is_no_guess() -> None:
    made = WrongTokens(FakeClock())
    for _ in range(10 * MAX_WRONG):
        made.add(GUESSER, "the old one")
    assert made.refusal(GUESSER) is None

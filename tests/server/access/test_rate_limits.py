from __future__ import annotations

import logging

import pytest

from server.access.rate_limits import MAX_REFUSAL_LINES, LogLimiter, RateLimiter, client_key, is_loopback
from tests.helpers.clock import FakeClock


def test_a_burst_is_let_through_and_then_no_more() -> None:
    rate = RateLimiter(1.0, 3)
    assert [rate.take(100.0) for _ in range(5)] == [True, True, True, False, False]


def test_in_the_long_run_so_many_a_second() -> None:
    rate = RateLimiter(2.0, 1)
    assert [rate.take(100.0 + step / 10) for step in range(11)] == [step % 5 == 0 for step in range(11)]


def test_a_long_rest_saves_up_a_burst_and_no_more() -> None:
    rate = RateLimiter(1.0, 2)
    assert [rate.take(1e6) for _ in range(3)] == [True, True, False]


LOG = logging.getLogger("armbridge.test")
BURST, LINES_PER_S = 50, 1.0


def test_a_flood_of_lines_is_cut_short_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    clock = FakeClock()
    limiter = LogLimiter(LOG, BURST, LINES_PER_S, clock)
    for number in range(BURST + 30):
        limiter.write(logging.WARNING, f"client x: refused: {number}")
    assert [record.getMessage() for record in caplog.records] == [
        f"client x: refused: {number}" for number in range(BURST)
    ]
    clock.now_s += 1.0 / LINES_PER_S
    limiter.write(logging.WARNING, "client x: refused: later")
    assert caplog.records[-1].getMessage() == (
        "client x: refused: later (30 more lines about this client were left out before)"
    )


def test_lines_now_and_then_are_all_written(caplog: pytest.LogCaptureFixture) -> None:
    clock = FakeClock()
    limiter = LogLimiter(LOG, BURST, LINES_PER_S, clock)
    for _ in range(3 * BURST):
        limiter.write(logging.ERROR, "client x: refused: no")
        clock.now_s += 1.0
    assert len(caplog.records) == 3 * BURST
    assert {record.levelno for record in caplog.records} == {logging.ERROR}


def test_a_line_with_a_key_is_written_once_for_each_of_its_kind(caplog: pytest.LogCaptureFixture) -> None:
    limiter = LogLimiter(LOG, MAX_REFUSAL_LINES)
    for value in ("a", "b", "a", "a"):
        limiter.write(logging.WARNING, f"refused: pages of {value}", ("origin", value))
    limiter.write(logging.WARNING, "refused: the name a", ("host", "a"))
    assert [record.getMessage() for record in caplog.records] == [
        "refused: pages of a",
        "refused: pages of b",
        "refused: the name a",
    ]


def test_logged_lines_are_limited_and_the_limit_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    limiter = LogLimiter(LOG, MAX_REFUSAL_LINES)
    for number in range(2 * MAX_REFUSAL_LINES):
        limiter.write(logging.WARNING, "refused: no", ("origin", str(number)))
    assert len(caplog.records) == MAX_REFUSAL_LINES + 1
    assert "further ones are not" in caplog.text
    assert len(limiter._keys) == MAX_REFUSAL_LINES


def test_nobody_writes_lines_of_their_own_or_fills_the_memory(caplog: pytest.LogCaptureFixture) -> None:
    limiter = LogLimiter(LOG, MAX_REFUSAL_LINES)
    limiter.write(logging.WARNING, "refused: no\nINFO armbridge all is well", ("origin", "x" * 100_000))
    assert caplog.records[0].getMessage() == "refused: no\\nINFO armbridge all is well"
    assert max(len(value) for _, value in limiter._keys) < 100


def test_an_address_is_loopback_or_not_whatever_its_family() -> None:
    assert is_loopback("127.0.0.1")
    assert is_loopback("::1")
    assert not is_loopback("fe80::1%eth0")
    assert not is_loopback("somewhere")


def test_a_network_of_ipv6_is_one_peer_and_ipv4_is_the_same_in_both_families() -> None:
    assert client_key("2001:db8::1") == client_key("2001:db8::ffff:2") != client_key("2001:db8:0:1::1")
    assert client_key("::ffff:192.0.2.1") == client_key("192.0.2.1") != client_key("192.0.2.2")
    assert client_key("fe80::1%eth0") == client_key("fe80::2%eth1")
    assert client_key("::1") != client_key("::2")
    assert client_key("unknown") == "unknown"

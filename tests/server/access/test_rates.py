from __future__ import annotations

from server.access.rates import Rate


def test_a_burst_is_let_through_and_then_no_more() -> None:
    rate = Rate(1.0, 3)
    assert [rate.take(100.0) for _ in range(5)] == [True, True, True, False, False]


def test_in_the_long_run_so_many_a_second() -> None:
    rate = Rate(2.0, 1)
    assert [rate.take(100.0 + step / 10) for step in range(11)] == [step % 5 == 0 for step in range(11)]


def test_a_long_rest_saves_up_a_burst_and_no_more() -> None:
    rate = Rate(1.0, 2)
    assert [rate.take(1e6) for _ in range(3)] == [True, True, False]

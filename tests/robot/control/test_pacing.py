from __future__ import annotations

import gc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.control.pacing import PERIOD_S, Pacer, become_punctual, percentiles


def test_deadlines_are_absolute_so_that_lateness_does_not_add_up() -> None:
    pacer = Pacer(0.0)
    for tick in range(1, 100):
        assert pacer.deadline_s == pytest.approx(tick * PERIOD_S)
        pacer.start_tick(pacer.deadline_s + 0.003)


@given(st.lists(st.floats(min_value=0.0, max_value=0.5), min_size=1, max_size=50))
def test_missed_ticks_are_skipped_never_made_up_for(late_s: list[float]) -> None:
    pacer = Pacer(0.0)
    started_s = -1.0
    for late in late_s:
        now_s = max(pacer.deadline_s + late, started_s)
        pacer.start_tick(now_s)
        assert 0.0 < pacer.deadline_s - now_s <= PERIOD_S + 1e-9
        started_s = now_s


def test_lateness_is_kept_for_the_latest_ticks() -> None:
    pacer = Pacer(0.0)
    for late_s in (0.001, 0.002, 0.003):
        pacer.start_tick(pacer.deadline_s + late_s)
    assert pacer.latest(2) == pytest.approx((0.002, 0.003))


def test_a_tick_that_is_skipped_puts_off_the_next_and_none_is_late() -> None:
    pacer = Pacer(0.0)
    pacer.skip(1)
    assert pacer.deadline_s == pytest.approx(2 * PERIOD_S)
    pacer.start_tick(pacer.deadline_s)
    assert pacer.latest(1) == pytest.approx((0.0,))
    assert pacer.deadline_s == pytest.approx(3 * PERIOD_S)


def test_a_skipped_tick_that_is_needed_after_all_is_taken_back() -> None:
    pacer = Pacer(0.0)
    pacer.skip(1)
    pacer.hurry(1, 0.004)
    assert pacer.deadline_s == pytest.approx(PERIOD_S)


def test_a_tick_that_is_needed_when_its_time_is_over_is_due_now_and_not_late() -> None:
    pacer = Pacer(0.0)
    pacer.skip(1)
    pacer.hurry(1, 0.013)
    assert pacer.deadline_s == pytest.approx(0.013)
    pacer.start_tick(0.013)
    assert pacer.latest(1) == pytest.approx((0.0,))


def test_percentiles_of_nothing_are_zero() -> None:
    assert percentiles([]) == (0.0, 0.0, 0.0)
    assert percentiles([1.0, 2.0, 3.0])[::2] == (2.0, 3.0)


def test_a_process_that_may_not_be_punctual_goes_on_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr("os.sched_setscheduler", refuse)
    monkeypatch.setattr("os.nice", refuse)
    try:
        assert not become_punctual()
        assert not gc.isenabled()
    finally:
        gc.enable()
        gc.unfreeze()

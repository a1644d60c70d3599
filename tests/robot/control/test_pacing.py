from __future__ import annotations

import ctypes
import errno
import gc
import logging
import resource
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.control.pacing import (
    MAX_TICK_S,
    MCL_CURRENT,
    MCL_FUTURE,
    MCL_ONFAULT,
    PERIOD_S,
    TICKS_KEPT,
    LoopClock,
    Pacer,
    Scheduling,
    SimulationClock,
    enter_realtime,
    lock_memory,
    percentiles,
)
from robot.hardware.config import ClockReading


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


def test_a_tick_that_is_skipped_puts_off_the_next_and_none_is_late() -> None:
    pacer = Pacer(0.0)
    pacer.skip(1)
    assert pacer.deadline_s == pytest.approx(2 * PERIOD_S)
    pacer.start_tick(pacer.deadline_s)
    assert pacer.latest(1) == pytest.approx((0.0,))
    assert pacer.deadline_s == pytest.approx(3 * PERIOD_S)


def test_a_tick_that_is_needed_before_its_time_is_due_as_if_none_had_been_skipped() -> None:
    pacer = Pacer(0.0)
    pacer.skip(2)
    pacer.cancel_skip(2, 0.004)
    assert pacer.deadline_s == pytest.approx(PERIOD_S)


def test_a_tick_that_is_needed_when_its_time_is_over_is_due_now_and_not_late() -> None:
    pacer = Pacer(0.0)
    pacer.skip(1)
    pacer.cancel_skip(1, 0.013)
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
        assert enter_realtime() == Scheduling(real_time=False, memory_locked=False)
        assert not gc.isenabled()
    finally:
        gc.enable()
        gc.unfreeze()


class MemoryLocks:
    """C library that notes calls of mlockall(2), and refuses them with an error number if there is one.

    Args:
        error: error number; 0 to take the call.
    """

    def __init__(self, error: int = 0) -> None:
        self._error = error
        self.flags: list[int] = []

    def __call__(self, *_: object, **__: object) -> MemoryLocks:
        return self

    def mlockall(self, flags: int) -> int:
        self.flags.append(flags)
        ctypes.set_errno(self._error)
        return -1 if self._error else 0


@pytest.mark.parametrize("limit_bytes", [resource.RLIM_INFINITY, 1 << 30])
def test_memory_is_locked_as_it_is_used(monkeypatch: pytest.MonkeyPatch, limit_bytes: int) -> None:
    locks = MemoryLocks()
    monkeypatch.setattr("ctypes.CDLL", locks)
    monkeypatch.setattr("resource.getrlimit", lambda _: (limit_bytes, limit_bytes))
    assert lock_memory()
    assert locks.flags == [MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT]


@pytest.mark.parametrize(
    ("limit_bytes", "error", "words"),
    [
        (8 << 20, 0, "RLIMIT_MEMLOCK is 8388608 bytes"),
        (resource.RLIM_INFINITY, errno.ENOMEM, "memory is not locked: mlockall: Cannot allocate memory"),
    ],
    ids=["a low limit", "refused by the system"],
)
def test_memory_that_cannot_be_locked_is_logged_with_the_cause(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, limit_bytes: int, error: int, words: str
) -> None:
    locks = MemoryLocks(error)
    monkeypatch.setattr("ctypes.CDLL", locks)
    monkeypatch.setattr("resource.getrlimit", lambda _: (limit_bytes, limit_bytes))
    with caplog.at_level(logging.INFO):
        assert not lock_memory()
    assert bool(locks.flags) is bool(error)
    assert words in caplog.text


# Clocks.


def ticked(*gaps_s: float, rate: float = 1.0) -> SimulationClock:
    """A clock, faster than the machine's by a rate, whose ticks came so long after one another."""
    machine_s = 50.0
    clock = SimulationClock(machine_s, rate)
    for gap_s in gaps_s:
        machine_s += gap_s
        clock.start_tick(machine_s)
    return clock


def test_the_machines_time_is_monotonic_and_passes_by_itself() -> None:
    clock = LoopClock()
    before_s = time.monotonic()
    clock.start_tick(0.0)
    assert before_s <= clock() <= time.monotonic()
    assert clock.real_time_factor == 1.0


@pytest.mark.parametrize(
    ("gaps_s", "passed_s"),
    [
        ([], 0.0),
        ([PERIOD_S] * 100, 100 * PERIOD_S),
        ([2 * PERIOD_S], 2 * PERIOD_S),
        ([3.0, PERIOD_S], MAX_TICK_S + PERIOD_S),
    ],
    ids=["before the first tick", "punctual", "one period late", "starved"],
)
def test_simulated_time_passes_as_the_machines_up_to_the_bound_of_a_tick(gaps_s: list[float], passed_s: float) -> None:
    clock = ticked(*gaps_s)
    assert clock() == clock() == pytest.approx(50.0 + passed_s)


def test_a_machines_clock_that_goes_back_takes_no_time_back() -> None:
    clock = ticked(PERIOD_S)
    clock.start_tick(20.0)
    assert clock() == pytest.approx(50.0 + PERIOD_S)


@pytest.mark.parametrize(
    ("gaps_s", "factor"),
    [([], 1.0), ([PERIOD_S] * 30, 1.0), ([4 * MAX_TICK_S] * 10, 0.25), ([5.0] + [PERIOD_S] * 2 * TICKS_KEPT, 1.0)],
    ids=["before the first tick", "punctual", "starved", "no longer starved"],
)
def test_the_real_time_factor_is_the_share_of_the_machines_time_that_passed(gaps_s: list[float], factor: float) -> None:
    assert ticked(*gaps_s).real_time_factor == pytest.approx(factor)


def test_ticks_that_were_skipped_on_purpose_lose_no_time() -> None:
    clock = SimulationClock(10.0)
    clock.start_tick(10.025, MAX_TICK_S + 0.01)
    assert clock() == pytest.approx(10.025)
    assert clock.real_time_factor == pytest.approx(1.0)


def test_a_faster_clock_has_ticks_of_the_same_length_in_less_time() -> None:
    clock = ticked(*[0.1 * PERIOD_S] * 100, rate=10.0)
    assert clock() == pytest.approx(51.0)
    assert clock.real_time_factor == pytest.approx(10.0)
    pacer = Pacer(0.0)
    pacer.start_tick(PERIOD_S, clock.rate)
    assert pacer.deadline_s == pytest.approx(1.1 * PERIOD_S)


def test_a_faster_clock_on_a_busy_machine_is_slower() -> None:
    clock = ticked(*[0.5 * PERIOD_S] * 10, rate=10.0)
    assert clock() == pytest.approx(50.0 + 10 * MAX_TICK_S)
    assert clock.real_time_factor == pytest.approx(4.0)


def test_a_faster_clock_is_as_fast_as_the_machines_while_the_arm_is_steered() -> None:
    clock = ticked(rate=10.0)
    clock.follow_real_time(steered=True)
    clock.start_tick(50.0 + PERIOD_S)
    assert (clock.rate, clock()) == (1.0, pytest.approx(50.0 + PERIOD_S))
    clock.follow_real_time(steered=False)
    clock.start_tick(50.0 + 1.1 * PERIOD_S)
    assert (clock.rate, clock()) == (10.0, pytest.approx(50.0 + 2 * PERIOD_S))


def test_a_faster_clock_goes_on_in_the_next_arm_process() -> None:
    before = ticked(0.1 * PERIOD_S, 5.0, rate=10.0)
    after = SimulationClock(56.0, 10.0, ClockReading(before(), before.stamp_s(0.0)))
    assert after() == before() == pytest.approx(50.0 + PERIOD_S + MAX_TICK_S)
    after.start_tick(56.0 + 0.1 * PERIOD_S)
    assert after() == pytest.approx(before() + PERIOD_S)
    assert after.stamp_s(0.0) - before.stamp_s(0.0) == pytest.approx(PERIOD_S, abs=1e-6)


def test_stamps_have_the_time_of_a_clock_that_is_not_the_machines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time", lambda: 2050.0)
    clock = ticked(0.1 * PERIOD_S, rate=10.0)
    assert clock.stamp_s(2050.0) == pytest.approx(2050.0 + PERIOD_S)
    assert ticked(MAX_TICK_S).stamp_s(2049.9) == 2049.9
    # A clock that stands still has one stamp, also where the machine's clock is set.
    monkeypatch.setattr(time, "time", lambda: 2000.0)
    assert clock.stamp_s(2000.0) == pytest.approx(2050.0 + PERIOD_S)

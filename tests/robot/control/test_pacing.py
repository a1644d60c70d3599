from __future__ import annotations

import ctypes
import errno
import gc
import logging
import os
import resource
import time
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robot.control import pacing
from robot.control.pacing import Pacer, SimulationClock
from robot.hardware.config import ClockReading
from robot.trajectory import PERIOD_S

# Two periods.
MAX_TICK_S = 0.02


def test_deadlines_are_absolute_so_that_lateness_does_not_add_up_and_is_kept_for_a_second() -> None:
    pacer = Pacer(0.0)
    for tick in range(1, 150):
        assert pacer.deadline_s == pytest.approx(tick * PERIOD_S)
        pacer.start_tick(pacer.deadline_s + 1e-5 * tick)
        assert pacer.tick_s == pytest.approx(tick * PERIOD_S + 1e-5 * tick)
    assert pacer.latest(2) == pytest.approx((1.48e-3, 1.49e-3))
    assert pacer.latest(150) == pytest.approx(tuple(1e-5 * tick for tick in range(50, 150)))


@example([0.01, 0.02, 0.03, 0.07])
@given(st.lists(st.floats(min_value=0.0, max_value=0.5), min_size=1, max_size=50))
def test_missed_ticks_are_skipped_never_made_up_for(late_s: list[float]) -> None:
    pacer = Pacer(0.0)
    started_s = -1.0
    for late in late_s:
        now_s = max(pacer.deadline_s + late, started_s)
        pacer.start_tick(now_s)
        assert 0.0 < pacer.deadline_s - now_s <= PERIOD_S + 1e-9
        started_s = now_s


def test_a_skipped_tick_puts_off_the_next_and_one_that_is_needed_meanwhile_is_due_at_once_and_not_late() -> None:
    pacer = Pacer(0.0)
    pacer.skip(1)
    assert pacer.deadline_s == pytest.approx(2 * PERIOD_S)
    pacer.start_tick(pacer.deadline_s)
    assert pacer.latest(1) == pytest.approx((0.0,))
    assert pacer.deadline_s == pytest.approx(3 * PERIOD_S)
    # Cancelled before and after the time of a skipped tick.
    for skipped, now_s, due_s in ((2, 0.004, PERIOD_S), (1, 0.013, 0.013)):
        pacer = Pacer(0.0)
        pacer.skip(skipped)
        pacer.cancel_skip(skipped, now_s)
        assert pacer.deadline_s == pytest.approx(due_s)
    pacer.start_tick(0.013)
    assert pacer.latest(1) == pytest.approx((0.0,))


@pytest.mark.parametrize(
    ("at_s", "due_s"),
    [(0.011, (0.014, 0.024)), (0.017, (0.017, 0.027)), (0.021, (0.02, 0.024, 0.034)), (0.027, (0.02, 0.027, 0.037))],
)
def test_a_tick_that_is_brought_forward_is_due_at_its_time_but_4_ms_after_the_last(
    at_s: float, due_s: tuple[float, ...]
) -> None:
    pacer = Pacer(0.0)
    pacer.start_tick(0.01)
    pacer.bring_forward(at_s)
    for each_s in due_s:
        assert pacer.deadline_s == pytest.approx(each_s)
        pacer.start_tick(each_s)
        assert pacer.latest(1) == pytest.approx((0.0,), abs=1e-9)


def test_percentiles_of_nothing_are_zero() -> None:
    assert pacing.percentiles([]) == (0.0, 0.0, 0.0)
    assert pacing.percentiles(range(101)) == (50.0, 99.0, 100.0)


class MemoryLocks:
    """C library that keeps the flags of mlockall(2), and refuses the call with an error number that is not 0."""

    def __init__(self, error: int) -> None:
        self._error = error
        self.flags: list[int] = []

    def __call__(self, *_: object, **__: object) -> MemoryLocks:
        return self

    def mlockall(self, flags: int) -> int:
        self.flags.append(flags)
        ctypes.set_errno(self._error)
        return -1 if self._error else 0


@pytest.mark.parametrize(
    ("limit_bytes", "error", "words"),
    [
        (resource.RLIM_INFINITY, 0, ""),
        (1 << 30, 0, ""),
        ((1 << 30) - 1, 0, "RLIMIT_MEMLOCK is 1073741823 bytes"),
        (resource.RLIM_INFINITY, errno.ENOMEM, "(docs/hardware.md): mlockall: Cannot allocate memory"),
    ],
)
def test_memory_is_locked_as_it_is_used_or_the_cause_is_logged(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, limit_bytes: int, error: int, words: str
) -> None:
    locks = MemoryLocks(error)
    monkeypatch.setattr("ctypes.CDLL", locks)
    monkeypatch.setattr("resource.getrlimit", lambda _: (limit_bytes, limit_bytes))
    with caplog.at_level(logging.INFO):
        assert pacing.lock_memory() is (words == "")
    # MCL_CURRENT, MCL_FUTURE and MCL_ONFAULT of mlockall(2).
    assert locks.flags == ([] if "RLIMIT" in words else [1 | 2 | 4])
    assert words in caplog.text


@pytest.mark.parametrize(
    ("rate", "permitted", "asked", "scheduling"),
    [
        (1.0, True, [(0, os.SCHED_FIFO, 1)], (True, True)),
        (1.0, False, [(0, os.SCHED_FIFO, 1), -10], (False, False)),
        (10.0, True, [], (False, False)),
    ],
)
def test_a_process_asks_to_be_punctual_unless_its_clock_is_fast_and_goes_on_all_the_same(
    monkeypatch: pytest.MonkeyPatch, rate: float, permitted: bool, asked: list[object], scheduling: tuple[bool, bool]
) -> None:
    requests: list[object] = []

    def request(*wanted: Any) -> None:
        requests.append(wanted[0] if len(wanted) == 1 else (*wanted[:2], wanted[2].sched_priority))
        if not permitted:
            raise PermissionError

    monkeypatch.setattr("os.sched_setscheduler", request)
    monkeypatch.setattr("os.nice", request)
    monkeypatch.setattr("ctypes.CDLL", MemoryLocks(0))
    monkeypatch.setattr("resource.getrlimit", lambda _: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    try:
        assert pacing.enter_realtime(rate) == scheduling
        assert not gc.isenabled()
    finally:
        gc.enable()
        gc.unfreeze()
    assert requests == asked


def ticked(*gaps_s: float, rate: float = 1.0) -> SimulationClock:
    """A clock, faster than the machine's by a rate, whose ticks came so long after one another."""
    machine_s = 50.0
    clock = SimulationClock(machine_s, rate)
    for gap_s in gaps_s:
        machine_s += gap_s
        clock.start_tick(machine_s)
    return clock


def test_the_machines_time_is_monotonic_and_passes_by_itself() -> None:
    clock = pacing.LoopClock()
    before_s = time.monotonic()
    clock.start_tick(0.0)
    assert before_s <= clock() <= time.monotonic()
    assert clock.real_time_factor == 1.0


@pytest.mark.parametrize(
    ("gaps_s", "passed_s"),
    [
        ([], 0.0),
        ([PERIOD_S] * 100, 1.0),
        ([2 * PERIOD_S], 2 * PERIOD_S),
        ([3.0, PERIOD_S], MAX_TICK_S + PERIOD_S),
        # A machine's clock that goes back takes no time back.
        ([PERIOD_S, -30.0], PERIOD_S),
    ],
)
def test_simulated_time_passes_as_the_machines_up_to_the_bound_of_a_tick(gaps_s: list[float], passed_s: float) -> None:
    clock = ticked(*gaps_s)
    assert clock() == clock() == pytest.approx(50.0 + passed_s)


@pytest.mark.parametrize(
    ("gaps_s", "factor"),
    [
        ([], 1.0),
        ([PERIOD_S] * 30, 1.0),
        ([4 * MAX_TICK_S] * 10, 0.25),
        ([5.0, *[PERIOD_S] * 199], 2.01 / 6.99),
        ([5.0, *[PERIOD_S] * 200], 1.0),
    ],
)
def test_the_real_time_factor_is_the_share_of_the_machines_time_in_two_seconds(
    gaps_s: list[float], factor: float
) -> None:
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
    # A busy machine makes it slower.
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

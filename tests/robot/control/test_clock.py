from __future__ import annotations

import time

import pytest

from robot.control.pacing import MAX_TICK_S, PERIOD_S, TICKS_KEPT, LoopClock, SimulationClock


def ticked(*gaps_s: float) -> SimulationClock:
    """A clock whose ticks came so long after one another."""
    machine_s = 50.0
    clock = SimulationClock(machine_s)
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
    [
        ([], 1.0),
        ([PERIOD_S] * 30, 1.0),
        ([4 * MAX_TICK_S] * 10, 0.25),
        ([5.0] + [PERIOD_S] * TICKS_KEPT, 1.0),
    ],
    ids=["before the first tick", "punctual", "starved", "no longer starved"],
)
def test_the_real_time_factor_is_the_share_of_the_machines_time_that_passed(gaps_s: list[float], factor: float) -> None:
    assert ticked(*gaps_s).real_time_factor == pytest.approx(factor)


def test_ticks_that_were_skipped_on_purpose_lose_no_time() -> None:
    clock = SimulationClock(10.0)
    clock.start_tick(10.025, MAX_TICK_S + 0.01)
    assert clock() == pytest.approx(10.025)
    assert clock.real_time_factor == pytest.approx(1.0)

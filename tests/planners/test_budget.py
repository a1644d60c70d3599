from __future__ import annotations

import os
from pathlib import Path

import pytest

from planners import budget
from planners.budget import MAX_STARVED_S, Budget, Deadline, read_run_delay_s
from planners.problem import MoveItErrorCode
from tests.helpers.clock import FakeClock


@pytest.fixture
def clock():
    return FakeClock()


@pytest.mark.parametrize(
    ("passed_s", "waited_before_s", "waited_s", "left_s"),
    [
        (1.5, 7.0, 7.0, 0.5),
        (3.0, 7.0, 8.25, 0.25),
        (MAX_STARVED_S + 2.5, 7.0, MAX_STARVED_S + 9.5, -0.5),
        (3.0, None, 8.0, -1.0),
        (3.0, 7.0, None, -1.0),
    ],
    ids=["never waits", "waits", "waits for ever", "unknown at first", "unknown in the end"],
)
def test_a_deadline_is_extended_by_what_the_process_has_waited_for_a_core_since(
    clock, passed_s, waited_before_s, waited_s, left_s
):
    waits_s = iter((waited_before_s, waited_s))
    deadline = Deadline(2.0, lambda: next(waits_s), clock)
    clock.advance(passed_s)
    assert deadline.left_s() == pytest.approx(left_s)


@pytest.mark.parametrize(("text", "run_delay_s"), [("7 250000000 3\n", 0.25), ("0 0 0\n", None), (None, None)])
def test_waits_for_a_core_are_known_where_the_kernel_counts_them(monkeypatch, tmp_path, text, run_delay_s):
    if text is not None:
        (tmp_path / "schedstat").write_text(text)
    monkeypatch.setattr(budget, "Path", lambda path: tmp_path / Path(path).name)
    assert read_run_delay_s(os.getpid()) == run_delay_s


def test_budget_lasts_until_the_allowed_time_is_spent(clock):
    budget = Budget(clock, 2.0, lambda: False)
    clock.advance(1.999)
    assert not budget.used_up()
    clock.advance(0.001)
    assert budget.used_up()
    assert budget.spent_s == pytest.approx(2.0)
    assert budget.failure().code is MoveItErrorCode.TIMED_OUT
    assert "2 s" in budget.failure().message


def test_budget_and_its_shares_end_when_asked_to_stop(clock):
    budget = Budget(clock, 2.0, lambda: True)
    assert budget.used_up()
    assert budget.share(0.5).used_up()
    assert budget.failure().code is MoveItErrorCode.PREEMPTED


def test_a_share_of_a_budget_is_of_the_time_that_is_left(clock):
    budget = Budget(clock, 2.0, lambda: False)
    clock.advance(1.0)
    part = budget.share(0.5)
    assert part.left_s == pytest.approx(0.5)
    clock.advance(0.6)
    assert part.used_up()
    assert not budget.used_up()
    assert budget.left_s == pytest.approx(0.4)

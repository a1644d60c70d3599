from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from planners.budget import MAX_STARVED_S, Budget, Deadline, read_run_delay_s
from planners.problem import MoveItErrorCode

in_kernels_that_count = pytest.mark.skipif(
    read_run_delay_s(os.getpid()) is None, reason="this kernel does not count waits for a core"
)


class Waiter:
    """A process that a test makes wait for a core, and its clock."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.waited_s: float | None = 7.0

    def clock(self) -> float:
        return self.now_s

    def deadline(self, allowed_s: float) -> Deadline:
        return Deadline(allowed_s, lambda: self.waited_s, self.clock)


def test_the_deadline_of_a_process_that_never_waits_stays_where_it_is() -> None:
    waiter = Waiter()
    deadline = waiter.deadline(2.0)
    waiter.now_s += 1.5
    assert deadline.left_s() == pytest.approx(0.5)


def test_the_deadline_is_extended_by_what_the_process_has_waited_since() -> None:
    waiter = Waiter()
    deadline = waiter.deadline(2.0)
    waiter.now_s, waiter.waited_s = waiter.now_s + 3.0, 7.0 + 1.25
    assert deadline.left_s() == pytest.approx(0.25)


def test_a_process_that_waits_for_ever_passes_its_deadline_in_the_end() -> None:
    waiter = Waiter()
    deadline = waiter.deadline(2.0)
    waiter.now_s, waiter.waited_s = waiter.now_s + MAX_STARVED_S + 2.5, 7.0 + MAX_STARVED_S + 2.5
    assert deadline.left_s() == pytest.approx(-0.5)


@pytest.mark.parametrize("known_first", [False, True])
def test_without_known_waits_the_deadline_stays(known_first: bool) -> None:
    waiter = Waiter()
    waiter.waited_s = 7.0 if known_first else None
    deadline = waiter.deadline(2.0)
    waiter.now_s, waiter.waited_s = waiter.now_s + 3.0, None if known_first else 8.0
    assert deadline.left_s() == pytest.approx(-1.0)


Start = Callable[[], int]


@pytest.fixture
def busy_process() -> Iterator[Start]:
    """Start a process that wants one core, always the same; returns its id."""
    core = max(os.sched_getaffinity(0))
    program = f"import os; os.sched_setaffinity(0, {{{core}}})\nwhile True: pass"
    started: list[subprocess.Popen[bytes]] = []

    def start() -> int:
        started.append(subprocess.Popen([sys.executable, "-c", program]))
        return started[-1].pid

    yield start
    for process in started:
        process.kill()
        process.wait()


def run_delay_s(pid: int) -> float:
    # None of a process that has not been on a core yet.
    return read_run_delay_s(pid) or 0.0


@in_kernels_that_count
def test_processes_that_want_the_same_core_wait_for_it(busy_process: Start) -> None:
    began_s = time.monotonic()
    pids = [busy_process() for _ in range(4)]
    # Three of four wait at any time; what they are on the core does not add up to more than has passed.
    while sum(map(run_delay_s, pids)) < 0.2 + time.monotonic() - began_s:
        assert time.monotonic() < began_s + 60.0
        time.sleep(0.01)


@in_kernels_that_count
def test_a_process_that_is_stopped_does_not_wait_for_a_core(busy_process: Start) -> None:
    pid = busy_process()
    os.kill(pid, signal.SIGSTOP)
    while psutil.Process(pid).status() != psutil.STATUS_STOPPED:
        time.sleep(0.01)
    before_s = run_delay_s(pid)
    time.sleep(0.05)
    assert run_delay_s(pid) == before_s


def test_nothing_is_known_of_a_process_that_is_gone(busy_process: Start) -> None:
    pid = busy_process()
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    assert read_run_delay_s(pid) is None


def test_nothing_is_known_where_the_kernel_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "read_text", lambda _path: "0 0 0\n")
    assert read_run_delay_s(os.getpid()) is None


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def test_budget_lasts_until_the_allowed_time_is_spent(clock):
    budget = Budget(clock, 2.0, lambda: False)
    clock.now_s += 1.999
    assert not budget.used_up()
    clock.now_s += 0.001
    assert budget.used_up()
    assert budget.spent_s == pytest.approx(2.0)


def test_budget_ends_when_asked_to_stop(clock):
    assert Budget(clock, 2.0, lambda: True).used_up()


def test_failure_for_lack_of_time_names_the_allowed_time(clock):
    budget = Budget(clock, 2.5, lambda: False)
    clock.now_s += 3.0
    failure = budget.failure()
    assert failure.code is MoveItErrorCode.TIMED_OUT
    assert "2.5 s" in failure.message


def test_failure_after_a_stop_is_preempted(clock):
    assert Budget(clock, 2.0, lambda: True).failure().code is MoveItErrorCode.PREEMPTED


def test_a_share_of_a_budget_is_of_the_time_that_is_left(clock):
    budget = Budget(clock, 2.0, lambda: False)
    clock.now_s += 1.0
    part = budget.share(0.5)
    assert part.left_s == pytest.approx(0.5)
    clock.now_s += 0.6
    assert part.used_up()
    assert not budget.used_up()
    assert budget.left_s == pytest.approx(0.4)


def test_a_share_of_a_budget_is_stopped_with_it(clock):
    assert Budget(clock, 2.0, lambda: True).share(0.5).used_up()

from __future__ import annotations

import dataclasses
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from planners import worker
from planners.problem import PlanningProblem
from tests.helpers import broken_planner
from tests.helpers.motions import EASY

ROOT = Path(__file__).parents[2]

# What a plain goal does not need and takes long to load, by the names in sys.modules.
LATE_LIBRARIES = ("matplotlib", "scipy", "pydantic", "PIL")


def output_of(program: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    return done.stdout.split()


@pytest.mark.parametrize("library", LATE_LIBRARIES)
def test_a_worker_starts_without_what_a_plain_goal_does_not_need(loaded_by_a_worker: list[str], library: str) -> None:
    assert library not in loaded_by_a_worker


@pytest.fixture(scope="module")
def loaded_by_a_worker() -> list[str]:
    return output_of(
        "import sys; from pathlib import Path; from planners import worker; from robot.description import model;"
        "arm = Path('robot/arms/so101'); worker.Planner(model.load(arm / 'so101.urdf', arm / 'so101.srdf'));"
        "print(*sys.modules)"
    )


def test_running_out_of_memory_is_an_error_that_can_be_caught() -> None:
    program = """
from planners import worker
worker.limit_memory(400 << 20)
try:
    worker.Planner.__module__ * (500 << 20)
except MemoryError:
    print("caught")
"""
    assert output_of(program) == ["caught"]


def test_allowed_time_does_not_pass_while_a_worker_is_off_its_core() -> None:
    clock = worker.allowed_time_clock()
    before_s = clock()
    time.sleep(0.05)
    assert clock() - before_s < 0.05


def test_allowed_time_is_that_on_the_wall_where_the_kernel_does_not_count_waits_for_a_core(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(worker, "read_run_delay_s", lambda _pid: None)
    assert worker.allowed_time_clock() is time.monotonic


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def reports(problem: PlanningProblem, *checked_after_s: float) -> list[float]:
    """What is reported of a problem that is worked on for so long, checked at these times [s]."""
    clock, reported = Clock(), list[float]()
    hardness = worker.Hardness(clock, problem, reported.append)
    for after_s in checked_after_s:
        clock.now_s = 100.0 + after_s
        hardness.check()
    return reported


AT_ONCE = dataclasses.replace(EASY, optimization_time_s=0.0)


def test_a_problem_is_hard_once_it_takes_longer_than_most() -> None:
    assert reports(AT_ONCE, 0.0, 0.9 * worker.HARD_AFTER_S) == []
    assert len(reports(AT_ONCE, 1.1 * worker.HARD_AFTER_S)) == 1


def test_a_hard_problem_is_reported_each_time_that_it_has_taken_twice_as_long() -> None:
    assert reports(AT_ONCE, 1.0, 1.9, 2.5, 4.9, 5.1) == pytest.approx([1.0, 2.5, 5.1])


def test_a_problem_is_not_hard_for_the_time_that_it_asks_to_be_shortened_for() -> None:
    problem = dataclasses.replace(EASY, optimization_time_s=2.0)
    assert reports(problem, 1.9) == []
    assert len(reports(problem, 2.1)) == 1


def test_a_worker_that_hangs_ends_with_its_server() -> None:
    program = f"""
import asyncio, os
from planners import pool as pool_module
from planners.pool import PlannerPool
from tests.helpers.motions import broken
from tests.helpers.robots import so101
async def serve():
    pool_module.WORKER_MODULE = "tests.helpers.broken_planner"
    pool = PlannerPool(so101())
    await pool.start()
    asking = asyncio.create_task(pool.ask(broken({broken_planner.NATIVE_LOOP!r})))
    while pool.idle_count != 1 or len(pool.pids) != 2:
        await asyncio.sleep(0.01)
    await asyncio.sleep(0.1)
    print(*pool.pids, flush=True)
    os._exit(0)
asyncio.run(serve())
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    pids = [int(pid) for pid in done.stdout.split()]
    _, alive = psutil.wait_procs([psutil.Process(pid) for pid in pids if psutil.pid_exists(pid)], timeout=30.0)
    assert len(pids) == 2
    assert not alive

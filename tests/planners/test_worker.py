from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from planners import worker
from tests.helpers import broken_planner

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

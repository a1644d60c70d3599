"""Waits of processes for a core, as the kernel counts them, and the end of a planner process with its server."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from harness.waiting import wait_until
from planners.budget import read_run_delay_s
from tests.helpers import broken_planner

ROOT = Path(__file__).parents[3]

needs_run_delay = pytest.mark.skipif(
    read_run_delay_s(os.getpid()) is None, reason="this kernel does not count waits for a core"
)


def run_delay_s(pid: int) -> float:
    # None of a process that has not been on a core yet.
    return read_run_delay_s(pid) or 0.0


@needs_run_delay
def test_processes_that_want_the_same_core_wait_for_it(start_on_one_core: Callable[[], int]) -> None:
    began_s = time.monotonic()
    pids = [start_on_one_core() for _ in range(4)]
    # Three of four wait at any time; what they are on the core does not add up to more than has passed.
    wait_until(lambda: sum(map(run_delay_s, pids)) >= 0.2 + time.monotonic() - began_s)


def test_a_worker_that_hangs_ends_with_its_server() -> None:
    program = f"""
import asyncio, os
from planners import pool as pool_module
from planners.pool import PlannerPool
from tests.helpers.motions import broken
from tests.helpers.robots import so101
from harness.waiting import until
async def serve():
    pool_module.WORKER_MODULE = "tests.helpers.broken_planner"
    pool = PlannerPool(so101())
    await pool.start()
    asking = asyncio.create_task(pool.ask(broken({broken_planner.NATIVE_LOOP!r})))
    await until(lambda: pool.idle_count == 1 and len(pool.pids) == 2)
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

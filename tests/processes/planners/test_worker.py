"""End of a planner process with its server."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import psutil

from tests.helpers import broken_planner

ROOT = Path(__file__).parents[3]


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

from __future__ import annotations

import asyncio
import dataclasses
from pathlib import Path

import pytest

from planners import local_workers, worker_process
from planners.local_workers import LocalWorkers
from planners.worker_process import WorkerProcess
from robot.description import model
from robot.description.model import RobotModel

ROOT = Path(__file__).parents[2]
MEMORY_LIMIT_BYTES = 300 << 20


class Workers:
    """Local workers, and what they have told."""

    def __init__(self, robot: RobotModel) -> None:
        self.ready: asyncio.Queue[WorkerProcess] = asyncio.Queue()
        self.failed = asyncio.Event()
        self.those = LocalWorkers(robot, 1, MEMORY_LIMIT_BYTES, self.ready.put_nowait, self.failed.set)


async def test_a_robot_that_no_worker_can_load_is_told_and_not_tried_again() -> None:
    workers = Workers(dataclasses.replace(model.builtin(), urdf="<robot/>"))
    await workers.those.start()
    await asyncio.wait_for(workers.failed.wait(), 60.0)
    assert workers.those.load_failure is not None
    assert workers.ready.empty()
    await workers.those.close()
    assert workers.those.pids == ()


async def test_workers_that_never_start_are_told_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_workers, "RESTART_PAUSE_S", 0.01)
    monkeypatch.setattr(worker_process, "WORKER_MODULE", "planners.no_such_module")
    workers = Workers(model.builtin())
    await workers.those.start()
    await asyncio.wait_for(workers.failed.wait(), 60.0)
    assert "planner processes ended while starting" in str(workers.those.load_failure)
    monkeypatch.setattr(worker_process, "WORKER_MODULE", "planners.worker")
    worker = await asyncio.wait_for(workers.ready.get(), 60.0)
    assert worker.pid in workers.those.pids
    assert workers.those.load_failure is None
    await workers.those.close()


async def test_a_worker_that_hangs_while_it_loads_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_workers, "LOAD_TIMEOUT_S", 0.1)
    monkeypatch.setattr(local_workers, "MAX_FAILED_STARTS", 1)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    # It lives, but never says that it has loaded anything.
    monkeypatch.setattr(worker_process, "WORKER_MODULE", "tests.helpers.echo_child")
    workers = Workers(model.builtin())
    await workers.those.start()
    await asyncio.wait_for(workers.failed.wait(), 60.0)
    await workers.those.close()

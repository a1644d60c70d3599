"""Dask cluster compared with the local planners: the overhead of the transport, and the time to cancel a task.

Scheduler and worker run on this machine, so the overhead is the least possible; a network adds its round trips.
"""

from __future__ import annotations

import asyncio
import dataclasses
import time

import numpy as np
import uvloop

from benchmarks.event_loop import Ticker
from benchmarks.figures import percentiles, print_table
from planners.cluster.cluster import Cluster
from planners.planning_worker import PlanningWorker
from planners.pool import MEMORY_LIMIT_BYTES, PlannerPool
from planners.problem import Plan, PlanningProblem
from planners.scene import EMPTY_SCENE, Box, Pose, Scene, SceneObject
from robot.description import model
from tests.helpers.dask_cluster import DaskCluster
from tests.helpers.requests import EASY, LONG

ROUNDS = 200
CANCELS = 50
SCENE_SIZES = (20, 1000)
JOIN_TIMEOUT_S = 30.0

# A search among the arm's own links, which takes some ten thousand collision checks.
SEARCH = dataclasses.replace(LONG, allowed_time_s=5.0, optimization_time_s=0.006, attempts=1)


class _Pool(PlannerPool):
    """Pool of local planners; the remote worker that joins becomes ``far`` instead."""

    def __init__(self) -> None:
        super().__init__(model.builtin())
        self.far = asyncio.get_running_loop().create_future()

    def add(self, worker: PlanningWorker) -> None:
        self.far.set_result(worker)

    def remove(self, worker: PlanningWorker) -> None:
        """Do nothing: no request waits for a worker."""


def run() -> None:
    """Plan locally and on the cluster in turns within one run: the difference is the overhead of the transport."""
    dask = DaskCluster()
    dask.start_scheduler()
    dask.start_worker()
    try:
        uvloop.run(_measure(dask.address))
    finally:
        dask.close()


async def _measure(address: str) -> None:
    pool = _Pool()
    await pool.start()
    cluster = Cluster(address, model.builtin(), MEMORY_LIMIT_BYTES, pool)
    cluster.start()
    far: PlanningWorker = await asyncio.wait_for(pool.far, JOIN_TIMEOUT_S)
    print_table(
        f"A plan here and on a Dask worker of this machine, {ROUNDS} in turns [ms]",
        ["", "here p50", "there p50", "ratio", "there p99"],
        [await _compare(name, problem, pool, far) for name, problem in (("straight line", EASY), ("search", SEARCH))],
    )
    print_table(
        "A scene goes to a Dask worker once [ms]",
        ["boxes", "first plan here", "there", "next here", "there", "longest hold of the server's event loop"],
        [await _scene(Scene(version, _boxes(count)), pool, far) for version, count in enumerate(SCENE_SIZES, start=1)],
    )
    cancels_s = [await _cancel(far) for _ in range(CANCELS)]
    print_table(
        "From a cancel to the next plan of the same worker [ms]",
        ["times", "p50", "p99", "max"],
        [[str(CANCELS), *percentiles(cancels_s, 50, 99, 100)]],
    )
    await cluster.close()
    await pool.close()


async def _compare(name: str, problem: PlanningProblem, pool: PlannerPool, far: PlanningWorker) -> list[str]:
    here_s, there_s = [], []
    for _ in range(ROUNDS):
        started_s = time.monotonic()
        await pool.ask(problem)
        here_s.append(time.monotonic() - started_s)
        there_s.append(await _timed(far, problem, EMPTY_SCENE))
    ratio = np.median(there_s) / np.median(here_s)
    return [name, *percentiles(here_s, 50), *percentiles(there_s, 50), f"{ratio:.1f}", *percentiles(there_s, 99)]


async def _timed(planner: PlannerPool | PlanningWorker, problem: PlanningProblem, scene: Scene) -> float:
    started_s = time.monotonic()
    answer = await planner.ask(problem, scene)
    if not isinstance(answer, Plan):
        raise TypeError(f"a problem that has a plan was answered with {answer}")
    return time.monotonic() - started_s


async def _scene(scene: Scene, pool: PlannerPool, far: PlanningWorker) -> list[str]:
    here_s = [await _timed(pool, EASY, scene) for _ in range(2)]
    ticker = Ticker()
    ticking = asyncio.create_task(ticker.run())
    await asyncio.sleep(0.05)
    there_s = [await _timed(far, EASY, scene) for _ in range(2)]
    ticking.cancel()
    firsts, nexts = zip(here_s, there_s, strict=True)
    times = (percentiles([time_s], 50)[0] for time_s in (*firsts, *nexts))
    return [str(len(scene.objects)), *times, *percentiles(ticker.cpu_s, 100)]


async def _cancel(far: PlanningWorker) -> float:
    """Cancel a search that has no end; its worker has one thread, so the next plan waits for the cancellation."""
    planning = asyncio.create_task(far.ask(LONG, EMPTY_SCENE))
    await asyncio.sleep(0.1)
    planning.cancel()
    await asyncio.wait([planning])
    started_s = time.monotonic()
    await far.cancel()
    await _timed(far, EASY, EMPTY_SCENE)
    return time.monotonic() - started_s


def _boxes(count: int) -> tuple[SceneObject, ...]:
    shape = ((Box((0.01, 0.01, 0.01)), Pose()),)
    return tuple(SceneObject(f"box {i}", shape, Pose((2.0 + 0.02 * i, 0.0, 0.0))) for i in range(count))

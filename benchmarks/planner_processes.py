"""Planner processes: their cost, and the time until one is free again after a cancel, a hang and a large scene."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Awaitable

import psutil
import uvloop

from benchmarks.event_loop import Ticker
from benchmarks.figures import percentiles, print_table
from planners import pool as pool_module
from planners.pool import MEMORY_LIMIT_BYTES, PlannerPool, WorkerProcess
from planners.problem import Answer, StateAnswer
from planners.scene import Box, Pose, Scene, SceneObject
from robot.description.robot_folder import built_in
from tests.helpers import broken_planner
from tests.helpers.motions import EASY, LONG, STATE, broken

STARTS = 7
ROUND_TRIPS = 500
CANCELS = 200
KILLS = 15
SCENE_SIZES = (20, 1000)
SEED = 4


def run() -> None:
    """Measure starts, round trips, cancels, kills and scenes."""
    for measure in (_starts, _free_again, _scenes):
        uvloop.run(measure())


async def _worker() -> WorkerProcess:
    loaded = asyncio.Event()
    worker = WorkerProcess(
        built_in("so101").model, MEMORY_LIMIT_BYTES, lambda _worker, _refusal: loaded.set(), lambda _worker: None
    )
    await worker.start()
    await asyncio.wait_for(loaded.wait(), 30.0)
    return worker


async def _starts() -> None:
    rows = []
    for _ in range(STARTS):
        started_s = time.monotonic()
        worker = await _worker()
        start_s = time.monotonic() - started_s
        fresh = _memory_mb(worker.pid)
        await worker.ask(EASY, Scene())
        rows.append((start_s, fresh, _memory_mb(worker.pid)))
        await worker.kill()
    fresh, planned = rows[-1][1:]
    print_table(
        "A planner process: from its start to ready [s], and its memory [MB]",
        ["starts", "median", "max", "resident", "of it its own", "after a plan"],
        [
            [
                str(STARTS),
                *percentiles((row[0] for row in rows), 50, 100, scale=1.0),
                f"{fresh[0]:.0f}",
                f"{fresh[1]:.0f}",
                f"{planned[0]:.0f}",
            ]
        ],
    )


def _memory_mb(pid: int) -> tuple[float, float]:
    """Return the resident memory, and the part that no other process shares [MB]."""
    info = psutil.Process(pid).memory_full_info()
    return info.rss / 1e6, info.uss / 1e6


async def _free_again() -> None:
    worker = await _worker()
    round_trips_s = [await _timed(worker.ask(STATE, Scene())) for _ in range(ROUND_TRIPS)]
    rng = random.Random(SEED)
    cancels_s = [await _cancel(worker, rng.uniform(0.002, 0.1)) for _ in range(CANCELS)]
    await worker.kill()
    kills_s = await _kills()
    print_table(
        "Round trip, and from a cancel to a worker that takes requests [ms]",
        ["", "times", "p50", "p99", "max"],
        [
            ["round trip of a state check", str(ROUND_TRIPS), *percentiles(round_trips_s, 50, 99, 100)],
            ["cancel to the same worker free", str(CANCELS), *percentiles(cancels_s, 50, 99, 100)],
            ["cancel of a native hang to an answer of the spare", str(KILLS), *percentiles(kills_s, 50, 99, 100)],
        ],
    )


async def _timed(question: Awaitable[Answer]) -> float:
    started_s = time.monotonic()
    answer = await question
    if not isinstance(answer, StateAnswer):
        raise TypeError(f"a state check was answered with {answer}")
    return time.monotonic() - started_s


async def _cancel(worker: WorkerProcess, after_s: float) -> float:
    planning = asyncio.create_task(worker.ask(LONG, Scene()))
    await asyncio.wait([planning], timeout=after_s)
    planning.cancel()
    started_s = time.monotonic()
    await worker.cancel()
    free_s = time.monotonic() - started_s
    if not worker.usable:
        raise RuntimeError("a cancelled worker did not listen and was ended")
    await asyncio.wait([planning])
    return free_s


async def _kills() -> list[float]:
    """Cancel requests that hang in native code; the next request waits for the spare process only."""
    pool_module.WORKER_MODULE = "tests.helpers.broken_planner"
    pool = PlannerPool(built_in("so101").model)
    await pool.start()
    times_s = []
    for _ in range(KILLS):
        while pool.idle_count < 2:  # noqa: ASYNC110 - a benchmark may poll
            await asyncio.sleep(0.01)
        hanging = asyncio.create_task(pool.ask(broken(broken_planner.NATIVE_LOOP)))
        await asyncio.wait([hanging], timeout=0.05)
        hanging.cancel()
        times_s.append(await _timed(pool.ask(STATE)))
    await pool.close()
    pool_module.WORKER_MODULE = "planners.worker"
    return times_s


async def _scenes() -> None:
    worker = await _worker()
    rows = []
    for version, count in enumerate(SCENE_SIZES, start=1):
        scene = Scene(version, _boxes(count))
        ticker = Ticker()
        ticking = asyncio.create_task(ticker.run())
        await asyncio.sleep(0.05)
        first_s = await _timed(worker.ask(STATE, scene))
        again_s = await _timed(worker.ask(STATE, scene))
        ticking.cancel()
        rows.append([str(count), *percentiles([first_s, again_s], 100, 0), *percentiles(ticker.cpu_s, 100)])
    await worker.kill()
    print_table(
        "A scene goes to a worker once [ms]",
        ["boxes", "first state check", "next", "longest hold of the server's event loop"],
        rows,
    )


def _boxes(count: int) -> tuple[SceneObject, ...]:
    shape = ((Box((0.01, 0.01, 0.01)), Pose()),)
    return tuple(SceneObject(f"box {i}", shape, Pose((2.0 + 0.02 * i, 0.0, 0.0))) for i in range(count))

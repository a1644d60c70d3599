"""Planner processes: their cost, the time until one is free after a cancel, a hang and a large scene, and races."""

from __future__ import annotations

import asyncio
import dataclasses
import itertools
import random
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Iterator

import psutil
import uvloop

from benchmarks.planning import AT_ZERO, EASY, LONG
from benchmarks.planning_scenes import SCENES
from harness.figures import percentiles, print_table
from planners import pool as planner_pool
from planners import worker
from planners.budget import never
from planners.files import problem_file
from planners.interface import LOAD_TIMEOUT_S
from planners.messages import LoadRobot
from planners.pipeline import Planner
from planners.pool import MEMORY_LIMIT_BYTES, PlannerPool, WorkerProcess
from planners.problem import Answer, Plan, PlanningFailure, PlanningProblem, Request, StateAnswer, StateQuestion
from planners.scene import Box, Pose, Scene, SceneObject
from planners.worker import HARD_AFTER_S
from robot.description.robot_folder import built_in
from robot.processes import DescriptorReserve, Template

STARTS = 7
ROUND_TRIPS = 500
CANCELS = 200
KILLS = 15
SCENE_SIZES = (20, 1000)
SEED = 4
STATE = StateQuestion("arm", AT_ZERO)
HANG = "hang"

RACES = 50  # in each scene
TICK_S = 0.001


class Ticker:
    """Task that wants its turn every millisecond, and notes the CPU time that the loop spends between two turns."""

    def __init__(self) -> None:
        self.cpu_s: list[float] = []

    async def run(self) -> None:
        """Tick until cancelled."""
        cpu_s = time.thread_time()
        while True:
            await asyncio.sleep(TICK_S)
            now_cpu_s = time.thread_time()
            self.cpu_s.append(now_cpu_s - cpu_s)
            cpu_s = now_cpu_s


def run() -> None:
    """Measure starts, round trips, cancels, kills, scenes and races."""
    for measure in (_starts, _free_again, _scenes, _races):
        uvloop.run(measure())


LOAD = LoadRobot(built_in("so101").model, MEMORY_LIMIT_BYTES)


def _template() -> Template:
    return Template(planner_pool.WORKER_MODULE, LOAD, DescriptorReserve(), LOAD_TIMEOUT_S)


async def _worker(template: Template) -> WorkerProcess:
    loaded = asyncio.Event()
    worker = WorkerProcess(await template.copy(), LOAD, lambda _worker, _refusal: loaded.set(), lambda _worker: None)
    await worker.start()
    await asyncio.wait_for(loaded.wait(), LOAD_TIMEOUT_S)
    return worker


async def _starts() -> None:
    rows = []
    for _ in range(STARTS):
        started_s = time.monotonic()
        template = _template()
        await (await _worker(template)).kill()
        first_s, started_s = time.monotonic() - started_s, time.monotonic()
        worker = await _worker(template)
        next_s = time.monotonic() - started_s
        fresh = _memory_mb(worker.pid)
        await worker.ask(EASY, Scene())
        planned = _memory_mb(worker.pid)
        rows.append((first_s, next_s))
        await template.close()
    print_table(
        "A planner process: from its start to ready, the first and the next [s], and its memory [MB]",
        ["starts", "median", "max", "next", "max", "resident", "of it its own", "after a plan"],
        [
            [
                str(STARTS),
                *(figure for times_s in zip(*rows, strict=True) for figure in percentiles(times_s, 50, 100, scale=1.0)),
                *(f"{mb:.0f}" for mb in (*fresh, planned[0])),
            ]
        ],
    )


def _memory_mb(pid: int) -> tuple[float, float]:
    """Return the resident memory, and the part that no other process shares [MB]."""
    info = psutil.Process(pid).memory_full_info()
    return info.rss / 1e6, info.uss / 1e6


async def _free_again() -> None:
    template = _template()
    worker = await _worker(template)
    round_trips_s = [await _timed(worker.ask(STATE, Scene())) for _ in range(ROUND_TRIPS)]
    rng = random.Random(SEED)
    cancels_s = [await _cancel(worker, rng.uniform(0.002, 0.1)) for _ in range(CANCELS)]
    await template.close()
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
    planner_pool.WORKER_MODULE = "benchmarks.planner_processes"
    pool = PlannerPool(built_in("so101").model)
    await pool.start()
    times_s = []
    for _ in range(KILLS):
        while pool.idle_count < 2:  # noqa: ASYNC110 - a benchmark may poll
            await asyncio.sleep(0.01)
        hanging = asyncio.create_task(pool.ask(dataclasses.replace(EASY, group=HANG)))
        await asyncio.wait([hanging], timeout=0.05)
        hanging.cancel()
        times_s.append(await _timed(pool.ask(STATE)))
    await pool.close()
    planner_pool.WORKER_MODULE = "planners.worker"
    return times_s


async def _scenes() -> None:
    template = _template()
    worker = await _worker(template)
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
    await template.close()
    print_table(
        "A scene goes to a worker once [ms]",
        ["boxes", "first state check", "next", "longest hold of the server's event loop"],
        rows,
    )


def _boxes(count: int) -> tuple[SceneObject, ...]:
    shape = ((Box((0.01, 0.01, 0.01)), Pose()),)
    return tuple(SceneObject(f"box {i}", shape, Pose((2.0 + 0.02 * i, 0.0, 0.0))) for i in range(count))


@dataclasses.dataclass
class Cost:
    """Cost of answers: wall time of each, CPU time of all [s]."""

    wall_s: list[float] = dataclasses.field(default_factory=list)
    cpu_s: float = 0.0


async def _races() -> None:
    """Plan each motion with and without a race, one right after the other: the machine may be busier later."""
    pools = {racing: PlannerPool(built_in("so101").model, racing=racing) for racing in (False, True)}
    for pool in pools.values():
        await pool.start()
    costs: dict[bool, dict[bool, Cost]] = defaultdict(lambda: {False: Cost(), True: Cost()})
    for problem, scene in _motions():
        asked = {racing: await _asked(pool, problem, scene) for racing, pool in pools.items()}
        alone = asked[False][0]
        for racing, (answer, wall_s, cpu_s) in asked.items():
            if isinstance(answer, Plan) and isinstance(alone, Plan):
                cost = costs[alone.planning_time_s > problem.optimization_time_s + HARD_AFTER_S][racing]
                cost.wall_s.append(wall_s)
                cost.cpu_s += cpu_s
    for pool in pools.values():
        await pool.close()
    print_table(
        "Motions planned by one worker, and by two once they prove hard [ms]",
        ["motions", "number", "workers", "p50", "p95", "p99", "mean", "CPU time in all [s]"],
        [row for hard in (False, True) for row in _rows("hard" if hard else "others", costs[hard])],
    )


def _rows(name: str, costs: dict[bool, Cost]) -> Iterator[list[str]]:
    """Rows of both ways, and of their ratio."""
    columns = []
    for racing, cost in costs.items():
        mean_s = sum(cost.wall_s) / max(1, len(cost.wall_s))
        columns.append([*(float(ms) for ms in percentiles(cost.wall_s, 50, 95, 99)), 1e3 * mean_s, cost.cpu_s])
        yield [name, str(len(cost.wall_s)), "2" if racing else "1", *(f"{value:.1f}" for value in columns[-1])]
    alone, raced = columns
    yield [name, "", "2 / 1", *(f"{two / one:.2f}" for one, two in zip(alone, raced, strict=True))]


def _motions() -> Iterator[tuple[PlanningProblem, Scene]]:
    """Motions from starts to goals of the problems in the benchmark's scenes, in any combination."""
    rng = random.Random(SEED)
    for version, path in enumerate(sorted(SCENES.glob("*.json")), start=1):
        file = problem_file.read(path, built_in("so101").model)
        scene = dataclasses.replace(file.scene, version=version)
        problems = [one.problem for one in file.problems if one.feasible]
        for seed in range(RACES):
            start, end = rng.sample(problems, 2)
            # A search counts up from its seed.
            yield dataclasses.replace(start, goal=end.goal, seed=1000 * seed), scene


async def _asked(
    pool: PlannerPool, problem: PlanningProblem, scene: Scene
) -> tuple[Plan | PlanningFailure, float, float]:
    """Return the answer, its wall time, and the CPU time of all workers until they are free again [s]."""
    while pool.idle_count < 2:  # noqa: ASYNC110 - a benchmark may poll
        await asyncio.sleep(0.001)
    cpu_s, started_s = _cpu_s(pool), time.monotonic()
    answer = await pool.ask(problem, scene)
    wall_s = time.monotonic() - started_s
    while pool.idle_count < 2:  # noqa: ASYNC110
        await asyncio.sleep(0.001)
    return answer, wall_s, _cpu_s(pool) - cpu_s


def _cpu_s(pool: PlannerPool) -> float:
    return sum(sum(psutil.Process(pid).cpu_times()[:2]) for pid in pool.pids)


class _HangingPlanner(Planner):
    """Planner that hangs in native code, which holds the interpreter, for requests of one group."""

    def answer(self, request: Request, should_stop: Callable[[], bool] = never) -> Answer:
        if isinstance(request, PlanningProblem) and request.group == HANG:
            max(itertools.repeat(0))
        return super().answer(request, should_stop)


if __name__ == "__main__":
    worker.main(_HangingPlanner)

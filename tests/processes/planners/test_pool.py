"""Real planner processes of a pool: their faults and their hangs."""

import asyncio
import dataclasses
import os
import random
import signal
from collections.abc import AsyncIterator
from pathlib import Path

import numpy as np
import psutil
import pytest
import pytest_asyncio

from harness.waiting import TIMEOUT_S, until, wait_until
from planners import pool as planner_pool
from planners.pool import PlannerPool
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, Request, StateAnswer, TimedRequest
from planners.scene import Box, Pose, Scene, SceneObject
from tests.helpers import broken_planner, motions
from tests.helpers.motions import LONG, STATE, broken
from tests.helpers.programs import run_python
from tests.helpers.resources import no_descriptors_left, runs
from tests.helpers.robots import so101

# Workers load for half a second: one pool serves the tests of this file, and so shows that it survives each.
pytestmark = pytest.mark.asyncio(loop_scope="module")

ROOT = Path(__file__).parents[3]
MEMORY_LIMIT_BYTES = 300 << 20

# With its hulls alone it is loaded in no time.
ROBOT = dataclasses.replace(so101(), parts={}, surfaces={})

# Solved at once, however late the worker gets its turn.
EASY = dataclasses.replace(motions.EASY, allowed_time_s=TIMEOUT_S)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pool() -> AsyncIterator[PlannerPool]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setattr(planner_pool, "WORKER_MODULE", "tests.helpers.broken_planner")
        # Two, also on a machine with one.
        cores = os.sched_getaffinity(0) | {0, 1}
        patch.setattr(os, "sched_getaffinity", lambda _pid: cores)
        # A starved worker neither hangs nor is deaf.
        patch.setattr(planner_pool, "OVERTIME_S", TIMEOUT_S)
        patch.setattr(planner_pool, "CANCEL_TIMEOUT_S", TIMEOUT_S)
        made = PlannerPool(ROBOT, memory_limit_bytes=MEMORY_LIMIT_BYTES)
        await made.start()
        yield made
        await made.close()


@pytest_asyncio.fixture(loop_scope="module")
async def both_idle(pool: PlannerPool) -> PlannerPool:
    """The pool once it has recovered from whatever came before."""
    await until(lambda: pool.idle_count == 2)
    return pool


def be_impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a worker that does not answer up at once."""
    monkeypatch.setattr(planner_pool, "OVERTIME_S", 0.1)
    monkeypatch.setattr(planner_pool, "CANCEL_TIMEOUT_S", 0.1)


async def test_every_kind_of_request_gets_its_kind_of_answer(pool: PlannerPool) -> None:
    for request, kind in motions.REQUESTS:
        if isinstance(request, TimedRequest):
            request = dataclasses.replace(request, allowed_time_s=TIMEOUT_S)
        assert isinstance(await pool.ask(request), kind), request


FAULTS = {
    broken_planner.SEGFAULT: "the planner process ended (SIGSEGV)",
    broken_planner.EXIT: "the planner process ended (exit code 3)",
    broken_planner.MEMORY: "more than the 315 MB of memory",
    broken_planner.EXCEPTION: "ValueError: a bug",
    broken_planner.NOT_TO_BE_PACKED: "the planner process ended (exit code 1)",
    broken_planner.HUGE_MESSAGE: "the planner process ended (SIGKILL)",
}


@pytest.mark.parametrize("fault", FAULTS)
async def test_a_fault_of_a_worker_costs_one_goal_and_at_most_this_worker(both_idle: PlannerPool, fault: str) -> None:
    before = set(both_idle.pids)
    answer = await both_idle.ask(broken(fault))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.CRASH
    assert FAULTS[fault] in answer.message
    assert isinstance(await both_idle.ask(EASY), Plan)
    await until(lambda: both_idle.idle_count == 2)
    assert len(before & set(both_idle.pids)) == (2 if fault == broken_planner.EXCEPTION else 1)


SIGNALS = (signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV, signal.SIGTERM, signal.SIGABRT)

# Open files and memory may vary by this much without a leak.
SPARE_FILES, SPARE_BYTES = 4, 30e6


async def fall(pool: PlannerPool, rng: random.Random) -> None:
    """Have a drawn fault happen to a motion: one of its own, a cancel, or a signal to one worker or to all."""
    fault = rng.choice([*broken_planner.FAULTS, "cancelled", *SIGNALS, "all killed", "template killed"])
    if isinstance(fault, str) and fault in broken_planner.FAULTS:
        await pool.ask(broken(fault, allowed_time_s=0.3))
        return
    asking = asyncio.create_task(pool.ask(dataclasses.replace(LONG, allowed_time_s=0.3, optimization_time_s=0.0)))
    await asyncio.wait([asking], timeout=rng.uniform(0.0, 0.2))
    if fault == "cancelled":
        asking.cancel()
    template = [psutil.Process(pid).ppid() for pid in pool.pids[:1]]
    hit = {"all killed": pool.pids, "template killed": template}.get(fault, [])
    for pid in [rng.choice(pool.pids)] if isinstance(fault, signal.Signals) else hit:
        os.kill(pid, fault if isinstance(fault, signal.Signals) else signal.SIGKILL)
    await asyncio.wait([asking])


async def test_drawn_faults_cost_one_motion_each_and_leave_nothing_behind(
    both_idle: PlannerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``make campaign-planners`` draws more: ``PLANNER_FAULTS`` says how many."""
    rng, process = random.Random(1), psutil.Process()
    be_impatient(monkeypatch)
    # For as long a worker that is stopped while it is idle is taken for one that is starved.
    easy = dataclasses.replace(EASY, allowed_time_s=20.0)
    expected = await both_idle.ask(easy)
    assert isinstance(expected, Plan)
    files, memory_bytes = process.num_fds(), process.memory_info().rss
    for _ in range(int(os.environ.get("PLANNER_FAULTS", "4"))):
        await asyncio.wait_for(fall(both_idle, rng), TIMEOUT_S)
        plan = await asyncio.wait_for(both_idle.ask(easy), TIMEOUT_S)
        # A fault that hit an idle worker costs the next motion.
        plan = plan if isinstance(plan, Plan) else await asyncio.wait_for(both_idle.ask(easy), TIMEOUT_S)
        assert isinstance(plan, Plan)
        assert np.array_equal(plan.trajectory.positions_rad, expected.trajectory.positions_rad)
    await until(lambda: both_idle.idle_count == len(both_idle.pids) == 2)
    assert process.num_fds() <= files + SPARE_FILES
    assert process.memory_info().rss <= memory_bytes + SPARE_BYTES


async def test_what_workers_are_copied_from_has_no_thread_that_a_copy_would_miss(both_idle: PlannerPool) -> None:
    (template,) = {psutil.Process(pid).ppid() for pid in both_idle.pids}
    assert psutil.Process(template).num_threads() == 1


async def test_a_worker_that_hangs_answers_timed_out_and_is_replaced(
    both_idle: PlannerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    be_impatient(monkeypatch)
    before = set(both_idle.pids)
    answer = await both_idle.ask(broken(broken_planner.NATIVE_LOOP, allowed_time_s=0.1))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.TIMED_OUT
    assert "0.1 s" in answer.message
    await until(lambda: both_idle.idle_count == 2)
    assert len(before & set(both_idle.pids)) == 1


@pytest.mark.parametrize(
    ("request_", "kept"),
    [(LONG, 2), (broken(broken_planner.NATIVE_LOOP), 1), (broken(broken_planner.DEAF), 1)],
    ids=["listens", "native loop", "deaf"],
)
async def test_a_cancelled_worker_is_kept_if_it_listens(
    both_idle: PlannerPool, request_: Request, kept: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kept == 1:
        be_impatient(monkeypatch)
    before = set(both_idle.pids)
    asking = asyncio.create_task(both_idle.ask(request_))
    await until(lambda: both_idle.idle_count == 1)
    asking.cancel()
    await asyncio.wait([asking])
    await until(lambda: both_idle.idle_count == 2)
    assert len(before & set(both_idle.pids)) == kept
    assert isinstance(await both_idle.ask(EASY), Plan)


async def test_a_large_scene_reaches_a_worker_whole(both_idle: PlannerPool) -> None:
    crowd = [
        SceneObject(f"box {i}", ((Box((0.01, 0.01, 0.01)), Pose()),), Pose((2.0 + 0.02 * i, 0.0, 0.0)))
        for i in range(600)
    ]
    block = SceneObject("block", ((Box((1.0, 1.0, 1.0)), Pose()),), Pose((0.5, 0.0, 0.5)))
    free = await both_idle.ask(STATE, Scene(1, tuple(crowd)))
    blocked = await both_idle.ask(STATE, Scene(2, (*crowd, block)))
    assert isinstance(free, StateAnswer)
    assert isinstance(blocked, StateAnswer)
    assert (free.valid, blocked.valid) == (True, False)


async def test_workers_come_back_where_clients_have_used_up_all_descriptors(both_idle: PlannerPool) -> None:
    before = set(both_idle.pids)
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    # The pool cannot have heard of it yet, as this does not give the event loop a turn.
    wait_until(lambda: not any(map(runs, before)))
    with no_descriptors_left():
        await until(lambda: both_idle.loaded_count == 2 and not before & set(both_idle.pids))
    # A worker that died while it was idle is idle no more.
    assert both_idle.idle_count == 2
    assert isinstance(await both_idle.ask(EASY), Plan)


async def test_a_worker_that_hangs_ends_with_its_server() -> None:
    program = f"""
import asyncio, os
from planners import pool as planner_pool
from planners.pool import PlannerPool
from tests.helpers.motions import broken
from harness.waiting import until
from tests.processes.planners.test_pool import ROBOT
async def serve():
    planner_pool.WORKER_MODULE = "tests.helpers.broken_planner"
    pool = PlannerPool(ROBOT)
    await pool.start()
    asking = asyncio.create_task(pool.ask(broken({broken_planner.NATIVE_LOOP!r})))
    await until(lambda: pool.idle_count == 1 and len(pool.pids) == 2)
    await asyncio.sleep(0.1)
    print(*pool.pids, flush=True)
    os._exit(0)
asyncio.run(serve())
"""
    done = await asyncio.to_thread(run_python, program)
    pids = [int(pid) for pid in done.stdout.split()]
    assert len(pids) == 2, done.stderr
    await until(lambda: not any(map(runs, pids)))

from __future__ import annotations

import asyncio
import dataclasses
import os
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path

import psutil
import pytest
import pytest_asyncio

from planners import pool as pool_module
from planners import worker_process
from planners.pool import MAX_WAITING, PlannerPool
from planners.problem import Answer, MoveItErrorCode, Plan, PlanningFailure, Request, StateAnswer
from robot import model
from tests.helpers import broken_planner
from tests.helpers.requests import EASY, LONG, REQUESTS, STATE, broken

# Workers load for half a second: one pool serves the tests of this file, and so shows that it survives each.
pytestmark = pytest.mark.asyncio(loop_scope="module")

ROOT = Path(__file__).parents[2]
MEMORY_LIMIT_BYTES = 300 << 20


def made_of(robot: model.RobotModel) -> PlannerPool:
    return PlannerPool(robot, memory_limit_bytes=MEMORY_LIMIT_BYTES)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pool() -> AsyncIterator[PlannerPool]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setattr(worker_process, "WORKER_MODULE", "tests.helpers.broken_planner")
        made = made_of(model.builtin())
        await made.start()
        assert made.idle_count == 0
        yield made
        await made.close()


@pytest_asyncio.fixture(loop_scope="module")
async def both_idle(pool: PlannerPool) -> PlannerPool:
    """The pool once it has recovered from whatever came before."""
    async with asyncio.timeout(20.0):
        while pool.idle_count < 2:
            await asyncio.sleep(0.01)
    return pool


def kill_all(pool: PlannerPool) -> None:
    """End the workers; the pool cannot have heard of it yet, as this does not give the event loop a turn."""
    for pid in pool.pids:
        os.kill(pid, signal.SIGKILL)
    while any(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE for pid in pool.pids):
        time.sleep(0.01)


async def given_up(pool: PlannerPool, request: Request, after_s: float) -> None:
    """Ask, and cancel while a worker works on it."""
    asking = asyncio.create_task(pool.ask(request))
    await asyncio.sleep(after_s)
    assert not asking.done()
    asking.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asking


async def test_requests_sent_together_while_workers_load_are_all_answered(pool: PlannerPool) -> None:
    answers = await asyncio.gather(*(pool.ask(EASY) for _ in range(5)))
    assert all(isinstance(answer, Plan) for answer in answers)
    assert pool.idle_count > 0


async def test_one_worker_stands_by_beside_the_active_ones(both_idle: PlannerPool) -> None:
    assert len(both_idle.pids) == 2


@pytest.mark.parametrize(("request_", "kind"), REQUESTS, ids=[type(request).__name__ for request, _ in REQUESTS])
async def test_every_kind_of_request_gets_its_kind_of_answer(
    both_idle: PlannerPool, request_: Request, kind: type[Answer]
) -> None:
    assert isinstance(await both_idle.ask(request_), kind)


FAULTS = {
    broken_planner.SEGFAULT: "the planner process ended (SIGSEGV)",
    broken_planner.ABORT: "the planner process ended (SIGABRT)",
    broken_planner.EXIT: "the planner process ended (exit code 3)",
    broken_planner.MEMORY: "more than the 315 MB of memory",
    broken_planner.EXCEPTION: "ValueError: a bug",
    broken_planner.WRONG_ANSWER: "answered a PlanningProblem with StateAnswer",
    broken_planner.NO_ANSWER: "answered a PlanningProblem with str",
    broken_planner.NOT_TO_BE_PACKED: "the planner process ended (exit code 1)",
    broken_planner.NO_MESSAGE: "the planner process ended (SIGKILL)",
    broken_planner.HUGE_MESSAGE: "the planner process ended (SIGKILL)",
}


@pytest.mark.parametrize("fault", FAULTS)
async def test_a_fault_of_a_worker_costs_one_goal(pool: PlannerPool, fault: str) -> None:
    answer = await pool.ask(broken(fault))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.CRASH
    assert FAULTS[fault] in answer.message
    assert isinstance(await pool.ask(EASY), Plan)


async def test_a_worker_that_ran_out_of_memory_is_replaced(both_idle: PlannerPool) -> None:
    before = set(both_idle.pids)
    await both_idle.ask(broken(broken_planner.MEMORY))
    async with asyncio.timeout(20.0):
        while both_idle.idle_count < 2:
            await asyncio.sleep(0.01)
    assert len(before & set(both_idle.pids)) == 1


async def test_a_worker_that_hangs_answers_timed_out_and_is_replaced(both_idle: PlannerPool) -> None:
    before = both_idle.pids
    answer = await both_idle.ask(broken(broken_planner.NATIVE_LOOP, allowed_time_s=0.1))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.TIMED_OUT
    assert "0.1 s" in answer.message
    assert isinstance(await both_idle.ask(EASY), Plan)
    async with asyncio.timeout(20.0):
        while both_idle.idle_count < 2:
            await asyncio.sleep(0.01)
    assert len(set(before) & set(both_idle.pids)) == 1


async def test_questions_do_not_wait_for_a_motion_in_planning(both_idle: PlannerPool) -> None:
    planning = asyncio.create_task(both_idle.ask(LONG))
    await asyncio.sleep(0.1)
    assert isinstance(await both_idle.ask(STATE), StateAnswer)
    assert not planning.done()
    planning.cancel()
    await asyncio.wait([planning])


async def test_cancelling_ends_a_long_search_and_keeps_its_worker(both_idle: PlannerPool) -> None:
    before = both_idle.pids
    for _ in range(3):
        await given_up(both_idle, LONG, 0.1)
        assert isinstance(await both_idle.ask(EASY), Plan)
    assert both_idle.pids == before


async def test_the_spare_takes_over_before_a_cancelled_worker_listens(
    both_idle: PlannerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_process, "CANCEL_TIMEOUT_S", 60.0)
    before = set(both_idle.pids)
    await given_up(both_idle, broken(broken_planner.DEAF), 0.05)
    assert isinstance(await asyncio.wait_for(both_idle.ask(EASY), 5.0), Plan)
    assert set(both_idle.pids) == before
    for pid in before:
        os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize("fault", [broken_planner.NATIVE_LOOP, broken_planner.DEAF])
async def test_a_cancelled_worker_that_does_not_listen_is_replaced(both_idle: PlannerPool, fault: str) -> None:
    before = set(both_idle.pids)
    await given_up(both_idle, broken(fault), 0.05)
    async with asyncio.timeout(20.0):
        while both_idle.idle_count < 2:
            await asyncio.sleep(0.01)
    assert len(before & set(both_idle.pids)) == 1


async def test_workers_that_died_while_idle_cost_no_goal(both_idle: PlannerPool) -> None:
    kill_all(both_idle)
    assert isinstance(await both_idle.ask(EASY), Plan)


async def test_more_requests_than_may_wait_are_refused(both_idle: PlannerPool) -> None:
    asking = [asyncio.create_task(both_idle.ask(LONG)) for _ in range(MAX_WAITING + 1)]
    await asyncio.sleep(0.1)
    answer = await both_idle.ask(EASY)
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.FAILURE
    assert f"limit {MAX_WAITING}" in answer.message
    for task in asking:
        task.cancel()
    await asyncio.wait(asking)


async def test_a_robot_that_no_worker_can_load_is_told() -> None:
    broken_robot = made_of(dataclasses.replace(model.builtin(), urdf="<robot/>"))
    await broken_robot.start()
    answer = await broken_robot.ask(EASY)
    await broken_robot.close()
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.FAILURE
    assert "planning is not available" in answer.message


async def test_workers_that_never_start_are_told_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool_module, "RESTART_PAUSE_S", 0.01)
    monkeypatch.setattr(worker_process, "WORKER_MODULE", "planners.no_such_module")
    recovering = made_of(model.builtin())
    await recovering.start()
    answer = await recovering.ask(EASY)
    assert isinstance(answer, PlanningFailure)
    assert "planning is not available: planner processes ended while starting" in answer.message
    monkeypatch.setattr(worker_process, "WORKER_MODULE", "planners.worker")
    async with asyncio.timeout(20.0):
        while isinstance(await recovering.ask(EASY), PlanningFailure):
            await asyncio.sleep(0.01)
    await recovering.close()


async def test_where_workers_have_loaded_requests_wait_for_the_next_that_does(
    both_idle: PlannerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool_module, "RESTART_PAUSE_S", 0.1)
    monkeypatch.setattr(worker_process, "WORKER_MODULE", "planners.no_such_module")
    kill_all(both_idle)
    asking = asyncio.create_task(both_idle.ask(EASY))
    async with asyncio.timeout(20.0):
        while both_idle._failed_starts < pool_module.MAX_FAILED_STARTS:
            await asyncio.sleep(0.01)
    monkeypatch.setattr(worker_process, "WORKER_MODULE", "tests.helpers.broken_planner")
    assert isinstance(await asking, Plan)


async def test_a_worker_that_hangs_while_it_loads_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool_module, "LOAD_TIMEOUT_S", 0.1)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    # It lives, but never says that it has loaded anything.
    monkeypatch.setattr(worker_process, "WORKER_MODULE", "tests.helpers.echo_child")
    hanging = made_of(model.builtin())
    await hanging.start()
    answer = await hanging.ask(EASY)
    assert isinstance(answer, PlanningFailure)
    assert "0.1 s" in answer.message
    async with asyncio.timeout(20.0):
        while hanging.load_failure is None:
            await asyncio.sleep(0.01)
    await hanging.close()

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator

import psutil
import pytest

from planners.goals import JointGoal
from planners.pool import PlannerPool
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from robot import model

START = dict.fromkeys(["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"], 0.0)
EASY = PlanningProblem("arm", START, JointGoal({"shoulder_pan": 0.5}))
# A straight line through the arm itself, and more searches than fit into the allowed time.
NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
LONG = PlanningProblem(
    "arm",
    {**dict(zip(NAMES, (1.0899, -1.4202, 1.3815, 1.3879, -1.704), strict=True)), "gripper": 0.0},
    JointGoal(dict(zip(NAMES, (-1.1337, -1.2821, 1.4034, 1.2004, 1.2428), strict=True))),
    attempts=10_000,
)

# A worker that does not run at all stands for one that hangs in native code.
BRIEF = PlanningProblem("arm", START, JointGoal({"shoulder_pan": 0.5}), allowed_time_s=0.2)


@pytest.fixture
async def pool() -> AsyncIterator[PlannerPool]:
    made = PlannerPool(model.builtin())
    await made.start()
    yield made
    await made.close()


async def hanging_plan(pool: PlannerPool) -> asyncio.Task[Plan | PlanningFailure]:
    """A plan in the hands of a worker that does not go on."""
    assert isinstance(await pool.plan(EASY), Plan)
    for pid in pool.pids:
        os.kill(pid, signal.SIGSTOP)
    planning = asyncio.create_task(pool.plan(BRIEF))
    for _ in range(10):
        await asyncio.sleep(0)
    return planning


def resume(pool: PlannerPool) -> None:
    for pid in pool.pids:
        os.kill(pid, signal.SIGCONT)


async def test_a_problem_sent_while_workers_load_is_answered(pool: PlannerPool) -> None:
    assert not pool.ready
    assert isinstance(await pool.plan(EASY), Plan)
    assert pool.ready


async def test_problems_sent_together_are_all_answered(pool: PlannerPool) -> None:
    answers = await asyncio.gather(*(pool.plan(EASY) for _ in range(5)))
    assert all(isinstance(answer, Plan) for answer in answers)


async def test_one_worker_stands_by_beside_the_active_ones(pool: PlannerPool) -> None:
    assert len(pool.pids) == 2


async def test_a_worker_that_dies_answers_crash_and_is_replaced(pool: PlannerPool) -> None:
    planning = await hanging_plan(pool)
    before = set(pool.pids)
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    answer = await planning
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.CRASH
    assert isinstance(await pool.plan(EASY), Plan)
    assert not before & set(pool.pids)


async def test_a_worker_that_hangs_answers_timed_out_and_is_replaced(pool: PlannerPool) -> None:
    planning = await hanging_plan(pool)
    started_s = time.monotonic()
    answer = await planning
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.TIMED_OUT
    assert "0.2 s" in answer.message
    assert time.monotonic() - started_s < 5.0
    resume(pool)
    assert isinstance(await pool.plan(EASY), Plan)


async def test_cancelling_a_hanging_plan_frees_its_place(pool: PlannerPool) -> None:
    planning = await hanging_plan(pool)
    planning.cancel()
    with pytest.raises(asyncio.CancelledError):
        await planning
    resume(pool)
    assert isinstance(await asyncio.wait_for(pool.plan(EASY), 10.0), Plan)
    assert len(pool.pids) == 2


async def test_cancelling_ends_a_long_search_and_keeps_its_worker(pool: PlannerPool) -> None:
    assert isinstance(await pool.plan(EASY), Plan)
    pids = pool.pids
    for _ in range(3):
        planning = asyncio.create_task(pool.plan(LONG))
        await asyncio.sleep(0.1)
        assert not planning.done()
        planning.cancel()
        await asyncio.gather(planning, return_exceptions=True)
    assert isinstance(await pool.plan(EASY), Plan)
    assert pool.pids == pids


async def test_workers_that_died_while_idle_cost_no_goal(pool: PlannerPool) -> None:
    assert isinstance(await pool.plan(EASY), Plan)
    for pid in pool.pids:
        os.kill(pid, signal.SIGKILL)
    # Blocking on purpose: the pool must not have heard of their end yet.
    while any(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE for pid in pool.pids):
        time.sleep(0.01)  # noqa: ASYNC251
    assert isinstance(await pool.plan(EASY), Plan)


async def test_a_robot_that_no_worker_can_load_is_told() -> None:
    robot = model.builtin()
    broken = PlannerPool(
        model.RobotModel(robot.name, "<robot/>", robot.srdf, robot.links, robot.joints, robot.groups, {}, frozenset())
    )
    await broken.start()
    answer = await broken.plan(EASY)
    await broken.close()
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.FAILURE
    assert "planning is not available" in answer.message

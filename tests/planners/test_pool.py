"""Pools of planner processes in stepped time: turns, deadlines, races, and processes that end."""

import asyncio
import dataclasses
import math
import os
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
import pytest_asyncio

from harness.waiting import given_up, until
from planners import pool as pool_module
from planners.interface import LOAD_TIMEOUT_S, MAX_WAITING
from planners.messages import OBJECT_BYTES
from planners.pool import BRIEF_SCENE_BYTES, MAX_ALLOWED_TIME_S, MAX_FAILED_STARTS, PlannerPool, allowed_time_s
from planners.problem import Answer, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem, RecheckQuestion, Request
from planners.race import Race, another
from planners.scene import Scene
from planners.servo.question import JointVelocities, ServoQuestion
from tests.helpers.fake_workers import CRASHES, DEAF, HARD, IN_VAIN, PLAN, SEARCH_S, SOUND, TIMED_OUT, Farm
from tests.helpers.motions import EASY, REQUESTS, START, STATE, STILL
from tests.helpers.robots import so101
from tests.planners.scenes import boxes

pytestmark = pytest.mark.stepped_time


def searched(end: str, others: str = "", allowed_time_s: float = 60.0) -> PlanningProblem:
    """A problem: how its search ends, and how that of another racer."""
    return dataclasses.replace(EASY, group=f"{end}|{others}", allowed_time_s=allowed_time_s)


LONG = searched(IN_VAIN)


@pytest.fixture(autouse=True)
def cores(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Two cores, also on a machine with one; call it for another number."""

    def have(number: int) -> None:
        monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(number)))

    have(2)
    return have


@pytest_asyncio.fixture
async def loading(farm: Farm) -> AsyncIterator[PlannerPool]:
    """A pool whose first worker loads; the spare starts after it."""
    made = PlannerPool(so101())
    await made.start()
    yield made
    await made.close()


@pytest_asyncio.fixture
async def pool(loading: PlannerPool) -> PlannerPool:
    """A pool with one worker for motions and a spare, both idle."""
    await idle(loading, 2)
    return loading


async def idle(pool: PlannerPool, count: int) -> None:
    """Wait until that many workers are idle."""
    await until(lambda: pool.idle_count == count)


async def under_way(pool: PlannerPool, request: Request, idle_count: int = 1) -> asyncio.Task[Any]:
    """Ask, and wait until so many workers are left idle."""
    asking = asyncio.create_task(pool.ask(request))
    await idle(pool, idle_count)
    return asking


# Requests and their turns.


async def test_requests_while_workers_load_are_answered(loading: PlannerPool, farm: Farm) -> None:
    assert (loading.idle_count, loading.loaded_count) == (0, 0)
    asking = asyncio.gather(*(loading.ask(EASY) for _ in range(5)))
    await asyncio.sleep(0.4)
    assert len(farm.workers) == 1
    assert await asking == [PLAN] * 5
    assert len(farm.workers) == 2


async def test_questions_do_not_wait_for_a_search_that_cancelling_ends(pool: PlannerPool, farm: Farm) -> None:
    for _ in range(3):
        planning = await under_way(pool, LONG)
        assert await pool.ask(STATE) is SOUND
        await given_up(planning)
        await idle(pool, 2)
    assert len(farm.workers) == 2


async def test_a_worker_that_has_the_scene_is_taken_before_one_that_has_not_and_too_many_requests_are_refused(
    pool: PlannerPool, farm: Farm
) -> None:
    await pool.ask(EASY, Scene(1))
    assert [worker.has(Scene(1)) for worker in farm.workers] == [True, False]
    await pool.ask(EASY, Scene(1))
    assert not farm.workers[1].asked
    asking = [asyncio.create_task(pool.ask(LONG)) for _ in range(MAX_WAITING + 1)]
    await asyncio.sleep(0.001)
    answer = await pool.ask(EASY)
    assert answer.code is MoveItErrorCode.FAILURE
    assert f"limit {MAX_WAITING}" in answer.message
    await given_up(*asking)


async def test_the_spare_takes_over_before_a_cancelled_worker_listens(
    pool: PlannerPool, farm: Farm, monkeypatch: pytest.MonkeyPatch
) -> None:
    planning = await under_way(pool, searched(DEAF))
    (busy,) = (worker for worker in farm.workers if worker.asked)
    monkeypatch.setattr(busy, "cancel", lambda: asyncio.sleep(60.0))
    await given_up(planning)
    async with asyncio.timeout(1.0):
        assert await pool.ask(EASY) is PLAN


# Deadlines.

RECHECK = RecheckQuestion("arm", STILL, START, 0.0)
SERVO = ServoQuestion("arm", "gripper_frame_link", START, {}, 0.02, JointVelocities({}))
# It ends 0.5 s later than a worker may.
LATE = searched(IN_VAIN, allowed_time_s=1.0)


@pytest.fixture
def late(pool: PlannerPool, farm: Farm, monkeypatch: pytest.MonkeyPatch) -> Farm:
    """Workers that answer motions and questions half a second too late."""
    for name, time_s in (("OVERTIME_S", -0.5), ("STATE_TIME_S", 1.0), ("CHECK_TIME_S", 1.0)):
        monkeypatch.setattr(pool_module, name, time_s)
    farm.question_s = 1.0
    return farm


async def test_a_worker_that_is_late_is_given_up_and_kept_once_it_listens(pool: PlannerPool, late: Farm) -> None:
    words = "the planner did not answer within 1 s and was given up"
    for request in (LATE, STATE, RECHECK, SERVO):
        began_s = asyncio.get_running_loop().time()
        assert await pool.ask(request) == PlanningFailure(MoveItErrorCode.TIMED_OUT, words), request
        assert asyncio.get_running_loop().time() - began_s == pytest.approx(0.5)
        await idle(pool, 2)
    assert not any(worker.killed for worker in late.workers)
    # One that never listens is replaced.
    answer = await pool.ask(searched(DEAF, allowed_time_s=1.0))
    assert answer.code is MoveItErrorCode.TIMED_OUT
    await asyncio.sleep(0.01)
    assert [worker.killed > 0 for worker in late.workers[:2]] == [True, False]
    await idle(pool, 2)


async def test_a_state_is_answered_on_a_machine_too_busy_for_arms(pool: PlannerPool, farm: Farm) -> None:
    farm.question_s = 5.0
    assert await pool.ask(STATE) is SOUND
    assert isinstance(await pool.ask(RECHECK), PlanningFailure)


async def test_every_kind_of_request_has_an_allowed_time_that_does_not_hold_a_worker_for_ever() -> None:
    for allowed_s in (math.nan, math.inf, -1.0, 1e9):
        assert allowed_time_s(dataclasses.replace(EASY, allowed_time_s=allowed_s)) == MAX_ALLOWED_TIME_S
    assert allowed_time_s(dataclasses.replace(EASY, allowed_time_s=0.7)) == 0.7
    assert all(0.0 < allowed_time_s(request) <= 10.0 for request, _ in REQUESTS)


# Races: a worker that is idle searches as well.


async def test_a_hard_problem_is_searched_by_the_idle_worker_as_well(pool: PlannerPool, farm: Farm) -> None:
    assert isinstance(await pool.ask(searched(IN_VAIN, HARD)), Plan)
    assert isinstance(await pool.ask(searched(HARD, IN_VAIN)), Plan)
    await idle(pool, 2)
    # A second racer each time, and both workers are kept.
    assert [len(worker.asked) for worker in farm.workers] == [2, 2]
    # A racer that crashes leaves the race to the other.
    for ends in ((CRASHES, HARD), (HARD, CRASHES)):
        assert isinstance(await pool.ask(searched(*ends)), Plan)
        await idle(pool, 2)


LARGE = Scene(1, boxes(BRIEF_SCENE_BYTES // OBJECT_BYTES + 1))


@pytest.mark.parametrize(
    ("number_of_cores", "scene"), [(1, Scene(1)), (2, LARGE)], ids=["one core", "a large scene that no idle worker has"]
)
async def test_a_hard_problem_is_left_to_one_worker_where_a_race_helps_nobody(
    pool: PlannerPool, farm: Farm, cores: Callable[[int], None], number_of_cores: int, scene: Scene
) -> None:
    cores(number_of_cores)
    # A second worker would find a plan, but does not join.
    assert await pool.ask(searched(IN_VAIN, HARD, allowed_time_s=10.0 * SEARCH_S), scene) is TIMED_OUT
    assert sorted(len(worker.asked) for worker in farm.workers) == [0, 1]
    # It does where it has the scene, and a core.
    cores(2)
    for worker in farm.workers:
        await worker.ask(STATE, scene)
    assert isinstance(await pool.ask(searched(IN_VAIN, HARD), scene), Plan)


async def test_a_race_lends_a_worker_to_the_request_that_needs_one(pool: PlannerPool, farm: Farm) -> None:
    asking = await under_way(pool, searched(IN_VAIN, IN_VAIN), idle_count=0)
    assert await pool.ask(STATE) is SOUND
    assert not asking.done()
    await idle(pool, 0)
    await given_up(asking)
    assert len(farm.workers) == 2


# Processes that end, and those that never begin.


async def test_workers_that_died_while_idle_cost_no_goal(pool: PlannerPool, farm: Farm) -> None:
    for worker in farm.workers:
        worker.usable = False
    asking = asyncio.create_task(pool.ask(EASY))
    await asyncio.sleep(0)
    for worker in farm.workers[:2]:
        worker.end()
    assert await asking is PLAN


async def test_a_robot_that_no_worker_can_load_is_told(loading: PlannerPool, farm: Farm) -> None:
    farm.refusal = "no link"
    assert await loading.wait_until_loaded() == loading.load_failure == "no link"
    answer = await loading.ask(EASY)
    assert answer == PlanningFailure(MoveItErrorCode.FAILURE, "planning is not available: no link")
    # It is the robot's fault: no other process is tried.
    farm.workers[0].end()
    await asyncio.sleep(60.0)
    assert len(farm.workers) == 1


async def test_after_failed_starts_requests_wait_for_the_next_worker_that_loads(pool: PlannerPool, farm: Farm) -> None:
    farm.ends_at_start = True
    for worker in farm.workers[:2]:
        worker.end()
    asking = asyncio.create_task(pool.ask(EASY))
    await asyncio.sleep(0.5 * LOAD_TIMEOUT_S)
    assert len(farm.workers) > 2 + MAX_FAILED_STARTS
    assert pool.load_failure is None
    farm.ends_at_start = False
    assert await asking is PLAN


@pytest.mark.parametrize("never", ["ends_at_start", "starts_fail"])
async def test_workers_that_never_start_are_told_and_tried_again(loading: PlannerPool, farm: Farm, never: str) -> None:
    setattr(farm, never, True)
    farm.workers[0].end()
    answer = await loading.ask(EASY)
    assert answer.message.startswith("planning is not available: planner processes ")
    assert f"{MAX_FAILED_STARTS} times in a row" in answer.message
    assert loading.pids == ()
    setattr(farm, never, False)
    await until(lambda: loading.idle_count)
    assert loading.load_failure is None
    assert await loading.ask(EASY) is PLAN


async def test_where_no_worker_gets_ready_a_request_is_refused(loading: PlannerPool, farm: Farm) -> None:
    farm.loads = False
    farm.workers[0].end()
    waiting = asyncio.create_task(loading.wait_until_loaded())
    asking = asyncio.create_task(loading.ask(EASY))
    await asyncio.sleep(0.9 * LOAD_TIMEOUT_S)
    assert not farm.workers[1].killed
    assert (await asking).message == "planning is not available: no planner process was ready within 30 s"
    await asyncio.sleep(0.2 * LOAD_TIMEOUT_S)
    # A worker that hangs while it loads is ended.
    assert farm.workers[1].killed
    assert not waiting.done()
    await loading.close()
    assert await waiting is None


async def test_a_moving_arm_asks_the_worker_of_normal_priority(loading: PlannerPool, farm: Farm) -> None:
    for number in (1, 2):
        await until(lambda number=number: len(farm.workers) > number and farm.workers[-1].loaded)
        assert [worker.urgent for worker in farm.workers] == [False, True, True][: number + 1]
        await loading.ask(SERVO, Scene(number))
        await loading.ask(EASY, Scene(number))
        assert farm.workers[number].asked == [SERVO]
        assert EASY in farm.workers[0].asked
        farm.workers[number].end()


# Rules of a race for one plan.

# Time between the start of a race and the second racer [s].
JOINED_S = 0.5

FIRST, OTHER = Plan(STILL, "first", 1.0), Plan(STILL, "other", 1.0)
OTHER_WINS = dataclasses.replace(OTHER, planning_time_s=1.0 + JOINED_S)
NO_MOTION = PlanningFailure(MoveItErrorCode.TIMED_OUT, "no motion was found")
CRASH = PlanningFailure(MoveItErrorCode.CRASH, "the planner process ended")
REFUSAL = PlanningFailure(MoveItErrorCode.GOAL_IN_COLLISION, "these touch")


async def answered(after_s: float, answer: Answer | Exception) -> Answer:
    """Answer as a racer does that searches for a while."""
    await asyncio.sleep(after_s)
    if isinstance(answer, Exception):
        raise answer
    return answer


async def race_of(first: tuple[float, Answer], other: tuple[float, Answer | Exception]) -> Answer:
    """Run a race of two, each with its time [s] and its answer."""
    race = Race(EASY)
    asyncio.get_running_loop().call_later(0.0, lambda: race.join(lambda _: answered(*other), JOINED_S))
    return await race.run(answered(*first))


async def test_the_first_conclusive_answer_wins_else_the_first_racers_and_an_error_reaches_the_caller() -> None:
    for first, other, answer in (
        ((1.0, FIRST), (2.0, OTHER), FIRST),
        ((1.0, REFUSAL), (2.0, OTHER), REFUSAL),
        ((2.0, FIRST), (1.0, OTHER), OTHER_WINS),
        ((1.0, NO_MOTION), (2.0, OTHER), OTHER_WINS),
        ((1.0, NO_MOTION), (2.0, CRASH), NO_MOTION),
        ((2.0, NO_MOTION), (1.0, CRASH), NO_MOTION),
    ):
        assert await race_of(first, other) == answer, (first, other)
    with pytest.raises(OSError, match="a bug"):
        await race_of((2.0, FIRST), (1.0, OSError("a bug")))


async def test_nobody_joins_a_race_that_is_over_or_out_of_time_and_each_racer_has_its_own_seed() -> None:
    race, late = Race(EASY), list[PlanningProblem]()
    assert await race.run(answered(1.0, FIRST)) is FIRST
    race.join(late.append, 0.5)
    Race(EASY).join(late.append, EASY.allowed_time_s)
    await asyncio.sleep(1.0)
    assert late == []
    problem = dataclasses.replace(EASY, planner_id="BITstar", seed=(1 << 31) - 1)
    racers = [another(problem, number, 0.1) for number in (1, 2)]
    assert len({problem.seed, *(racer.seed for racer in racers)}) == 3
    for racer in racers:
        assert (racer.allowed_time_s, racer.planner_id) == (problem.allowed_time_s - 0.1, "BITstar")
        # OMPL takes seeds of 32 bits.
        assert racer.seed < 1 << 31

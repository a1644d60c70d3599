"""Races for one plan: who wins, who gives way, and what a pool has raced."""

from __future__ import annotations

import asyncio
import dataclasses
import os
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
import pytest_asyncio

from planners import pool as pool_module
from planners.pool import BRIEF_SCENE_BYTES, OBJECT_BYTES, PlannerPool
from planners.problem import Answer, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem, StateAnswer
from planners.race import Race, another
from planners.scene import Scene
from tests.helpers.broken_planner import NONE, PLAN, SEGFAULT, racers
from tests.helpers.motions import EASY, STATE, STILL
from tests.helpers.robots import so101
from tests.helpers.waiting import until
from tests.planners.test_pool import ROOT, boxes, made_of

pytestmark = pytest.mark.asyncio(loop_scope="module")

FIRST, OTHER = Plan(STILL, "first", 1.0), Plan(STILL, "other", 1.0)
TIMED_OUT = PlanningFailure(MoveItErrorCode.TIMED_OUT, "no motion was found")
CRASH = PlanningFailure(MoveItErrorCode.CRASH, "the planner process ended")
REFUSAL = PlanningFailure(MoveItErrorCode.GOAL_IN_COLLISION, "these touch")


class Racer:
    """A racer that answers when it is told to."""

    def __init__(self) -> None:
        self.problem: PlanningProblem | None = None
        self.cancelled = False
        self._answer: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()

    async def search(self, problem: PlanningProblem) -> Answer:
        self.problem = problem
        try:
            return await self._answer
        except asyncio.CancelledError:
            self.cancelled = True
            raise

    async def answers(self, answer: Answer | Exception) -> None:
        """Answer, and give the race its turns."""
        if isinstance(answer, Exception):
            self._answer.set_exception(answer)
        else:
            self._answer.set_result(answer)
        await turns()


async def turns() -> None:
    """Let the event loop run what is due."""
    for _ in range(10):
        await asyncio.sleep(0)


class Two:
    """A race of two."""

    def __init__(self) -> None:
        self.race = Race(EASY)
        self.first, self.other = Racer(), Racer()
        self.answer = asyncio.create_task(self.race.run(self.first.search(EASY)))


@pytest_asyncio.fixture(loop_scope="module")
async def two() -> AsyncIterator[Two]:
    """A race that is under way."""
    started = Two()
    await turns()
    started.race.join(started.other.search, 0.5)
    await turns()
    yield started
    started.answer.cancel()
    await asyncio.wait([started.answer])


@pytest.mark.parametrize("answer", [FIRST, REFUSAL], ids=["a plan", "a refusal"])
async def test_what_no_other_racer_would_change_is_the_answer_at_once(two: Two, answer: Answer) -> None:
    await two.first.answers(answer)
    assert two.answer.result() is answer
    assert two.other.cancelled


async def test_a_plan_of_another_racer_is_the_answer_and_the_first_is_cancelled(two: Two) -> None:
    await two.other.answers(OTHER)
    answer = two.answer.result()
    assert isinstance(answer, Plan)
    assert answer.method == "other"
    assert two.first.cancelled


@pytest.mark.parametrize("failure", [TIMED_OUT, CRASH], ids=lambda failure: failure.code.name)
async def test_a_failure_is_no_answer_while_another_racer_searches(two: Two, failure: Answer) -> None:
    await two.first.answers(failure)
    assert not two.answer.done()
    await two.other.answers(OTHER)
    assert isinstance(two.answer.result(), Plan)


async def test_when_all_fail_the_answer_is_that_of_the_first(two: Two) -> None:
    await two.first.answers(TIMED_OUT)
    await two.other.answers(CRASH)
    assert two.answer.result() is TIMED_OUT


async def test_an_error_of_a_racer_reaches_the_caller(two: Two) -> None:
    await two.other.answers(OSError("a bug"))
    with pytest.raises(OSError, match="a bug"):
        two.answer.result()


async def test_cancelling_a_race_cancels_every_racer(two: Two) -> None:
    two.answer.cancel()
    await turns()
    assert two.first.cancelled
    assert two.other.cancelled


async def test_all_but_the_first_give_way(two: Two) -> None:
    assert two.race.give_way()
    await turns()
    assert two.other.cancelled
    await two.first.answers(FIRST)
    assert two.answer.result() is FIRST


async def test_a_race_of_one_has_nobody_to_give_way(two: Two) -> None:
    two.race.give_way()
    await turns()
    assert not two.race.give_way()


async def test_a_racer_that_gave_way_leaves_the_first_one_s_failure_as_the_answer(two: Two) -> None:
    two.race.give_way()
    await two.first.answers(TIMED_OUT)
    assert two.answer.result() is TIMED_OUT


async def test_nobody_joins_a_race_that_is_over(two: Two) -> None:
    await two.first.answers(FIRST)
    late = Racer()
    two.race.join(late.search, 1.0)
    await turns()
    assert late.problem is None


@pytest.mark.parametrize("over_s", [0.0, 0.001])
async def test_nobody_joins_a_race_when_the_time_is_over(two: Two, over_s: float) -> None:
    late = Racer()
    two.race.join(late.search, EASY.allowed_time_s + over_s)
    await turns()
    assert late.problem is None


async def test_the_time_before_a_racer_joined_counts_as_planning_time(two: Two) -> None:
    await two.other.answers(OTHER)
    answer = two.answer.result()
    assert isinstance(answer, Plan)
    assert answer.planning_time_s == OTHER.planning_time_s + 0.5


async def test_each_racer_has_a_seed_of_its_own(two: Two) -> None:
    third = Racer()
    two.race.join(third.search, 0.5)
    await turns()
    assert two.other.problem is not None
    assert third.problem is not None
    assert len({EASY.seed, two.other.problem.seed, third.problem.seed}) == 3


async def test_a_racer_has_the_time_that_is_left() -> None:
    assert another(EASY, 1, 0.1).allowed_time_s == EASY.allowed_time_s - 0.1


async def test_a_planner_that_is_named_is_that_of_all_racers() -> None:
    assert another(dataclasses.replace(EASY, planner_id="BITstar"), 1, 0.1).planner_id == "BITstar"


async def test_the_seed_of_a_racer_is_one_that_planners_take() -> None:
    assert another(dataclasses.replace(EASY, seed=(1 << 31) - 1), 1, 0.1).seed < 1 << 31


# Real workers: two, of which one is spare.


@pytest.fixture(autouse=True)
def cores(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Two cores, also on a machine with one; call it for another number."""

    def have(number: int) -> None:
        monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(number)))

    have(2)
    return have


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pool() -> AsyncIterator[PlannerPool]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setattr(pool_module, "WORKER_MODULE", "tests.helpers.broken_planner")
        made = made_of(so101())
        await made.start()
        yield made
        await made.close()


@pytest_asyncio.fixture(loop_scope="module")
async def both_idle(pool: PlannerPool) -> PlannerPool:
    await until(lambda: pool.idle_count == 2, 60.0)
    return pool


def hard(first: str, others: str, allowed_time_s: float = 120.0) -> PlanningProblem:
    """A problem that proves hard: how the first racer's search ends, and how that of the others."""
    return dataclasses.replace(EASY, group=racers(first, others), allowed_time_s=allowed_time_s)


# Long enough for a race to begin and be won, if there is one.
BRIEFLY_S = 1.0


async def given_up(asking: asyncio.Task[Any]) -> None:
    asking.cancel()
    await asyncio.wait([asking])


async def test_a_hard_problem_is_searched_by_the_idle_worker_as_well(both_idle: PlannerPool) -> None:
    assert isinstance(await both_idle.ask(hard(NONE, PLAN)), Plan)


async def test_the_workers_of_a_race_are_kept(both_idle: PlannerPool) -> None:
    before = set(both_idle.pids)
    assert isinstance(await both_idle.ask(hard(PLAN, NONE)), Plan)
    assert isinstance(await both_idle.ask(hard(NONE, PLAN)), Plan)
    await until(lambda: both_idle.idle_count == 2)
    assert set(both_idle.pids) == before


async def test_time_asked_for_to_shorten_a_motion_makes_no_problem_hard(both_idle: PlannerPool) -> None:
    problem = dataclasses.replace(hard(NONE, PLAN, BRIEFLY_S), optimization_time_s=60.0)
    assert await both_idle.ask(problem) == TIMED_OUT


async def test_on_one_core_nothing_is_raced(both_idle: PlannerPool, cores: Callable[[int], None]) -> None:
    cores(1)
    assert await both_idle.ask(hard(NONE, PLAN, BRIEFLY_S)) == TIMED_OUT


async def test_a_pool_that_does_not_race_leaves_a_hard_problem_to_one_worker(
    both_idle: PlannerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(both_idle, "_racing", False)
    assert await both_idle.ask(hard(NONE, PLAN, BRIEFLY_S)) == TIMED_OUT


async def test_a_motion_in_the_background_is_not_raced(both_idle: PlannerPool) -> None:
    assert await both_idle.ask_in_background(hard(NONE, PLAN, BRIEFLY_S)) == TIMED_OUT


@pytest.mark.parametrize(("first", "others"), [(SEGFAULT, PLAN), (PLAN, SEGFAULT)], ids=["the first", "the other"])
async def test_a_racer_that_crashes_leaves_the_race_to_the_other(
    both_idle: PlannerPool, first: str, others: str
) -> None:
    assert isinstance(await both_idle.ask(hard(first, others)), Plan)


async def test_when_all_workers_of_a_race_crash_there_is_one_answer(both_idle: PlannerPool) -> None:
    answer = await both_idle.ask(hard(SEGFAULT, SEGFAULT))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.CRASH


async def test_cancelling_frees_all_workers_of_a_race(both_idle: PlannerPool) -> None:
    before = set(both_idle.pids)
    asking = asyncio.create_task(both_idle.ask(hard(NONE, NONE)))
    await until(lambda: both_idle.idle_count == 0)
    await given_up(asking)
    await until(lambda: both_idle.idle_count == 2)
    assert set(both_idle.pids) == before


async def test_a_race_gives_a_worker_to_the_request_that_needs_one(both_idle: PlannerPool) -> None:
    before = set(both_idle.pids)
    asking = asyncio.create_task(both_idle.ask(hard(NONE, NONE)))
    await until(lambda: both_idle.idle_count == 0)
    assert isinstance(await both_idle.ask(STATE), StateAnswer)
    assert not asking.done()
    await given_up(asking)
    assert set(both_idle.pids) == before


async def test_a_worker_joins_a_race_again_once_nothing_else_needs_it(both_idle: PlannerPool) -> None:
    asking = asyncio.create_task(both_idle.ask(hard(NONE, NONE)))
    await until(lambda: both_idle.idle_count == 0)
    assert isinstance(await both_idle.ask(STATE), StateAnswer)
    await until(lambda: both_idle.idle_count == 0)
    await given_up(asking)


LARGE = boxes(BRIEF_SCENE_BYTES // OBJECT_BYTES + 1)


async def test_no_worker_sets_up_a_large_scene_for_a_race(both_idle: PlannerPool) -> None:
    assert await both_idle.ask(hard(NONE, PLAN, BRIEFLY_S), Scene(1, LARGE)) == TIMED_OUT


async def test_a_worker_that_has_a_large_scene_joins_a_race_in_it(both_idle: PlannerPool) -> None:
    scene = Scene(2, LARGE)
    for worker in both_idle._idle:
        await worker.ask(STATE, scene)
    assert isinstance(await both_idle.ask(hard(NONE, PLAN), scene), Plan)

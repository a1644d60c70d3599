"""Races for one plan: who wins, and who gives way. The races of a pool are in test_pool.py."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from planners.problem import Answer, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.race import Race, another
from tests.helpers.motions import EASY, STILL

pytestmark = pytest.mark.stepped_time

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


@pytest_asyncio.fixture
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
    assert not two.race.give_way()
    await two.first.answers(FIRST)
    assert two.answer.result() is FIRST


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


async def test_nobody_joins_a_race_when_the_time_is_over(two: Two) -> None:
    late = Racer()
    two.race.join(late.search, EASY.allowed_time_s)
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


async def test_a_racer_has_the_time_that_is_left_the_same_planner_and_a_seed_that_planners_take() -> None:
    problem = dataclasses.replace(EASY, planner_id="BITstar", seed=(1 << 31) - 1)
    racer = another(problem, 1, 0.1)
    assert (racer.allowed_time_s, racer.planner_id) == (problem.allowed_time_s - 0.1, "BITstar")
    assert racer.seed < 1 << 31

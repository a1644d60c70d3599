"""Rules of a race for one plan. The races of a pool are in test_pool.py."""

import asyncio
import dataclasses

import pytest

from planners.problem import Answer, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.race import Race, another
from tests.helpers.motions import EASY, STILL

pytestmark = pytest.mark.stepped_time

FIRST, OTHER = Plan(STILL, "first", 1.0), Plan(STILL, "other", 1.0)
TIMED_OUT = PlanningFailure(MoveItErrorCode.TIMED_OUT, "no motion was found")
CRASH = PlanningFailure(MoveItErrorCode.CRASH, "the planner process ended")
REFUSAL = PlanningFailure(MoveItErrorCode.GOAL_IN_COLLISION, "these touch")

# Time between the start of a race and the second racer [s].
JOINED_S = 0.5


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


@pytest.mark.parametrize(
    ("first", "other", "answer"),
    [
        ((1.0, FIRST), (2.0, OTHER), FIRST),
        ((1.0, REFUSAL), (2.0, OTHER), REFUSAL),
        ((2.0, FIRST), (1.0, OTHER), dataclasses.replace(OTHER, planning_time_s=1.0 + JOINED_S)),
        ((1.0, TIMED_OUT), (2.0, OTHER), dataclasses.replace(OTHER, planning_time_s=1.0 + JOINED_S)),
        ((1.0, TIMED_OUT), (2.0, CRASH), TIMED_OUT),
        ((2.0, TIMED_OUT), (1.0, CRASH), TIMED_OUT),
    ],
)
async def test_the_first_conclusive_answer_wins_else_the_first_racers(first, other, answer) -> None:
    assert await race_of(first, other) == answer


async def test_an_error_of_a_racer_reaches_the_caller() -> None:
    with pytest.raises(OSError, match="a bug"):
        await race_of((2.0, FIRST), (1.0, OSError("a bug")))


async def test_nobody_joins_a_race_that_is_over_or_out_of_time() -> None:
    race, late = Race(EASY), list[PlanningProblem]()
    assert await race.run(answered(1.0, FIRST)) is FIRST
    race.join(late.append, 0.5)
    Race(EASY).join(late.append, EASY.allowed_time_s)
    assert late == []


async def test_each_racer_has_its_seed_the_time_that_is_left_and_the_same_planner() -> None:
    problem = dataclasses.replace(EASY, planner_id="BITstar", seed=(1 << 31) - 1)
    racers = [another(problem, number, 0.1) for number in (1, 2)]
    assert len({problem.seed, *(racer.seed for racer in racers)}) == 3
    for racer in racers:
        assert (racer.allowed_time_s, racer.planner_id) == (problem.allowed_time_s - 0.1, "BITstar")
        # OMPL takes seeds of 32 bits.
        assert racer.seed < 1 << 31

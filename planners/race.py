"""Race for one plan: a problem that takes one worker long is given to idle ones as well, with other seeds.

The first certified plan wins, and the other racers are cancelled. A refusal that does not depend on the seed wins too.
All racers search by the same planner: races of RRT-Connect with itself took 0.69 times as long as one search, with
LBKPIECE1 0.70 times. KPIECE1 is better in a narrow gap (0.41 against 0.57), but of no use in most scenes (0.99, 0.72).
"""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Coroutine
from typing import Any, TypeAlias

from planners.problem import Answer, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem

# Seed stride between racers: a search counts up from the problem's seed with each tree that it gives up.
SEED_STEP = 1 << 20

SEEDS = 1 << 31  # OMPL takes seeds of 32 bits

# Failures that another racer need not have. All others are of the problem itself.
INCONCLUSIVE = (MoveItErrorCode.TIMED_OUT, MoveItErrorCode.CRASH, MoveItErrorCode.PREEMPTED)

Search: TypeAlias = Callable[[PlanningProblem], Coroutine[Any, Any, Answer]]  # has a racer search


class Race:
    """Racers for one problem, and the one answer that it gets."""

    def __init__(self, problem: PlanningProblem) -> None:
        self._problem = problem
        # The first comes first.
        self._racers: list[asyncio.Task[Answer]] = []
        self._winner: asyncio.Future[asyncio.Task[Answer]] = asyncio.get_running_loop().create_future()

    async def run(self, first: Coroutine[Any, Any, Answer]) -> Answer:
        """Run the race until it is decided; the first racer's answer counts where no racer finds a plan."""
        try:
            self._add(first)
            return (await self._winner).result()
        finally:
            for racer in self._racers:
                racer.cancel()

    def join(self, search: Search, spent_s: float) -> None:
        """Add a racer, with its own seed and the time that the first racer has left; none once race or time is over."""
        # A search without time would be refused, and the refusal would win.
        if not self._winner.done() and spent_s < self._problem.allowed_time_s:
            self._add(_search(search, another(self._problem, len(self._racers), spent_s), spent_s))

    def give_way(self) -> bool:
        """Cancel all racers but the first; return False if none runs."""
        running = [racer for racer in self._racers[1:] if not racer.done()]
        for racer in running:
            racer.cancel()
        return bool(running)

    def _add(self, racer: Coroutine[Any, Any, Answer]) -> None:
        task = asyncio.create_task(racer, name="racer")
        self._racers.append(task)
        task.add_done_callback(self._finished)

    def _finished(self, racer: asyncio.Task[Answer]) -> None:
        if self._winner.done():
            return
        if _conclusive(racer):
            self._winner.set_result(racer)
        elif all(each.done() for each in self._racers):
            self._winner.set_result(self._racers[0])


def another(problem: PlanningProblem, number: int, spent_s: float) -> PlanningProblem:
    """Return the problem of the racer of a number, from 1; same problem and number, same seed."""
    return dataclasses.replace(
        problem, seed=(problem.seed + number * SEED_STEP) % SEEDS, allowed_time_s=problem.allowed_time_s - spent_s
    )


async def _search(search: Search, problem: PlanningProblem, begun_after_s: float) -> Answer:
    """Search; the time before the racer joined counts as planning time of its plan as well."""
    answer = await search(problem)
    if isinstance(answer, Plan):
        return dataclasses.replace(answer, planning_time_s=answer.planning_time_s + begun_after_s)
    return answer


def _conclusive(racer: asyncio.Task[Answer]) -> bool:
    """Return true if a racer that is done decides the race; an exception does: a bug for the caller to see."""
    if racer.cancelled():
        return False
    if racer.exception() is not None:
        return True
    answer = racer.result()
    return not (isinstance(answer, PlanningFailure) and answer.code in INCONCLUSIVE)

"""Executor of goals whose ends a test chooses."""

import asyncio
from collections.abc import Callable, Iterable
from typing import Any, Self

from planners.problem import MoveItErrorCode
from server.execution.goal import Answer, Goal, Progress, TimeLimits

THERE = Answer(MoveItErrorCode.SUCCESS, "the arm is there")


class GoalRunner:
    """Executes one goal at a time, until a test or a cancel ends it.

    Attributes:
        asked: motions of the goals, oldest first.
        stopped: joints of each stop of all motion; None for all.
        report: tells of the progress of the active goal.
    """

    def __init__(self) -> None:
        self.asked: list[Any] = []
        self.stopped: list[Any] = []
        self.report: Callable[[Progress], None] = lambda _progress: None
        self._end: asyncio.Future[Answer] | None = None

    # Called by the queue.

    time_limits = TimeLimits()

    def last_stop(self, _joints: frozenset[str]) -> int:
        return 0

    def executor(self, _joints: frozenset[str]) -> Self:
        return self

    async def run(self, goal: Goal) -> Answer:
        self.asked.append(goal.request.motion)
        self.report = goal.report
        self._end = asyncio.get_running_loop().create_future()
        goal.cancelled.add_done_callback(lambda _reason: (self.preempt if goal.replaced else self.cancel)(goal.reason))
        return await self._end

    def cancel(self, reason: str) -> None:
        self.finish(Answer(MoveItErrorCode.PREEMPTED, reason))

    def preempt(self, reason: str) -> None:
        self.cancel(reason)

    def stop(self, joints: Iterable[str] | None = None) -> None:
        self.stopped.append(joints)

    def brake(self) -> None:
        self.stop()

    # Called by a test.

    def finish(self, answer: Answer = THERE) -> None:
        if self._end is not None and not self._end.done():
            self._end.set_result(answer)

"""Runner of goals whose ends a test chooses."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Any, Self

from planners.problem import MoveItErrorCode
from server.execution.queue import Answer, Progress

THERE = Answer(MoveItErrorCode.SUCCESS, "the arm is there")


class GoalRunner:
    """Runs one goal at a time, until a test or a cancel ends it.

    Attributes:
        asked: the goals, oldest first.
        stopped: reasons of stops of all motion.
        ahead: goals to plan in advance, with the time left of the motion before [s].
        forgotten: goals whose turn will not come.
        report: tells of the progress of the active goal.
    """

    def __init__(self, *joints: str) -> None:
        self._joints = frozenset(joints)
        self.asked: list[Any] = []
        self.stopped: list[str] = []
        self.ahead: list[tuple[object, float]] = []
        self.forgotten: list[object] = []
        self.report: Callable[[Progress], None] = lambda _progress: None
        self._end: asyncio.Future[Answer] | None = None

    # What the queue calls.

    def last_stop(self, _joints: frozenset[str]) -> int:
        return 0

    def joints_of(self, _request: object) -> frozenset[str]:
        return self._joints

    def runner(self, _joints: frozenset[str]) -> Self:
        return self

    async def run(self, request: Any, report: Callable[[Progress], None], epoch: int) -> Answer:
        self.asked.append(request)
        self.report = report
        self._end = asyncio.get_running_loop().create_future()
        return await self._end

    def cancel(self, reason: str) -> None:
        self.finish(Answer(MoveItErrorCode.PREEMPTED, reason))

    def preempt(self, reason: str) -> None:
        self.cancel(reason)

    def plan_ahead(self, request: object, left_s: float) -> None:
        self.ahead.append((request, left_s))

    def forget(self, request: object) -> None:
        self.forgotten.append(request)

    def stop(self, reason: str, _joints: Iterable[str] | None = None) -> None:
        self.stopped.append(reason)
        self.cancel(reason)

    # What a test calls.

    def finish(self, answer: Answer = THERE) -> None:
        if self._end is not None and not self._end.done():
            self._end.set_result(answer)

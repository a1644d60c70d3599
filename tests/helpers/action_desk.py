"""Actions that move the arm, on a graph of their own: their goals go to a runner that does what a test says."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from planners.problem import MoveItErrorCode
from server.goal_queue import Answer, GoalPolicy, GoalQueue, Progress, QueuedGoal
from server.graph.actions import Goal, Result
from server.moveit.motions import Motion
from tests.helpers.moveit_services import ServiceRig
from tests.helpers.played_arm import PlayedArm, settle

THERE = Answer(MoveItErrorCode.SUCCESS, "the arm is there")


class ActionDesk(ServiceRig):
    """A queue, its runner, and a client that sends goals."""

    def __init__(self) -> None:
        super().__init__()
        self.played_arm = PlayedArm()
        self.asked: list[Motion] = []
        self.refused: list[str] = []
        self.report: Callable[[Progress], None] = lambda _progress: None
        self._end: asyncio.Future[Answer] | None = None
        self.queue: GoalQueue[Motion] = GoalQueue(self, GoalPolicy.QUEUE, 4, lambda _goal, _news: None, self._answered)
        self.queue.start()
        self.feedback: list[dict[str, Any]] = []
        self.results: list[Result] = []

    async def run(self, request: Motion, report: Callable[[Progress], None]) -> Answer:
        self.asked.append(request)
        self.report = report
        self._end = asyncio.get_running_loop().create_future()
        return await self._end

    def end(self, reason: str) -> None:
        self.finish(Answer(MoveItErrorCode.PREEMPTED, reason))

    def give_way(self, reason: str) -> None:
        self.end(reason)

    def stop(self, reason: str) -> None:
        self.end(reason)

    def finish(self, answer: Answer = THERE) -> None:
        if self._end is not None and not self._end.done():
            self._end.set_result(answer)

    def _answered(self, goal: QueuedGoal[Motion], answer: Answer) -> None:
        if goal.request is None:
            self.refused.append(answer.message)

    async def send(self, action: str, **goal: Any) -> Goal | None:
        """Send a goal, and let everything that it sets going come to rest."""
        type_name = self.graph.actions.type_of(action)
        assert type_name is not None
        sent = self.graph.actions.send_goal(
            self.client, action, type_name, goal, self.results.append, self.feedback.append
        )
        await settle()
        return sent

    async def close(self) -> None:
        await self.queue.close(0.1)

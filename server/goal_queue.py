"""Goals wait here for the arm: one runs at a time, and each gets exactly one answer."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, Protocol, TypeVar

from planners.problem import MoveItErrorCode, PlanningFailure

log = logging.getLogger("armbridge.goals")

Request = TypeVar("Request")
Request_contra = TypeVar("Request_contra", contravariant=True)


class GoalPolicy(StrEnum):
    """What happens to a goal that comes while another one is worked on."""

    QUEUE = "queue"
    REJECT = "reject"
    PREEMPT = "preempt"


class GoalState(StrEnum):
    """Where a goal is on its way."""

    QUEUED = "queued"
    PLANNING = "planning"
    EXECUTING = "executing"
    DONE = "done"


@dataclass(frozen=True)
class Progress:
    """News of a goal: ``fraction`` of the motion that is done, and the time left to its end [s]."""

    state: GoalState
    message: str
    fraction: float = 0.0
    remaining_s: float = 0.0


@dataclass(frozen=True)
class Answer:
    """The one final answer to a goal."""

    code: MoveItErrorCode
    message: str

    @classmethod
    def of(cls, failure: PlanningFailure) -> Answer:
        """The answer that tells a planning failure."""
        return cls(failure.code, failure.message)


@dataclass(frozen=True)
class QueuedGoal(Generic[Request]):
    """A goal: ``source`` is the topic it came by, ``goal_id`` is unique in the life of the server.

    ``request`` is None when the goal was refused before it could be asked for.
    """

    goal_id: str
    source: str
    request: Request | None


class GoalRunner(Protocol[Request_contra]):
    """Works on one goal."""

    async def run(self, request: Request_contra, report: Callable[[Progress], None]) -> Answer:
        """Carry the goal out; ends with an answer, also after :meth:`stop`."""

    def stop(self, reason: str) -> None:
        """End the goal in hand: no more planning, and the arm braked along its path."""


class GoalQueue(Generic[Request]):
    """A bounded queue before one runner.

    Args:
        runner: does the work.
        policy: what happens to a goal that comes while another one is worked on.
        capacity: how many goals may wait.
        on_progress: called with the news of a goal.
        on_answer: called once a goal.
    """

    def __init__(
        self,
        runner: GoalRunner[Request],
        policy: GoalPolicy,
        capacity: int,
        on_progress: Callable[[QueuedGoal[Request], Progress], None],
        on_answer: Callable[[QueuedGoal[Request], Answer], None],
    ) -> None:
        self._runner = runner
        self._policy = policy
        self._capacity = capacity
        self._on_progress = on_progress
        self._on_answer = on_answer
        self._waiting: deque[QueuedGoal[Request]] = deque()
        self._active: QueuedGoal[Request] | None = None
        self._arrived = asyncio.Event()
        self._idle = asyncio.Event()
        self._idle.set()
        self._ids = itertools.count(1)
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin to work on goals."""
        self._task = asyncio.create_task(self._work(), name="goal queue")

    async def close(self, timeout_s: float) -> None:
        """Stop the goal in hand, answer every goal and end, at the latest after ``timeout_s``."""
        self.stop("the server is shutting down")
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._idle.wait(), timeout_s)
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

    def submit(self, source: str, request: Request) -> str:
        """Take a goal in under the policy; returns its id."""
        goal = QueuedGoal(self._next_id(), source, request)
        if self._policy is GoalPolicy.REJECT and self._active is not None:
            self._finish(goal, Answer(MoveItErrorCode.FAILURE, f"goal {self._active.goal_id} is still being worked on"))
        elif self._policy is GoalPolicy.PREEMPT:
            self.stop(f"goal {goal.goal_id} took over")
            self._enqueue(goal)
        elif len(self._waiting) >= self._capacity:
            self._finish(
                goal,
                Answer(MoveItErrorCode.FAILURE, f"{self._capacity} goals are waiting already, the limit"),
            )
        else:
            self._enqueue(goal)
        return goal.goal_id

    def refuse(self, source: str, failure: PlanningFailure) -> str:
        """Answer a goal that cannot be asked for, at once and past the queue; returns its id."""
        goal: QueuedGoal[Request] = QueuedGoal(self._next_id(), source, None)
        self._finish(goal, Answer.of(failure))
        return goal.goal_id

    def stop(self, reason: str) -> None:
        """End the goal in hand and all that wait; each is answered PREEMPTED."""
        waiting = list(self._waiting)
        self._waiting.clear()
        for goal in waiting:
            self._finish(goal, Answer(MoveItErrorCode.PREEMPTED, f"{reason} before this goal's turn came"))
        self._runner.stop(reason)

    def _next_id(self) -> str:
        return str(next(self._ids))

    def _enqueue(self, goal: QueuedGoal[Request]) -> None:
        ahead = len(self._waiting) + (self._active is not None)
        self._waiting.append(goal)
        self._on_progress(goal, Progress(GoalState.QUEUED, f"{ahead} goals ahead" if ahead else "next"))
        self._arrived.set()

    async def _work(self) -> None:
        while True:
            while not self._waiting:
                self._arrived.clear()
                await self._arrived.wait()
            goal = self._waiting.popleft()
            self._active = goal
            self._idle.clear()
            answer = await self._run(goal)
            self._active = None
            self._finish(goal, answer)
            self._idle.set()

    async def _run(self, goal: QueuedGoal[Request]) -> Answer:
        if goal.request is None:
            raise AssertionError("a refused goal was queued")
        try:
            return await self._runner.run(goal.request, lambda progress: self._on_progress(goal, progress))
        except Exception as error:  # a bug must cost this goal only, and never its answer
            log.exception("goal %s from %s failed", goal.goal_id, goal.source)
            return Answer(MoveItErrorCode.FAILURE, f"internal error: {type(error).__name__}: {error}")

    def _finish(self, goal: QueuedGoal[Request], answer: Answer) -> None:
        self._on_answer(goal, answer)

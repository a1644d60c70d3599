"""Goals wait here for the arm: one runs at a time, and each gets exactly one answer."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.trajectory import Trajectory
from server.graph.node import Node

log = logging.getLogger("armbridge.goals")

Request = TypeVar("Request")
Request_contra = TypeVar("Request_contra", contravariant=True)

_NOTHING: Mapping[str, Any] = MappingProxyType({})


class GoalPolicy(StrEnum):
    """What happens to a goal that comes while another one is worked on."""

    QUEUE = "queue"
    REJECT = "reject"
    PREEMPT = "preempt"


class GoalState(StrEnum):
    """Where a goal is on its way."""

    QUEUED = "queued"
    PLANNING = "planning"
    PLANNED = "planned"
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
class Performed:
    """What was planned and done for a goal.

    Attributes:
        start_rad: position of every movable joint when the first motion was to begin [rad].
        planned: the motions, one after the other.
        executed: where the arm was on the way, by its readings; None when it did not move.
        planning_time_s: time spent on planning [s].
    """

    start_rad: Mapping[str, float]
    planned: tuple[Trajectory, ...] = ()
    executed: Trajectory | None = None
    planning_time_s: float = 0.0


@dataclass(frozen=True)
class Answer:
    """The one final answer to a goal.

    Attributes:
        code: how it ended.
        message: one sentence.
        details: what was found, as in `PlanningFailure`.
        performed: what was done for it; None when it did not come to that.
    """

    code: MoveItErrorCode
    message: str
    details: Mapping[str, Any] = field(default_factory=dict)
    performed: Performed | None = None

    @classmethod
    def of(cls, failure: PlanningFailure, performed: Performed | None = None) -> Answer:
        """The answer that tells a planning failure."""
        return cls(failure.code, failure.message, failure.details, performed)


@dataclass(frozen=True)
class QueuedGoal(Generic[Request]):
    """A goal.

    Attributes:
        goal_id: unique in the life of the server.
        source: the topic or action it came by.
        request: what is asked for; None when the goal was refused before it could be asked for.
        on_progress: called with its news.
        on_answer: called once.
        asked: the message it came as; empty when there is none that can be read.
        only_for: who alone is told of it; None for everybody.
    """

    goal_id: str
    source: str
    request: Request | None
    on_progress: Callable[[Progress], None] = lambda _progress: None
    on_answer: Callable[[Answer], None] = lambda _answer: None
    asked: Mapping[str, Any] = field(default_factory=dict)
    only_for: Node | None = None


class GoalRunner(Protocol[Request_contra]):
    """Works on one goal."""

    async def run(self, request: Request_contra, report: Callable[[Progress], None]) -> Answer:
        """Carry the goal out; ends with an answer, also after :meth:`end` and :meth:`stop`."""

    def end(self, reason: str) -> None:
        """End the goal in hand: no more planning, and its motion braked along its path."""

    def give_way(self, reason: str) -> None:
        """End the goal in hand for another that follows at once; its motion may go over into the other's."""

    def stop(self, reason: str) -> None:
        """End the goal in hand and every motion of the arm, whoever began it."""


class GoalQueue(Generic[Request]):
    """A bounded queue before one runner.

    Args:
        runner: does the work.
        policy: what happens to a goal that comes while another one is worked on, unless it comes with its own policy.
        capacity: how many goals may wait.
        on_progress: called with the news of every goal.
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
        try:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._idle.wait(), timeout_s)
        finally:
            self._abandon()
        if self._task is not None:
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

    def _abandon(self) -> None:
        """Work no more; a goal that is still in hand is answered all the same."""
        if self._task is not None:
            self._task.cancel()
        goal, self._active = self._active, None
        if goal is not None:
            reason = "the server is shutting down, and the arm did not come to rest in time"
            self._finish(goal, Answer(MoveItErrorCode.PREEMPTED, reason))

    @property
    def busy(self) -> str:
        """Which goal is worked on, in words; empty when there is none."""
        return (
            f"goal {self._active.goal_id} from {self._active.source} is worked on" if self._active is not None else ""
        )

    @property
    def waiting_count(self) -> int:
        """How many goals wait for their turn."""
        return len(self._waiting)

    def submit(
        self,
        source: str,
        request: Request,
        *,
        policy: GoalPolicy | None = None,
        on_progress: Callable[[Progress], None] = lambda _progress: None,
        on_answer: Callable[[Answer], None] = lambda _answer: None,
        asked: Mapping[str, Any] = _NOTHING,
    ) -> str:
        """Take a goal in; returns its id.

        Args:
            source: the topic or action it came by.
            request: what is asked for.
            policy: what happens to it while another goal is worked on; None for the queue's own policy.
            on_progress: called with its news, besides who hears of all goals.
            on_answer: called once, likewise, perhaps before this returns.
            asked: the message it came as.
        """
        goal = QueuedGoal(self._next_id(), source, request, on_progress, on_answer, asked)
        policy = policy or self._policy
        if policy is GoalPolicy.REJECT and self._active is not None:
            self._finish(goal, Answer(MoveItErrorCode.FAILURE, f"goal {self._active.goal_id} is still being worked on"))
        elif policy is GoalPolicy.PREEMPT:
            reason = f"preempted by goal {goal.goal_id} from {source}"
            self._clear(reason)
            if self._active is not None:
                self._runner.give_way(reason)
            self._enqueue(goal)
        elif len(self._waiting) >= self._capacity:
            limit = f"{self._capacity} goals are waiting already, the limit"
            self._finish(goal, Answer(MoveItErrorCode.FAILURE, limit))
        else:
            self._enqueue(goal)
        return goal.goal_id

    def refuse(
        self,
        source: str,
        failure: PlanningFailure,
        asked: Mapping[str, Any] = _NOTHING,
        only_for: Node | None = None,
    ) -> str:
        """Answer a goal that cannot be asked for, at once and past the queue; returns its id.

        Args:
            source: the topic or action it came by.
            failure: why it cannot.
            asked: the message it came as.
            only_for: who alone is told; None for everybody.
        """
        goal: QueuedGoal[Request] = QueuedGoal(self._next_id(), source, None, asked=asked, only_for=only_for)
        self._finish(goal, Answer.of(failure))
        return goal.goal_id

    def cancel(self, goal_id: str, reason: str) -> None:
        """End one goal, in hand or waiting; nothing happens when it has been answered."""
        if self._active is not None and self._active.goal_id == goal_id:
            self._runner.end(reason)
        for goal in [goal for goal in self._waiting if goal.goal_id == goal_id]:
            self._waiting.remove(goal)
            self._finish(goal, _before_its_turn(reason))

    def end_all(self, reason: str) -> None:
        """End the goal in hand and all that wait; each is answered PREEMPTED."""
        self._clear(reason)
        if self._active is not None:
            self._runner.end(reason)

    def stop(self, reason: str) -> None:
        """End the goal in hand and all that wait, each answered PREEMPTED, and every motion of the arm."""
        self._clear(reason)
        self._runner.stop(reason)

    def _clear(self, reason: str) -> None:
        waiting = list(self._waiting)
        self._waiting.clear()
        for goal in waiting:
            self._finish(goal, _before_its_turn(reason))

    def _next_id(self) -> str:
        return str(next(self._ids))

    def _enqueue(self, goal: QueuedGoal[Request]) -> None:
        ahead = len(self._waiting) + (self._active is not None)
        self._waiting.append(goal)
        self._tell(goal, Progress(GoalState.QUEUED, f"{ahead} goals ahead" if ahead else "next"))
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
            if self._active is not goal:
                return
            self._active = None
            self._finish(goal, answer)
            self._idle.set()

    async def _run(self, goal: QueuedGoal[Request]) -> Answer:
        if goal.request is None:
            raise AssertionError("a refused goal was queued")
        try:
            return await self._runner.run(goal.request, lambda progress: self._tell(goal, progress))
        except Exception as error:  # a bug must cost this goal only, and never its answer
            log.exception("goal %s from %s failed", goal.goal_id, goal.source)
            return Answer(MoveItErrorCode.FAILURE, f"internal error: {type(error).__name__}: {error}")

    def _tell(self, goal: QueuedGoal[Request], progress: Progress) -> None:
        with _contained(goal):
            self._on_progress(goal, progress)
        with _contained(goal):
            goal.on_progress(progress)

    def _finish(self, goal: QueuedGoal[Request], answer: Answer) -> None:
        with _contained(goal):
            self._on_answer(goal, answer)
        with _contained(goal):
            goal.on_answer(answer)


@contextlib.contextmanager
def _contained(goal: QueuedGoal[Any]) -> Iterator[None]:
    """Keep a bug in those who are told from the queue and from one another."""
    try:
        yield
    except Exception:
        log.exception("goal %s from %s could not be told of", goal.goal_id, goal.source)


def _before_its_turn(reason: str) -> Answer:
    return Answer(MoveItErrorCode.PREEMPTED, f"{reason} before this goal's turn came")

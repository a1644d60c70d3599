"""Queue of goals before the arm: one runs at a time, and each gets exactly one answer."""

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

_NO_MESSAGE: Mapping[str, Any] = MappingProxyType({})


class GoalPolicy(StrEnum):
    """Treatment of a goal that arrives while another one is being worked on."""

    QUEUE = "queue"
    REJECT = "reject"
    PREEMPT = "preempt"


class GoalState(StrEnum):
    """Stages of a goal."""

    QUEUED = "queued"
    PLANNING = "planning"
    PLANNED = "planned"
    EXECUTING = "executing"
    DONE = "done"


@dataclass(frozen=True)
class Progress:
    """Progress of a goal: ``fraction`` of the motion that is done, and the time left to its end [s]."""

    state: GoalState
    message: str
    fraction: float = 0.0
    remaining_s: float = 0.0


@dataclass(frozen=True)
class Performed:
    """Motions planned and executed for a goal.

    Attributes:
        start_rad: position of every movable joint at the start of the first motion [rad].
        planned: the motions, one after the other.
        executed: the path of the arm by its readings; None when it did not move.
        planning_time_s: time spent on planning [s].
    """

    start_rad: Mapping[str, float]
    planned: tuple[Trajectory, ...] = ()
    executed: Trajectory | None = None
    planning_time_s: float = 0.0


@dataclass(frozen=True)
class Answer:
    """Final answer to a goal; there is exactly one.

    Attributes:
        code: MoveIt's code of the end.
        message: one sentence.
        details: diagnostic details, as in `PlanningFailure`.
        performed: the motions; None when nothing was planned.
    """

    code: MoveItErrorCode
    message: str
    details: Mapping[str, Any] = field(default_factory=dict)
    performed: Performed | None = None

    @classmethod
    def of(cls, failure: PlanningFailure, performed: Performed | None = None) -> Answer:
        """Return the answer that reports a planning failure."""
        return cls(failure.code, failure.message, failure.details, performed)


@dataclass(frozen=True)
class QueuedGoal(Generic[Request]):
    """Goal in the queue.

    Attributes:
        goal_id: unique in the life of the server.
        source: topic or action of its client.
        request: the motion; None when the goal was rejected before it was queued.
        on_progress: called with its progress.
        on_answer: called once.
        message: the message of its client; empty when there is none, or none that can be read.
        only_for: the one client that is informed; None for all.
        client: name of its client; empty when it is not known.
    """

    goal_id: str
    source: str
    request: Request | None
    on_progress: Callable[[Progress], None] = lambda _progress: None
    on_answer: Callable[[Answer], None] = lambda _answer: None
    message: Mapping[str, Any] = field(default_factory=dict)
    only_for: Node | None = None
    client: str = ""

    @property
    def title(self) -> str:
        """Its number, its client and its way in, for people."""
        return f"goal {self.goal_id}{f' of {self.client}' if self.client else ''} from {self.source}"


@dataclass(frozen=True)
class RunningGoal:
    """Goal that occupies the arm, for those who wait for its end.

    Attributes:
        title: its number, its client and its way in.
        remaining_s: time left of its motion [s]; None before it moves.
        waiting: number of goals that wait behind it.
    """

    title: str
    remaining_s: float | None
    waiting: int = 0


class GoalRunner(Protocol[Request_contra]):
    """Runner of one goal at a time."""

    async def run(self, request: Request_contra, report: Callable[[Progress], None]) -> Answer:
        """Execute the goal; end with an answer, also after :meth:`cancel`, :meth:`preempt` and :meth:`stop`."""

    def cancel(self, reason: str) -> None:
        """Cancel the active goal: stop planning, and brake its motion along its path."""

    def preempt(self, reason: str) -> None:
        """End the active goal for another that follows at once and may replace its motion without a stop."""

    def stop(self, reason: str) -> None:
        """End the active goal and every motion of the arm, also those of other parts."""


class GoalQueue(Generic[Request]):
    """Bounded queue before one runner.

    Args:
        runner: executes goals.
        policy: treatment of a goal that arrives while another one is active, unless it comes with its own policy.
        capacity: limit of waiting goals.
        on_progress: called with the progress of every goal.
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
        self._progress: Progress | None = None
        self._arrived = asyncio.Event()
        self._idle = asyncio.Event()
        self._idle.set()
        self._ids = itertools.count(1)
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Start to execute goals."""
        self._task = asyncio.create_task(self._work(), name="goal queue")

    async def close(self, timeout_s: float) -> None:
        """Stop the active goal, answer every goal and end, at the latest after ``timeout_s``."""
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
        """End the work; a goal that is still active is answered all the same."""
        if self._task is not None:
            self._task.cancel()
        goal, self._active = self._active, None
        if goal is not None:
            reason = "the server is shutting down, and the arm did not come to rest in time"
            self._finish(goal, Answer(MoveItErrorCode.PREEMPTED, reason))

    @property
    def busy(self) -> str:
        """Sentence that names the active goal; empty when there is none."""
        return (
            f"goal {self._active.goal_id} from {self._active.source} is worked on" if self._active is not None else ""
        )

    @property
    def running(self) -> RunningGoal | None:
        """The active goal, for those who wait for its end; None when there is none."""
        if self._active is None:
            return None
        progress = self._progress
        executing = progress is not None and progress.state is GoalState.EXECUTING
        return RunningGoal(
            self._active.title, progress.remaining_s if progress and executing else None, len(self._waiting)
        )

    @property
    def waiting_count(self) -> int:
        """Number of goals that wait for their turn."""
        return len(self._waiting)

    def submit(
        self,
        source: str,
        request: Request,
        *,
        policy: GoalPolicy | None = None,
        on_progress: Callable[[Progress], None] = lambda _progress: None,
        on_answer: Callable[[Answer], None] = lambda _answer: None,
        message: Mapping[str, Any] = _NO_MESSAGE,
        client: object = None,
    ) -> str:
        """Queue a goal; return its id.

        Args:
            source: topic or action of its client.
            request: the motion.
            policy: its treatment while another goal is active; None for the queue's own policy.
            on_progress: called with its progress, besides the queue's own.
            on_answer: called once, likewise, perhaps before this returns.
            message: the message of its client.
            client: its client, who is named to those who wait for the goal's end; None when it is not known.
        """
        name = "" if client is None else str(client)
        goal = QueuedGoal(self._next_id(), source, request, on_progress, on_answer, message, client=name)
        policy = policy or self._policy
        if policy is GoalPolicy.REJECT and self._active is not None:
            self._finish(goal, Answer(MoveItErrorCode.FAILURE, f"goal {self._active.goal_id} is still being worked on"))
        elif policy is GoalPolicy.PREEMPT:
            reason = f"preempted by goal {goal.goal_id} from {source}"
            self._clear(reason)
            if self._active is not None:
                self._runner.preempt(reason)
            self._enqueue(goal)
        elif len(self._waiting) >= self._capacity:
            limit = f"{self._capacity} goals are waiting already, the limit"
            self._finish(goal, Answer(MoveItErrorCode.FAILURE, limit))
        else:
            self._enqueue(goal)
        return goal.goal_id

    def reject(
        self,
        source: str,
        failure: PlanningFailure,
        message: Mapping[str, Any] = _NO_MESSAGE,
        only_for: Node | None = None,
    ) -> str:
        """Answer a goal that cannot be executed, at once and past the queue; return its id.

        Args:
            source: topic or action of its client.
            failure: the reason.
            message: the message of its client.
            only_for: the one client that is informed; None for all.
        """
        goal: QueuedGoal[Request] = QueuedGoal(self._next_id(), source, None, message=message, only_for=only_for)
        self._finish(goal, Answer.of(failure))
        return goal.goal_id

    def cancel(self, goal_id: str, reason: str) -> None:
        """Cancel one goal, active or waiting; do nothing when it has been answered."""
        if self._active is not None and self._active.goal_id == goal_id:
            self._runner.cancel(reason)
        for goal in [goal for goal in self._waiting if goal.goal_id == goal_id]:
            self._waiting.remove(goal)
            self._finish(goal, _before_its_turn(reason))

    def cancel_all(self, reason: str) -> None:
        """Cancel the active goal and all that wait; each is answered PREEMPTED."""
        self._clear(reason)
        if self._active is not None:
            self._runner.cancel(reason)

    def stop(self, reason: str) -> None:
        """End the active goal and all that wait, each answered PREEMPTED, and every motion of the arm."""
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
        self._report(goal, Progress(GoalState.QUEUED, f"{ahead} goals ahead" if ahead else "next"))
        self._arrived.set()

    async def _work(self) -> None:
        while True:
            while not self._waiting:
                self._arrived.clear()
                await self._arrived.wait()
            goal = self._waiting.popleft()
            self._active, self._progress = goal, None
            self._idle.clear()
            answer = await self._run(goal)
            if self._active is not goal:
                return
            self._active = None
            self._finish(goal, answer)
            self._idle.set()

    async def _run(self, goal: QueuedGoal[Request]) -> Answer:
        if goal.request is None:
            raise AssertionError("a rejected goal was queued")
        try:
            return await self._runner.run(goal.request, lambda progress: self._report(goal, progress))
        except Exception as error:  # a bug must cost this goal only, and never its answer
            log.exception("goal %s from %s failed", goal.goal_id, goal.source)
            return Answer(MoveItErrorCode.FAILURE, f"internal error: {type(error).__name__}: {error}")

    def _report(self, goal: QueuedGoal[Request], progress: Progress) -> None:
        if goal is self._active:
            self._progress = progress
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
    """Keep a bug in a listener from the queue and from other listeners."""
    try:
        yield
    except Exception:
        log.exception("goal %s from %s could not be reported", goal.goal_id, goal.source)


def _before_its_turn(reason: str) -> Answer:
    return Answer(MoveItErrorCode.PREEMPTED, f"{reason} before this goal's turn came")

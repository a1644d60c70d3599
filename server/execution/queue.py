"""Queue of goals before the arm: each gets exactly one answer.

Goals that have a joint in common run one after the other, in the order of their arrival; others run at the same time.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import itertools
import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeAlias, TypeVar

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.stop_epochs import STOPPED_SINCE
from robot.trajectory import Trajectory
from server.arrival import arrival_epoch
from server.graph.node import Node

log = logging.getLogger("armbridge.goals")

Request = TypeVar("Request")
Request_contra = TypeVar("Request_contra", contravariant=True)

_NO_MESSAGE: Mapping[str, Any] = MappingProxyType({})

# Names of joints.
Joints: TypeAlias = frozenset[str]


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
    joints: Joints = frozenset()
    epoch: int = 0

    @property
    def title(self) -> str:
        """Its number, its client and its way in, for people."""
        return f"goal {self.goal_id}{f' of {self.client}' if self.client else ''} from {self.source}"


@dataclass(frozen=True)
class RunningGoal:
    """Goal that occupies the arm, for those who wait for its end.

    Attributes:
        remaining_s: time left of its motion [s]; None before it moves.
    """

    title: str
    remaining_s: float | None
    waiting: int = 0


class GoalRunner(Protocol[Request_contra]):
    """Runner of one goal at a time."""

    async def run(self, request: Request_contra, report: Callable[[Progress], None], epoch: int) -> Answer:
        """Execute the goal; end with an answer, also after :meth:`cancel` and :meth:`preempt`.

        Args:
            report: called with its progress.
        """

    def cancel(self, reason: str) -> None:
        """Cancel the active goal: stop planning, and brake its motion along its path."""

    def preempt(self, reason: str) -> None:
        """End the active goal for another that follows at once and may replace its motion without a stop."""

    def plan_ahead(self, request: Request_contra, left_s: float) -> None:
        """Plan the goal that comes next in advance, while the motion of the active goal takes so long still [s]."""

    def forget(self, request: Request_contra) -> None:
        """Drop what was planned in advance of a goal whose turn will not come."""


class GoalRunners(Protocol[Request_contra]):
    """Runners of the arm's goals: one for each set of joints."""

    def joints_of(self, request: Request_contra) -> Joints:
        """Return the joints that a goal moves."""

    def runner(self, joints: Joints) -> GoalRunner[Request_contra]:
        """Return the runner of goals that move these joints; it is the same each time."""

    def last_stop(self, joints: Joints) -> int:
        """Return the stop epoch of the last stop of the arms that have some joints."""

    def stop(self, reason: str, joints: Iterable[str] | None) -> None:
        """End every motion of the arms that have some joints, also those of other parts; None for all arms.

        Active goals are cancelled besides.
        """


class ActiveGoal(Generic[Request]):
    """Goal that is being worked on.

    Attributes:
        progress: the latest; None before the first.
    """

    def __init__(self, goal: QueuedGoal[Request], runner: GoalRunner[Request]) -> None:
        self.goal = goal
        self.runner = runner
        self.progress: Progress | None = None
        self.task: asyncio.Task[None] | None = None

    @property
    def remaining_s(self) -> float | None:
        """Time left of its motion [s]; None before it moves."""
        executing = self.progress is not None and self.progress.state is GoalState.EXECUTING
        return self.progress.remaining_s if self.progress and executing else None


class GoalQueue(Generic[Request]):
    """Bounded queue before the runners.

    Args:
        policy: treatment of a goal that arrives while another one of its joints is active, unless it comes with its
            own policy.
        capacity: limit of waiting goals.
        on_progress: called with the progress of every goal.
        on_answer: called once a goal.
    """

    def __init__(
        self,
        runners: GoalRunners[Request],
        policy: GoalPolicy,
        capacity: int,
        on_progress: Callable[[QueuedGoal[Request], Progress], None],
        on_answer: Callable[[QueuedGoal[Request], Answer], None],
    ) -> None:
        self._runners = runners
        self._policy = policy
        self._capacity = capacity
        self._on_progress = on_progress
        self._on_answer = on_answer
        self._waiting: deque[QueuedGoal[Request]] = deque()
        # In the order of their start.
        self._active: dict[str, ActiveGoal[Request]] = {}
        self._idle = asyncio.Event()
        self._idle.set()
        self._ids = itertools.count(1)
        self._started = False

    def start(self) -> None:
        """Start to execute goals."""
        self._started = True
        self._begin_soon()

    async def close(self, timeout_s: float) -> None:
        """Stop the active goals, answer every goal and end, at the latest after ``timeout_s``."""
        self.stop("the server is shutting down")
        self._started = False
        try:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._idle.wait(), timeout_s)
        finally:
            self._abandon()

    def _abandon(self) -> None:
        """End the work; goals that are still active are answered all the same."""
        abandoned, self._active = list(self._active.values()), {}
        for active in abandoned:
            if active.task is not None:
                active.task.cancel()
            reason = "the server is shutting down, and the arm did not come to rest in time"
            self._finish(active.goal, Answer(MoveItErrorCode.PREEMPTED, reason))

    @property
    def busy(self) -> str:
        """Sentence that names the first active goal; empty when there is none."""
        return next(map(_worked_on, self._active.values()), "")

    def busy_with(self, joints: Iterable[str]) -> str:
        """Return the sentence that names the active goal that moves any of some joints; empty when there is none."""
        return next(map(_worked_on, self._moving(frozenset(joints))), "")

    @property
    def running(self) -> RunningGoal | None:
        """The active goal that ends last, for those who wait for its end; None when there is none."""
        return self._last_of(list(self._active.values()))

    def running_with(self, joints: Iterable[str]) -> RunningGoal | None:
        """Return the active goal that ends last of those that move any of some joints; None when there is none."""
        return self._last_of(self._moving(frozenset(joints)))

    def _last_of(self, active: Sequence[ActiveGoal[Request]]) -> RunningGoal | None:
        if not active:
            return None
        last = max(active, key=_ends_in_s)
        return RunningGoal(last.goal.title, last.remaining_s, len(self._waiting))

    @property
    def active_count(self) -> int:
        """Number of goals that are worked on."""
        return len(self._active)

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
        epoch: int | None = None,
    ) -> str:
        """Queue a goal; return its id. A goal that arrived before the arm's last stop is answered PREEMPTED at once.

        Args:
            source: topic or action of its client.
            policy: its treatment while another goal of its joints is active; None for the queue's own policy.
            on_progress: called with its progress, besides the queue's own.
            on_answer: called once, likewise, perhaps before this returns.
            client: its client, who is named to those who wait for the goal's end; None when it is not known.
            epoch: stop epoch in which it was requested; None for that of the request in progress.
        """
        name = "" if client is None else str(client)
        joints = self._runners.joints_of(request)
        epoch = arrival_epoch() if epoch is None else epoch
        goal = QueuedGoal(
            self._next_id(), source, request, on_progress, on_answer, message, client=name, joints=joints, epoch=epoch
        )
        policy = policy or self._policy
        in_the_way = self._moving(joints)
        if epoch < self._runners.last_stop(joints):
            self._finish(goal, Answer(MoveItErrorCode.PREEMPTED, STOPPED_SINCE))
        elif policy is GoalPolicy.REJECT and in_the_way:
            text = f"goal {in_the_way[0].goal.goal_id} is still being worked on"
            self._finish(goal, Answer(MoveItErrorCode.FAILURE, text))
        elif policy is GoalPolicy.PREEMPT:
            reason = f"preempted by goal {goal.goal_id} from {source}"
            self._clear(reason, joints)
            for active in in_the_way:
                active.runner.preempt(reason)
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
            only_for: the one client that is informed; None for all.
        """
        goal: QueuedGoal[Request] = QueuedGoal(self._next_id(), source, None, message=message, only_for=only_for)
        self._finish(goal, Answer.of(failure))
        return goal.goal_id

    def cancel(self, goal_id: str, reason: str) -> None:
        """Cancel one goal, active or waiting; do nothing when it has been answered."""
        if goal_id in self._active:
            self._active[goal_id].runner.cancel(reason)
        for goal in [goal for goal in self._waiting if goal.goal_id == goal_id]:
            self._waiting.remove(goal)
            self._leave(goal, reason)
        self._begin_soon()

    def cancel_all(self, reason: str, joints: Iterable[str] | None = None) -> None:
        """Cancel the active goals and all that wait; each is answered PREEMPTED.

        Args:
            joints: only goals that move any of these; None for all goals.
        """
        wanted = None if joints is None else frozenset(joints)
        self._clear(reason, wanted)
        for active in list(self._active.values()) if wanted is None else self._moving(wanted):
            active.runner.cancel(reason)

    def stop(self, reason: str, joints: Iterable[str] | None = None) -> None:
        """End the active goals and all that wait, each answered PREEMPTED, and every motion of the arm.

        Args:
            joints: of those arms alone that have any of these; None for all.
        """
        self.cancel_all(reason, joints)
        self._runners.stop(reason, joints)

    def _moving(self, joints: Joints) -> list[ActiveGoal[Request]]:
        """Return the active goals that move any of some joints."""
        return [active for active in self._active.values() if active.goal.joints & joints]

    def _clear(self, reason: str, joints: Joints | None = None) -> None:
        """Answer the waiting goals that move any of some joints; None for all."""
        cleared = [goal for goal in self._waiting if joints is None or goal.joints & joints]
        self._waiting = deque(goal for goal in self._waiting if goal not in cleared)
        for goal in cleared:
            self._leave(goal, reason)

    def _leave(self, goal: QueuedGoal[Request], reason: str) -> None:
        """Answer a goal that was taken out of the queue before its turn."""
        if goal.request is not None:
            self._runners.runner(goal.joints).forget(goal.request)
        self._finish(goal, _before_its_turn(reason))

    def _next_id(self) -> str:
        return str(next(self._ids))

    def _enqueue(self, goal: QueuedGoal[Request]) -> None:
        others = (*(active.goal for active in self._active.values()), *self._waiting)
        ahead = sum(1 for other in others if other.joints & goal.joints)
        self._waiting.append(goal)
        self._report(goal, Progress(GoalState.QUEUED, f"{ahead} goals ahead" if ahead else "next"))
        for active in self._moving(goal.joints):
            self._look_ahead(active)
        self._begin_soon()

    def _begin_soon(self) -> None:
        """Begin the goals whose turn has come, once the callers of this have done their part."""
        if self._started and self._waiting:
            asyncio.get_running_loop().call_soon(self._begin)

    def _begin(self) -> None:
        if not self._started:
            return
        taken: Joints = frozenset().union(*(active.goal.joints for active in self._active.values()))
        for goal in list(self._waiting):
            # A goal that waits keeps its joints for itself: none overtakes it.
            if not goal.joints & taken:
                self._waiting.remove(goal)
                self._activate(goal)
            taken |= goal.joints

    def _look_ahead(self, active: ActiveGoal[Request]) -> None:
        """Have the next goal planned in advance while a motion is in progress, if it waits for that motion alone."""
        left_s, joints = active.remaining_s, active.goal.joints
        following = next((goal for goal in self._waiting if goal.joints & joints), None)
        if left_s is None or following is None or following.request is None or following.joints != joints:
            return
        with _contained(following):
            active.runner.plan_ahead(following.request, left_s)

    def _activate(self, goal: QueuedGoal[Request]) -> None:
        active = self._active[goal.goal_id] = ActiveGoal(goal, self._runners.runner(goal.joints))
        self._idle.clear()
        active.task = asyncio.create_task(self._work(active), name=f"goal {goal.goal_id}")

    async def _work(self, active: ActiveGoal[Request]) -> None:
        answer = await self._run(active)
        if self._active.pop(active.goal.goal_id, None) is None:
            return
        self._finish(active.goal, answer)
        if not self._active:
            self._idle.set()
        self._begin_soon()

    async def _run(self, active: ActiveGoal[Request]) -> Answer:
        goal = active.goal
        if goal.request is None:
            raise AssertionError("a rejected goal was queued")
        try:
            return await active.runner.run(goal.request, functools.partial(self._report, goal), goal.epoch)
        except Exception as error:  # a bug must cost this goal only, and never its answer
            log.exception("goal %s from %s failed", goal.goal_id, goal.source)
            return Answer(MoveItErrorCode.FAILURE, f"internal error: {type(error).__name__}: {error}")

    def _report(self, goal: QueuedGoal[Request], progress: Progress) -> None:
        if goal.goal_id in self._active:
            self._active[goal.goal_id].progress = progress
            self._look_ahead(self._active[goal.goal_id])
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


def _worked_on(active: ActiveGoal[Any]) -> str:
    return f"goal {active.goal.goal_id} from {active.goal.source} is worked on"


def _ends_in_s(active: ActiveGoal[Any]) -> float:
    """Return the time to the end of a goal's motion, infinite before it moves [s]."""
    return float("inf") if active.remaining_s is None else active.remaining_s


def _before_its_turn(reason: str) -> Answer:
    return Answer(MoveItErrorCode.PREEMPTED, f"{reason} before this goal's turn came")

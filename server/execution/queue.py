"""Queue of goals before the arm: each gets exactly one answer.

Goals that have a joint in common run one after the other, in the order of their arrival; others run at the same time.
"""

import asyncio
import contextlib
import itertools
import logging
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.stop_epochs import STOPPED_SINCE
from server.arrival import is_stopped
from server.execution.executor import GoalExecutors
from server.execution.goal import Answer, ExecutionDeadline, Goal, GoalPolicy, GoalRequest, GoalState, Progress
from server.execution.motions import Joints

log = logging.getLogger("armbridge.goals")

SHUTTING_DOWN = "the server is shutting down"

# Called with the stick or leader that takes over, in words, and a function that returns True while it moves the arm.
TakeOver: TypeAlias = Callable[[str, Callable[[], bool]], None]


@dataclass(frozen=True)
class RunningGoal:
    """Goal that occupies the arm, for those who wait for its end; ``remaining_s`` is None before it moves."""

    title: str
    remaining_s: float | None
    waiting: int = 0


class GoalListener:
    """Part of the server that takes the news of all goals."""

    def on_progress(self, goal: Goal, progress: Progress) -> None:
        """Take the progress of a goal."""

    def on_answer(self, goal: Goal, answer: Answer) -> None:
        """Take the answer to a goal."""


class GoalQueue:
    """Bounded queue before the executors; where its methods have joints, None stands for all."""

    def __init__(self, executors: GoalExecutors, policy: GoalPolicy, capacity: int) -> None:
        self._executors = executors
        self._policy = policy
        self._capacity = capacity
        self.listeners: list[GoalListener] = []
        self._waiting: deque[Goal] = deque()
        # In the order of their start.
        self._active: dict[Goal, asyncio.Task[None]] = {}
        self._idle = asyncio.Event()
        self._idle.set()
        self._ids = map(str, itertools.count(1))
        self._giving_way: list[tuple[Joints, TakeOver]] = []
        self._started = self._closed = False

    def start(self) -> None:
        self._started = True
        self._begin()

    async def close(self, timeout_s: float) -> None:
        """End the active goals, answer every goal and end, at the latest after ``timeout_s``."""
        self._started, self._closed = False, True
        self.cancel_all(SHUTTING_DOWN)
        # No stop: an arm that a client stops from now on is not parked any more.
        self._executors.brake()
        try:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._idle.wait(), timeout_s)
        finally:
            # Goals that are still active are answered all the same.
            abandoned, self._active = self._active, {}
            for goal, task in abandoned.items():
                task.cancel()
                reason = f"{SHUTTING_DOWN}, and the arm did not come to rest in time"
                self._finish(goal, Answer(MoveItErrorCode.PREEMPTED, reason))

    def busy(self, joints: Iterable[str] | None = None) -> str:
        """Return a sentence that names the first active goal, of those that move any of some joints; empty for none."""
        goal = next(iter(self._moving(joints)), None)
        return "" if goal is None else f"goal {goal.goal_id} from {goal.request.source} is worked on"

    def running(self, joints: Iterable[str] | None = None) -> RunningGoal | None:
        """Return the active goal that ends last, of those that move any of some joints; None when there is none."""
        # Before a goal moves, its end is unknown.
        ends_s = {goal: math.inf if goal.remaining_s is None else goal.remaining_s for goal in self._moving(joints)}
        last = max(ends_s, key=lambda goal: ends_s[goal], default=None)
        return None if last is None else RunningGoal(last.title, last.remaining_s, len(self._waiting))

    def give_way(self, joints: Joints, end: TakeOver) -> None:
        """Register a program that moves some joints: ``end`` is called when a person takes any of them over."""
        self._giving_way.append((joints, end))

    def take_over(self, joints: Joints, hand: str, moves: Callable[[], bool]) -> None:
        """End the goals of programs that give way to a person's hand; ``moves`` returns True while it moves the arm."""
        for moved, end in self._giving_way:
            if not moved.isdisjoint(joints):
                end(hand, moves)

    @property
    def active_count(self) -> int:
        return len(self._active)

    @property
    def waiting_count(self) -> int:
        return len(self._waiting)

    def submit(self, request: GoalRequest) -> Goal:
        """Queue a goal; a goal that arrived before the arm's last stop is answered PREEMPTED at once."""
        goal = self._goal(request)
        policy = request.policy or self._policy
        in_the_way = self._moving(request.joints)
        if self._closed or is_stopped(self._executors.last_stop(request.joints), request.epoch):
            reason = SHUTTING_DOWN if self._closed else STOPPED_SINCE
            self._finish(goal, Answer(MoveItErrorCode.PREEMPTED, reason))
        elif policy is GoalPolicy.REJECT and in_the_way:
            text = f"goal {in_the_way[0].goal_id} is still being worked on"
            self._finish(goal, Answer(MoveItErrorCode.FAILURE, text))
        elif policy is GoalPolicy.PREEMPT:
            reason = f"preempted by goal {goal.goal_id} from {request.source}"
            self._clear(reason, request.joints, replaced=True)
            for active in in_the_way:
                active.cancel(reason, replaced=True)
            self._enqueue(goal)
        elif len(self._waiting) >= self._capacity:
            limit = f"{self._capacity} goals are waiting already, the limit (goals.capacity)"
            self._finish(goal, Answer(MoveItErrorCode.FAILURE, limit))
        else:
            self._enqueue(goal)
        return goal

    def reject(self, request: GoalRequest, failure: PlanningFailure) -> Goal:
        """Answer a goal that cannot be executed, at once and past the queue."""
        goal = self._goal(request)
        self._finish(goal, Answer.of(failure))
        return goal

    def _goal(self, request: GoalRequest) -> Goal:
        deadline = ExecutionDeadline(self._executors.time_limits)
        return Goal(next(self._ids), request, self._report, deadline=deadline)

    def _report(self, goal: Goal, progress: Progress) -> None:
        for listener in self.listeners:
            with _contained(goal):
                listener.on_progress(goal, progress)
        with _contained(goal):
            goal.request.on_progress(progress)

    def cancel(self, goal_id: str, reason: str) -> None:
        """Cancel one goal, active or waiting; do nothing when it has been answered."""
        for goal in self._active:
            if goal.goal_id == goal_id:
                goal.cancel(reason)
        for goal in [goal for goal in self._waiting if goal.goal_id == goal_id]:
            self._waiting.remove(goal)
            self._leave(goal, reason)
        self._begin()

    def cancel_all(self, reason: str, joints: Iterable[str] | None = None) -> None:
        """Cancel the active goals that move any of some joints, and those that wait; each is answered PREEMPTED."""
        self._clear(reason, joints)
        for goal in self._moving(joints):
            goal.cancel(reason)

    def stop(self, reason: str, joints: Iterable[str] | None = None) -> None:
        """Cancel as :meth:`cancel_all`, and end every motion of the arms that have any of the joints."""
        self.cancel_all(reason, joints)
        self._executors.stop(joints)

    def _moving(self, joints: Iterable[str] | None) -> list[Goal]:
        return [goal for goal in self._active if _moves(goal, joints)]

    def _clear(self, reason: str, joints: Iterable[str] | None, *, replaced: bool = False) -> None:
        """Answer the waiting goals that move any of some joints."""
        cleared = [goal for goal in self._waiting if _moves(goal, joints)]
        self._waiting = deque(goal for goal in self._waiting if goal not in cleared)
        for goal in cleared:
            goal.replaced = replaced
            self._leave(goal, reason)

    def _leave(self, goal: Goal, reason: str) -> None:
        self._finish(goal, Answer(MoveItErrorCode.PREEMPTED, f"{reason} before this goal's turn came"))

    def _enqueue(self, goal: Goal) -> None:
        ahead = sum(1 for other in (*self._active, *self._waiting) if other.request.joints & goal.request.joints)
        self._waiting.append(goal)
        goal.report(Progress(GoalState.QUEUED, f"{ahead} goals ahead" if ahead else "next"))
        self._begin()

    def _begin(self) -> None:
        if not self._started:
            return
        taken: Joints = frozenset().union(*(active.request.joints for active in self._active))
        for goal in list(self._waiting):
            # A goal that waits keeps its joints for itself: none overtakes it.
            if not goal.request.joints & taken:
                self._waiting.remove(goal)
                self._idle.clear()
                self._active[goal] = asyncio.create_task(self._work(goal), name=f"goal {goal.goal_id}")
            taken |= goal.request.joints

    async def _work(self, goal: Goal) -> None:
        try:
            answer = await self._executors.executor(goal.request.joints).run(goal)
        except Exception as error:  # a bug must cost this goal only, and never its answer
            log.exception("goal %s from %s failed", goal.goal_id, goal.request.source)
            answer = Answer(MoveItErrorCode.FAILURE, f"internal error: {type(error).__name__}: {error}")
        if self._active.pop(goal, None) is None:
            return
        self._finish(goal, answer)
        if not self._active:
            self._idle.set()
        self._begin()

    def _finish(self, goal: Goal, answer: Answer) -> None:
        for listener in self.listeners:
            with _contained(goal):
                listener.on_answer(goal, answer)
        with _contained(goal):
            goal.request.on_answer(answer)
        goal.answered.set_result(answer)


@contextlib.contextmanager
def _contained(goal: Goal) -> Iterator[None]:
    """Keep a bug in a listener from the queue and from other listeners."""
    try:
        yield
    except Exception:
        log.exception("goal %s from %s could not be reported", goal.goal_id, goal.request.source)


def _moves(goal: Goal, joints: Iterable[str] | None) -> bool:
    return joints is None or not goal.request.joints.isdisjoint(joints)

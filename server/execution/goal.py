"""A goal of a client, from its arrival to its one answer, and the time limits of its motions."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, TypeAlias, TypeVar

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.arm_group import AnyArm
from robot.messages import MotionEnded, MotionProgress, Outcome, Pace, PlaybackDirection
from server.arrival import arrival_epoch
from server.errors import refused
from server.execution.motions import NOTHING, Joints, Motion, Performed, Positions
from server.graph.permissions import Node

Result = TypeVar("Result")

# A motion that overran is braked; no arm needs longer for that, by its own clock.
BRAKING_TIMEOUT_S = 2.0

# A slower motion counts as paused: at this share of its speed a motion of 3 s takes a minute.
MIN_SPEED_FACTOR = 0.05


@dataclass(frozen=True)
class TimeLimits:
    """Limits of the execution time of motions."""

    # Multiple of the planned duration; 2.2 is MoveIt's allowed_execution_duration_scaling of 1.1 at the half speed of a
    # hot arm.
    scaling: float = 2.2
    margin_s: float = 2.0  # time on top, in which the arm settles [s]
    paused_s: float = 600.0  # limit of the time that a goal's motions are paused or move backwards, in total [s]
    trajectory_s: float = 600.0  # limit of the planned duration of a goal's motions together [s]

    def allowed_s(self, duration_s: float) -> float:
        return duration_s * self.scaling + self.margin_s

    def check_duration(self, duration_s: float, field: str, code: MoveItErrorCode, advice: str = "") -> None:
        if not duration_s <= self.trajectory_s:
            limit_s = self.trajectory_s
            text = f"{field} is {duration_s:.6g} s, longer than goals.max_trajectory_duration_s = {limit_s:g}{advice}"
            raise refused(code, text, duration_s=duration_s, limit_s=limit_s)


class ArmStopwatch:
    """Stopwatch on the slower of two clocks, the arm's and this machine's.

    A busy machine slows a simulated arm's clock down. A server that stood still itself receives all the arm's time at
    once, also the time before the arm got its order.
    """

    def __init__(self, arm: AnyArm, clock: Callable[[], float]) -> None:
        self._arm = arm
        self._clock = clock
        self._began_s, self._began_by_arm_s = clock(), arm.clock_s
        # Greatest lag of the arm's clock so far; the time that it catches up later are states that came late.
        self._lag_s = 0.0
        self._total_s = 0.0

    def elapsed_s(self) -> float:
        """Return the time since the last call, or since the construction [s]."""
        here_s, by_arm_s = self._clock() - self._began_s, self._arm.clock_s - self._began_by_arm_s
        self._lag_s = max(self._lag_s, here_s - by_arm_s)
        before_s, self._total_s = self._total_s, max(here_s - self._lag_s, self._total_s)
        return self._total_s - before_s


class ExecutionDeadline:
    """Deadline of the motions of one goal, one after the other, counted in their own time."""

    def __init__(self, limits: TimeLimits | None = None) -> None:
        self.limits = limits or TimeLimits()
        self._allowed_s = self._used_s = self._paused_s = 0.0

    def begin(self, duration_s: float) -> None:
        """Begin a motion of a planned duration [s]; pauses of all motions count together."""
        self._allowed_s, self._used_s = self.limits.allowed_s(duration_s), 0.0

    def pass_time(self, elapsed_s: float, pace: Pace) -> None:
        if pace.direction is PlaybackDirection.FORWARD and pace.speed_factor >= MIN_SPEED_FACTOR:
            self._used_s += elapsed_s * pace.speed_factor
            return
        self._paused_s += elapsed_s
        if pace.direction is PlaybackDirection.BACK:
            # The arm has to repeat the part that it moves back.
            self._used_s = max(self._used_s - elapsed_s * pace.speed_factor, 0.0)

    @property
    def exceeded(self) -> str | None:
        """Sentence that names the exceeded limit; None while there is time left."""
        if self._used_s > self._allowed_s:
            return f"the arm did not end the motion within {self._allowed_s:.1f} s"
        if self._paused_s > self.limits.paused_s:
            paused_s, limit_s = self._paused_s, self.limits.paused_s
            return f"the motion was paused or going back for {paused_s:.0f} s (limit {limit_s:g} s)"
        return None


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
class Answer:
    """Final answer to a goal; there is exactly one."""

    code: MoveItErrorCode
    message: str
    details: Mapping[str, Any] = field(default_factory=dict)
    performed: Performed = NOTHING

    @classmethod
    def of(cls, failure: PlanningFailure, performed: Performed = NOTHING) -> Answer:
        return cls(failure.code, failure.message, failure.details, performed)


def _future() -> asyncio.Future[Any]:
    return asyncio.get_running_loop().create_future()


@dataclass(eq=False)
class CancelScope:
    """Scope of the work for one request, until the request is cancelled."""

    epoch: int = field(default_factory=arrival_epoch, kw_only=True)  # stop epoch in which the request arrived
    # Time limits of its motions, and the time that they have used.
    deadline: ExecutionDeadline = field(default_factory=ExecutionDeadline, kw_only=True)
    # Reason of the cancellation, once there is one.
    cancelled: asyncio.Future[str] = field(init=False, default_factory=_future)
    # True where another request may replace the motion without a stop; else the motion brakes.
    replaced: bool = field(init=False, default=False)
    # Set at each cancellation: a task that waits for it goes on a turn of the event loop sooner than by the future.
    news: asyncio.Event = field(init=False, default_factory=asyncio.Event)

    @property
    def reason(self) -> str:
        """Reason of the cancellation; empty while there is none."""
        return self.cancelled.result() if self.cancelled.done() else ""

    def cancel(self, reason: str, *, replaced: bool = False) -> None:
        """End the work; the first reason counts, and a motion that has to brake is replaced no more."""
        self.replaced = replaced and (self.replaced or not self.cancelled.done())
        if not self.cancelled.done():
            self.cancelled.set_result(reason)
        self.news.set()

    def check(self, phase: str) -> None:
        """Raise RefusedError if the request was cancelled; the error's sentence ends with the phase of the work."""
        if self.reason:
            raise refused(MoveItErrorCode.PREEMPTED, f"{self.reason} {phase}")

    async def unless_cancelled(self, work: Coroutine[Any, Any, Result]) -> Result | None:
        """Return the result of some work; None when the request is cancelled before or meanwhile.

        The work is done in the present task: another task would begin and end some turns of the event loop later, in
        which the server serves its clients first.
        """
        task = asyncio.current_task()
        if task is None or self.cancelled.done():
            work.close()
            return None
        working, interrupted = True, False

        def interrupt(_cancelled: asyncio.Future[str]) -> None:
            nonlocal interrupted
            if working:
                interrupted = task.cancel()

        self.cancelled.add_done_callback(interrupt)
        try:
            return await work
        except asyncio.CancelledError:
            # The server itself may be ending the task as well.
            if not interrupted or task.cancelling() > 1:
                raise
            return None
        finally:
            working = False
            self.cancelled.remove_done_callback(interrupt)
            if interrupted:
                task.uncancel()


class MotionWatch:
    """Watch over one motion until it ends: brakes after a cancellation, counts its time; a grip keeps its speed."""

    def __init__(
        self,
        arm: AnyArm,
        motion: asyncio.Future[MotionEnded],
        scope: CancelScope,
        clock: Callable[[], float],
        *,
        gripping: bool = False,
    ) -> None:
        self._arm, self._motion, self._scope, self._gripping = arm, motion, scope, gripping
        self._arm_clock = ArmStopwatch(arm, clock)
        self._braked = False
        motion.add_done_callback(lambda _ended: scope.news.set())

    @property
    def over(self) -> bool:
        """True once the motion has ended or its time is over."""
        return self._motion.done() or self._scope.deadline.exceeded is not None

    async def step(self, period_s: float) -> MotionProgress | None:
        """Wait for a period, the motion's end or its cancellation; return its progress, None where it is unknown."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(period_s):
                await self._scope.news.wait()
        self._scope.news.clear()
        if self._scope.reason and not self._scope.replaced and not self._braked:
            self._arm.stop(self._motion)
            self._braked = True
        progress = self._arm.progress(self._motion)
        pace = Pace() if self._gripping else self._arm.state.pace
        if progress is not None:
            # A motion that the speed limit slows down uses its time up as slowly.
            pace = replace(pace, speed_factor=min(pace.speed_factor, progress.rate))
        self._scope.deadline.pass_time(self._arm_clock.elapsed_s(), pace)
        return None if self._motion.done() else progress

    async def end(self) -> MotionEnded:
        """Return the end of the motion; a motion whose time is over is braked."""
        if not self._motion.done():
            self._arm.stop(self._motion)
            await self._arm.wait((self._motion,), BRAKING_TIMEOUT_S)
        if not self._motion.done():
            message = f"{self._scope.deadline.exceeded}, and does not brake either"
            return MotionEnded(0, Outcome.PROCESS_LOST, message)
        return self._motion.result()


class GoalPolicy(StrEnum):
    """Treatment of a goal that arrives while another one of its joints is active."""

    QUEUE = "queue"
    REJECT = "reject"
    PREEMPT = "preempt"


@dataclass(frozen=True)
class GoalRequest:
    """Request of a motion, as it arrived."""

    source: str  # topic or action of its client
    motion: Motion | None = None  # None for a request that is rejected
    # The message of its client; empty without one, and for a message that cannot be read.
    message: Mapping[str, Any] = field(default_factory=dict)
    client: object = ""  # its client, who is named to those who wait for the goal's end; empty when it is unknown
    policy: GoalPolicy | None = None  # None for the queue's own policy
    # Called with its progress, after the queue's listeners.
    on_progress: Callable[[Progress], None] = lambda _progress: None
    # Called once with its answer, likewise; perhaps before ``submit`` returns.
    on_answer: Callable[[Answer], None] = lambda _answer: None
    only_for: Node | None = None  # the one client that is informed of its rejection; None for all
    epoch: int = field(default_factory=arrival_epoch)  # stop epoch in which it arrived
    streamed: bool = False  # True for a goal of a stream
    repeated: bool = False  # True where the stream's goal before it was refused

    @property
    def joints(self) -> Joints:
        return frozenset() if self.motion is None else self.motion.joints


@dataclass(eq=False)
class Goal(CancelScope):
    """Goal of a client, with its latest progress and its answer, once there is one."""

    goal_id: str
    request: GoalRequest
    # Gets all progress. A listener with a reference to its goal would keep it until the garbage collector comes.
    listener: Callable[[Goal, Progress], None] = lambda _goal, _progress: None
    _deferring: bool = field(init=False, default=False)
    # Reason of a replacement that waits for the beginning of its motion; empty for none.
    successor: str = field(init=False, default="")
    progress: Progress | None = field(init=False, default=None)
    answered: asyncio.Future[Answer] = field(init=False, default_factory=_future)

    def __post_init__(self) -> None:
        self.epoch = self.request.epoch

    def report(self, progress: Progress) -> None:
        self.progress = progress
        self.listener(self, progress)

    @property
    def unlogged(self) -> bool:
        """True for a goal of a stream whose end is no news: it was replaced, or refused as the one before it."""
        return self.request.streamed and (self.replaced or self.request.repeated)

    def cancel(self, reason: str, *, replaced: bool = False) -> None:
        """End the work; a replacement is deferred between the two calls below."""
        if replaced and self._deferring:
            self.successor = reason
        else:
            super().cancel(reason, replaced=replaced)

    def defer_replacement(self) -> None:
        """Have no other goal replace it until its motion has begun.

        Otherwise no trajectory of a stream would begin where its check takes longer than the next trajectory takes
        to arrive.
        """
        self._deferring = True

    def allow_replacement(self) -> None:
        """Have other goals replace it from now on, also those that came meanwhile."""
        self._deferring = False
        if self.successor:
            super().cancel(self.successor, replaced=True)

    @property
    def title(self) -> str:
        """Its number, its client and its way in, for people."""
        client = f" of {self.request.client}" if self.request.client else ""
        return f"goal {self.goal_id}{client} from {self.request.source}"

    @property
    def remaining_s(self) -> float | None:
        """Time left of its motion [s]; None before it moves."""
        if self.progress is None or self.progress.state is not GoalState.EXECUTING:
            return None
        return self.progress.remaining_s


# Queues a goal for positions of joints, at a share of their limits; raises RefusedError.
GoTo: TypeAlias = Callable[[Positions, float], Goal]

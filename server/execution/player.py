"""Player of one motion on the arm: reports its progress, and ends it when it overruns or the scene gets in its way.

Time limits are counted on the arm's clock: a simulated arm that a busy machine slows down has all its time. A process
that falls silent is ended by :class:`robot.arm.Arm`, and with it the motion.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from planners.problem import ConcurrencyQuestion, MoveItErrorCode, RecheckQuestion
from robot.arm_group import AnyArm
from robot.control.pacing import PERIOD_S
from robot.description.model import RobotModel
from robot.messages import ArmState, MotionEnded, MotionProgress, Outcome, Pace, PlaybackDirection
from robot.trajectory import Trajectory
from server.execution.goal import Answer, ArmStopwatch, CancelScope, Goal, GoalState, Progress
from server.execution.monitors import Questions, SceneMonitor
from server.execution.motions import (
    OUTGOING_S,
    SENDING_S,
    STATE_AGE_S,
    Joints,
    PathTime,
    Positions,
    SplicePoint,
    splice_point_of,
)

# A motion that overran is braked; no arm needs longer for that, by its own clock.
BRAKING_TIMEOUT_S = 2.0

PROGRESS_PERIOD_S = 0.2

CODE_OF_OUTCOME = {
    Outcome.REACHED: MoveItErrorCode.SUCCESS,
    Outcome.STOPPED: MoveItErrorCode.PREEMPTED,
    Outcome.REFUSED: MoveItErrorCode.CONTROL_FAILED,
    Outcome.TRACKING_LOST: MoveItErrorCode.CONTROL_FAILED,
    Outcome.NOT_SETTLED: MoveItErrorCode.CONTROL_FAILED,
    Outcome.BUS_LOST: MoveItErrorCode.COMMUNICATION_FAILURE,
    Outcome.PROCESS_LOST: MoveItErrorCode.COMMUNICATION_FAILURE,
    Outcome.FAULT: MoveItErrorCode.CONTROL_FAILED,
}


@dataclass(frozen=True)
class CheckedMotion:
    """Motion that was found free of collisions."""

    group: str
    trajectory: Trajectory
    scene_version: int
    summary: str

    def question(self, from_s: float, positions_rad: Positions) -> RecheckQuestion:
        """Return the question to planners if the motion is free."""
        moving = self.trajectory.joint_names
        others_rad = {name: value for name, value in positions_rad.items() if name not in moving}
        return RecheckQuestion(self.group, self.trajectory, others_rad, from_s)


@dataclass(frozen=True)
class OutgoingMotion:
    """Motion that goes on for a moment after its goal was preempted; another can replace it, if sent by ``until_s``."""

    motion: CheckedMotion
    ended: asyncio.Future[MotionEnded]
    path_time: PathTime
    until_s: float

    def splice_point(self, now_s: float, horizon_s: float) -> SplicePoint | None:
        """Return the point, so far ahead [s], at which another motion can replace it; None if there is none."""
        if self.ended.done():
            return None
        return splice_point_of(self.motion.trajectory, self.path_time, now_s, horizon_s)


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


class Player:
    """Player of one motion at a time; the motion of a preempted goal is ``outgoing``."""

    def __init__(
        self,
        arm: AnyArm,
        robot: RobotModel,
        scene_monitor: SceneMonitor,
        in_progress: MotionsInProgress,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._arm = arm
        self._robot = robot
        self._scene_monitor = scene_monitor
        self._in_progress = in_progress
        self._clock = clock
        self._motion: asyncio.Future[MotionEnded] | None = None
        self._begun = PathTime(0.0, 0.0, 1.0)
        self._end: Answer | None = None
        self.outgoing: OutgoingMotion | None = None

    async def play(
        self,
        goal: Goal,
        motion: CheckedMotion,
        questions: Callable[[float], Questions],
        *,
        from_s: float | None = None,
        to_come_s: float = 0.0,
    ) -> Answer:
        """Play a motion of a goal to its end; every wait is bounded.

        Where the goal is cancelled the motion brakes along its path. Where another goal replaces it, the motion goes on
        for a moment, and brakes unless the other motion has taken its place by then.

        Args:
            from_s: time on the outgoing motion at which this one begins, to replace it [s]; None to begin at rest.
            to_come_s: duration of the goal's motions after this one [s].
        """
        self._end = None
        outgoing, now_s, continues = self.outgoing, self._clock(), None
        self._begun = PathTime(now_s, 0.0, self._arm.rate)
        if outgoing is not None and from_s is not None:
            continues = outgoing.ended, from_s
            self._begun = PathTime(now_s, outgoing.path_time.at(now_s) - from_s, outgoing.path_time.rate)
        ended = self._arm.execute(motion.trajectory, continues=continues, epoch=goal.epoch)
        goal.allow_replacement()
        self._motion = ended
        self._in_progress.add(motion.trajectory, ended)
        self._scene_monitor.start(
            motion.scene_version,
            lambda: questions(self._played_s(motion, ended)),
            lambda contact: self._brake(Answer.of(contact)),
        )
        try:
            return await self._until_ended(goal, ended, motion, to_come_s)
        finally:
            self._scene_monitor.stop()
            # The goal is over, and so is its motion, also after an error here; an outgoing motion has its own end.
            if not ended.done() and (self.outgoing is None or self.outgoing.ended is not ended):
                self._arm.stop(ended)
            self._motion = None

    async def stop_outgoing(self) -> None:
        """Brake the outgoing motion, and wait for its end."""
        outgoing, self.outgoing = self.outgoing, None
        if outgoing is not None and not outgoing.ended.done():
            self._arm.stop(outgoing.ended)
            await self._arm.wait((outgoing.ended,), BRAKING_TIMEOUT_S)

    def _brake(self, end: Answer) -> None:
        if self._motion is not None:
            self._end = self._end or end
            self._arm.stop(self._motion)

    def _played_s(self, motion: CheckedMotion, ended: asyncio.Future[MotionEnded]) -> float:
        """Return the part of the motion that is played for good [s]; on the way back all of it may be played again."""
        progress = self._arm.progress(ended)
        if progress is None or self._arm.state.pace.direction is PlaybackDirection.BACK:
            return 0.0
        return progress.fraction * motion.trajectory.duration_s

    async def _until_ended(
        self, goal: Goal, ended: asyncio.Future[MotionEnded], motion: CheckedMotion, to_come_s: float
    ) -> Answer:
        goal.deadline.begin(motion.trajectory.duration_s)
        # Not before the arm has the motion: listeners take milliseconds, in which it would pass the splice point.
        left_s = motion.trajectory.duration_s + to_come_s
        goal.report(Progress(GoalState.EXECUTING, motion.summary, 0.0, left_s))
        watch = MotionWatch(self._arm, ended, goal, self._clock)
        period_s, shown_by_s = PROGRESS_PERIOD_S, self._clock() + STATE_AGE_S
        while not watch.over:
            progress = await watch.step(period_s)
            if goal.replaced and progress is None and not ended.done() and self._clock() < shown_by_s:
                # The arm may yet refuse it, and its place on the path is not known to a tick.
                period_s = PERIOD_S
                continue
            if goal.reason and self._end is None:
                if goal.replaced and not ended.done():
                    path_time = self._path_time(motion.trajectory, ended)
                    self.outgoing = OutgoingMotion(motion, ended, path_time, self._clock() + OUTGOING_S - SENDING_S)
                    # Braked then, whatever becomes of the other motion; a motion that was replaced by then goes on.
                    asyncio.get_running_loop().call_later(OUTGOING_S, self._arm.stop, ended)
                    return Answer(MoveItErrorCode.PREEMPTED, goal.reason)
                self._end = Answer(MoveItErrorCode.PREEMPTED, goal.reason)
            if progress is not None:
                left_s = progress.remaining_s + to_come_s
                goal.report(Progress(GoalState.EXECUTING, motion.summary, progress.fraction, left_s))
        if not ended.done():
            lag = _greatest_lag(self._arm.state, motion.trajectory.joint_names, self._robot)
            self._end = self._end or Answer(MoveItErrorCode.TIMED_OUT, f"{goal.deadline.exceeded}; {lag}")
        end = await watch.end()
        if end.outcome is not Outcome.STOPPED:
            return Answer(CODE_OF_OUTCOME[end.outcome], end.message, {"outcome": end.outcome.value})
        if self._end is None:
            return Answer(MoveItErrorCode.PREEMPTED, end.message)
        return Answer(self._end.code, f"{self._end.message}; {end.message}", self._end.details)

    def _path_time(self, trajectory: Trajectory, ended: asyncio.Future[MotionEnded]) -> PathTime:
        """Return the time on the path by the arm's latest state, or since the beginning, which it does not show yet."""
        progress, pace, now_s = self._arm.progress(ended), self._arm.state.pace, self._clock()
        rate = self._arm.rate * (pace.speed_factor if pace.direction is PlaybackDirection.FORWARD else 0.0)
        if progress is None:
            return PathTime(now_s, self._begun.at(now_s), min(rate, self._begun.rate))
        rate = min(rate, self._arm.rate * progress.rate)
        path_s = progress.fraction * trajectory.duration_s
        if (tick_s := self._arm.state.tick_s) and self._arm.rate == 1.0:
            return PathTime(tick_s, path_s, rate, at_tick=True)
        return PathTime(now_s, path_s + self._arm.state_age_s * rate, rate)


def _greatest_lag(state: ArmState, joints: tuple[str, ...], robot: RobotModel) -> str:
    if state.goal_rad is None or state.position_rad is None:
        return "its joint positions are unknown"
    error_rad = np.abs(state.goal_rad - state.position_rad)
    lags = {name: float(error_rad[state.joint_names.index(name)]) for name in joints}
    worst = max(lags, key=lambda name: lags[name])
    return f"joint {worst} is {lags[worst]:.3f} {robot.joints[worst].unit} behind"


@dataclass(frozen=True)
class MotionInProgress:
    """Motion that the arm plays."""

    trajectory: Trajectory
    ended: asyncio.Future[MotionEnded]

    @property
    def title(self) -> str:
        names = self.trajectory.joint_names
        return f"the motion of {names[0]}" + (f" to {names[-1]}" if len(names) > 1 else "")


class MotionsInProgress:
    """Motions of all goals, by which motions of some joints are planned around others, one goal at a ``turn``."""

    def __init__(self) -> None:
        self._motions: dict[asyncio.Future[MotionEnded], MotionInProgress] = {}
        self._announced: dict[Joints, Mapping[str, float]] = {}
        self.turn = asyncio.Lock()

    def announce(self, joints: Joints, end_rad: Mapping[str, float]) -> None:
        """Tell where motions of some joints that are planned will end [rad]."""
        self._announced[joints] = end_rad

    def withdraw(self, joints: Joints) -> None:
        self._announced.pop(joints, None)

    def add(self, trajectory: Trajectory, ended: asyncio.Future[MotionEnded]) -> None:
        if not ended.done():
            self._motions[ended] = MotionInProgress(trajectory, ended)
            ended.add_done_callback(lambda _ended: self._motions.pop(ended, None))

    def of(self, joints: Iterable[str]) -> list[MotionInProgress]:
        wanted = frozenset(joints)
        return [one for one in self._live if wanted & set(one.trajectory.joint_names)]

    def beside(self, joints: Joints) -> list[MotionInProgress]:
        """Return the motions of none but other joints."""
        return [one for one in self._live if not joints & set(one.trajectory.joint_names)]

    def expected_rad(self, held_rad: Mapping[str, float], joints: Joints) -> dict[str, float]:
        """Return the positions [rad] of some joints now, and of others after their motions, begun or announced."""
        expected_rad = dict(held_rad)
        for one in self.beside(joints):
            end_rad = one.trajectory.positions_rad[-1].tolist()
            expected_rad |= zip(one.trajectory.joint_names, end_rad, strict=True)
        for announced, end_rad_of in self._announced.items():
            if not announced & joints:
                expected_rad |= end_rad_of
        return expected_rad

    @property
    def _live(self) -> list[MotionInProgress]:
        # The callback of an end comes a turn of the event loop later than the end.
        return [one for one in self._motions.values() if not one.ended.done()]


def meeting_question(
    first: Trajectory, second: MotionInProgress, expected_rad: Mapping[str, float]
) -> ConcurrencyQuestion:
    """Return the question to planners if a motion may touch one in progress.

    The whole of the other is asked about, not its rest alone: paused motions can be sent back to where they began.
    """
    moving = {*first.joint_names, *second.trajectory.joint_names}
    others_rad = {name: value for name, value in expected_rad.items() if name not in moving}
    return ConcurrencyQuestion(first, second.trajectory, others_rad)

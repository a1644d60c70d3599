"""Player of one motion on the arm: reports its progress, and ends it when it overruns or the scene gets in its way.

Time limits are counted on the arm's clock: a simulated arm that a busy machine slows down has all its time. A process
that falls silent is ended by :class:`robot.arm.Arm`, and with it the motion.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure, RecheckQuestion
from robot.arm_group import AnyArm
from robot.description.model import RobotModel
from robot.messages import ArmState, MotionEnded, Outcome, PlaybackDirection
from robot.trajectory import Trajectory
from server.execution.monitors import Questions, SceneMonitor
from server.execution.motions import HORIZON_S, SENDING_S, STATE_AGE_S, Positions, SplicePoint, splice_point_of
from server.execution.motions_in_progress import MotionsInProgress
from server.execution.queue import Answer, GoalState, Progress
from server.execution.time_limits import ArmClock, ExecutionDeadline, TimeLimits

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
        """Return the question to planners if the motion is free.

        Args:
            from_s: time of it from which on [s].
            positions_rad: of the joints, of which those of the motion do not count [rad].
        """
        moving = self.trajectory.joint_names
        others_rad = {name: value for name, value in positions_rad.items() if name not in moving}
        return RecheckQuestion(self.group, self.trajectory, others_rad, from_s)


@dataclass(frozen=True)
class OutgoingMotion:
    """Motion that goes on for a moment after its goal was preempted, so that another can replace it.

    Attributes:
        splice_point: the point at which another can replace it; None if there is none.
        until_s: monotonic time by which the other has to be sent [s].
    """

    motion: CheckedMotion
    ended: asyncio.Future[MotionEnded]
    splice_point: SplicePoint | None
    until_s: float


class Player:
    """Player of one motion at a time.

    Attributes:
        outgoing: the motion of a preempted goal; None if there is none.
    """

    def __init__(
        self,
        arm: AnyArm,
        robot: RobotModel,
        scene_monitor: SceneMonitor,
        time_limits: TimeLimits,
        in_progress: MotionsInProgress,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._arm = arm
        self._robot = robot
        self._scene_monitor = scene_monitor
        self._time_limits = time_limits
        self._in_progress = in_progress
        self._clock = clock
        self._motion: asyncio.Future[MotionEnded] | None = None
        self._began_s = self._began_by_arm_s = 0.0
        self._end: Answer | None = None
        self._preempted: asyncio.Future[None] | None = None
        self.outgoing: OutgoingMotion | None = None

    async def play(
        self,
        motion: CheckedMotion,
        report: Callable[[Progress], None],
        questions: Callable[[float], Questions],
        epoch: int,
        from_s: float | None = None,
    ) -> Answer:
        """Play a motion to its end; every wait is bounded.

        Args:
            report: called with its progress.
            questions: asks planners if the motion is free from a time of it on [s].
            from_s: time on the outgoing motion at which this one begins, to replace it [s]; None to begin at rest.
        """
        self._end = None
        self._preempted = asyncio.get_running_loop().create_future()
        self._began_s, self._began_by_arm_s = self._clock(), self._arm.clock_s
        if self.outgoing is None or from_s is None:
            ended = self._arm.execute(motion.trajectory, epoch=epoch)
        else:
            ended = self._arm.execute(motion.trajectory, continues=(self.outgoing.ended, from_s), epoch=epoch)
        self._motion = ended
        self._in_progress.add(motion.trajectory, ended)
        self._scene_monitor.start(
            motion.scene_version, lambda: questions(self._played_s(motion, ended)), self._on_contact
        )
        try:
            return await self._until_ended(ended, self._preempted, motion, report)
        finally:
            self._scene_monitor.stop()
            # The goal is over, and so is its motion, also after an error here; one that is handed over has its own end.
            if not ended.done() and not self._handed_over:
                self._arm.stop(ended)
            self._motion = None

    def stop(self, reason: str) -> None:
        """Brake the motion along its path; do nothing when there is none."""
        self._brake(Answer(MoveItErrorCode.PREEMPTED, reason))
        if self.outgoing is not None:
            self._arm.stop(self.outgoing.ended)

    def preempt(self, reason: str) -> None:
        """End :meth:`play` but not the motion, which is braked unless another soon replaces it."""
        if self._preempted is not None and not self._preempted.done() and self._end is None:
            self._end = Answer(MoveItErrorCode.PREEMPTED, reason)
            self._preempted.set_result(None)

    async def stop_outgoing(self) -> None:
        """Brake the outgoing motion, and wait for its end."""
        outgoing, self.outgoing = self.outgoing, None
        if outgoing is not None and not outgoing.ended.done():
            self._arm.stop(outgoing.ended)
            await self._arm.wait((outgoing.ended,), BRAKING_TIMEOUT_S)

    def _on_contact(self, contact: PlanningFailure) -> None:
        self._brake(Answer.of(contact))

    def _brake(self, end: Answer) -> None:
        if self._motion is not None:
            self._end = self._end or end
            self._arm.stop(self._motion)

    def _played_s(self, motion: CheckedMotion, ended: asyncio.Future[MotionEnded]) -> float:
        """Return the part of the motion that is played for good [s]; on the way back all of it may be played again."""
        progress = self._arm.progress(ended)
        if progress is None or self._just_begun or self._arm.state.pace.direction is PlaybackDirection.BACK:
            return 0.0
        return progress.fraction * motion.trajectory.duration_s

    @property
    def _just_begun(self) -> bool:
        """True while the arm's state may still be of the motion before: it is late where arm or server are starved."""
        passed_s = min(self._clock() - self._began_s, self._arm.clock_s - self._began_by_arm_s)
        return passed_s < STATE_AGE_S

    @property
    def _handed_over(self) -> bool:
        """True when the present motion is the outgoing one."""
        return self.outgoing is not None and self.outgoing.ended is self._motion

    async def _until_ended(
        self,
        ended: asyncio.Future[MotionEnded],
        preempted: asyncio.Future[None],
        motion: CheckedMotion,
        report: Callable[[Progress], None],
    ) -> Answer:
        deadline = ExecutionDeadline(motion.trajectory.duration_s, self._time_limits)
        arm_clock = ArmClock(self._arm, self._clock)
        ends: tuple[asyncio.Future[Any], ...] = (ended, preempted)
        while not ended.done() and deadline.exceeded is None:
            await asyncio.wait(ends, timeout=PROGRESS_PERIOD_S, return_when=asyncio.FIRST_COMPLETED)
            if preempted.done() and not ended.done():
                return self._hand_over(motion, ended)
            progress, pace = self._arm.progress(ended), self._arm.state.pace
            # A motion that the speed limit slows down uses its time up as slowly.
            pace = pace if progress is None else replace(pace, speed_factor=min(pace.speed_factor, progress.rate))
            deadline.pass_time(arm_clock.elapsed_s(), pace)
            if not ended.done() and progress is not None:
                report(Progress(GoalState.EXECUTING, motion.summary, progress.fraction, progress.remaining_s))
        if not ended.done():
            lag = _greatest_lag(self._arm.state, motion.trajectory.joint_names, self._robot)
            self._brake(Answer(MoveItErrorCode.TIMED_OUT, f"{deadline.exceeded}; {lag}"))
            await self._arm.wait((ended,), BRAKING_TIMEOUT_S)
        if not ended.done():
            return Answer(CODE_OF_OUTCOME[Outcome.PROCESS_LOST], f"{deadline.exceeded}, and does not brake either")
        return self._answer(ended.result())

    def _hand_over(self, motion: CheckedMotion, ended: asyncio.Future[MotionEnded]) -> Answer:
        if self._end is None:
            raise AssertionError("a motion is preempted without a reason")
        progress = None if self._just_begun else self._arm.progress(ended)
        point = splice_point_of(motion.trajectory, progress, self._arm.state.pace, self._arm.state_age_s)
        self.outgoing = OutgoingMotion(motion, ended, point, self._clock() + HORIZON_S - SENDING_S)
        # Braked then, whatever becomes of the other motion; one that has been replaced by then is not concerned.
        asyncio.get_running_loop().call_later(HORIZON_S, self._arm.stop, ended)
        return self._end

    def _answer(self, ended: MotionEnded) -> Answer:
        if ended.outcome is not Outcome.STOPPED:
            return Answer(CODE_OF_OUTCOME[ended.outcome], ended.message, {"outcome": ended.outcome.value})
        if self._end is None:
            return Answer(MoveItErrorCode.PREEMPTED, ended.message)
        return Answer(self._end.code, f"{self._end.message}; {ended.message}", self._end.details)


def _greatest_lag(state: ArmState, joints: tuple[str, ...], robot: RobotModel) -> str:
    """Return a sentence that names the joint, of some, that is farthest from its goal."""
    if state.goal_rad is None or state.position_rad is None:
        return "where its joints are is not known"
    error_rad = np.abs(state.goal_rad - state.position_rad)
    lags = {name: float(error_rad[state.joint_names.index(name)]) for name in joints}
    worst = max(lags, key=lambda name: lags[name])
    return f"joint {worst} is {lags[worst]:.3f} {robot.joints[worst].unit} behind"

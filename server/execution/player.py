"""Plays one motion on the arm: tells how it goes, and ends it when it overruns or the scene gets in its way.

What a motion may take is counted on the arm's clock: a simulated arm that a busy machine slows down has all its time. A
process that falls silent is ended by :class:`robot.arm.Arm`, and with it the motion.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure, RecheckQuestion
from robot.arm import Arm
from robot.messages import ArmState, Course, Mode, MotionEnded, Outcome
from robot.trajectory import Trajectory
from server.execution.queue import Answer, GoalState, Progress
from server.execution.scene_monitor import SceneWatch
from server.execution.splicing import HORIZON_S, SENDING_S, STATE_AGE_S, Branch, branch_of
from server.execution.time_limits import Allowance, ArmTime, Patience

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
class Certified:
    """A motion that was found free.

    Attributes:
        group: of its joints, which are all that the group has.
        trajectory: the motion.
        others_rad: position of every other joint [rad].
        scene_version: of the scene in which it was found free.
        summary: how it is called in the news.
    """

    group: str
    trajectory: Trajectory
    others_rad: Mapping[str, float]
    scene_version: int
    summary: str

    def question(self, from_s: float) -> RecheckQuestion:
        """Ask whether it is free from a time of it on [s]."""
        return RecheckQuestion(self.group, self.trajectory, self.others_rad, from_s)


@dataclass(frozen=True)
class Left:
    """A motion that goes on for a moment though its goal has ended: another is to take its place.

    Attributes:
        motion: the motion.
        ended: its one end.
        branch: where the other can leave it; None for nowhere.
        until_s: monotonic time by which the other has to be sent [s].
    """

    motion: Certified
    ended: asyncio.Future[MotionEnded]
    branch: Branch | None
    until_s: float


class Player:
    """Plays one motion at a time.

    Args:
        arm: the arm.
        watch: guards the motion.
        allowance: what a motion may take.
        clock: monotonic time of this machine [s].
    """

    def __init__(
        self, arm: Arm, watch: SceneWatch, allowance: Allowance, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._arm = arm
        self._watch = watch
        self._allowance = allowance
        self._clock = clock
        self._motion: asyncio.Future[MotionEnded] | None = None
        self._began_s = self._began_by_arm_s = 0.0
        self._end: Answer | None = None
        self._leaving: asyncio.Future[None] | None = None
        self.left: Left | None = None

    async def play(self, motion: Certified, report: Callable[[Progress], None], from_s: float | None = None) -> Answer:
        """Play a motion to its end; every wait is bounded.

        Args:
            motion: the motion.
            report: called with how it goes.
            from_s: the time on the motion that was left at which this one begins, to take its place [s]; None to begin
                at rest.
        """
        self._end = None
        self._leaving = asyncio.get_running_loop().create_future()
        self._began_s, self._began_by_arm_s = self._clock(), self._arm.clock_s
        if self.left is None or from_s is None:
            self._motion = self._arm.execute(motion.trajectory)
        else:
            self._motion = self._arm.execute(motion.trajectory, continues=(self.left.ended, from_s))
        self._watch.begin(motion.scene_version, lambda: motion.question(self._from_s(motion)), self._on_contact)
        try:
            return await self._until_ended(self._motion, self._leaving, motion, report)
        finally:
            self._watch.end()
            self._motion = None

    def stop(self, reason: str) -> None:
        """Brake the motion along its path; nothing happens when there is none."""
        self._brake(Answer(MoveItErrorCode.PREEMPTED, reason))
        if self.left is not None:
            self._arm.stop(self.left.ended)

    def leave(self, reason: str) -> None:
        """End :meth:`play` but not the motion, which is braked unless another soon takes its place."""
        if self._leaving is not None and not self._leaving.done() and self._end is None:
            self._end = Answer(MoveItErrorCode.PREEMPTED, reason)
            self._leaving.set_result(None)

    async def rest(self) -> None:
        """Brake a motion that was left, and wait for its end."""
        left, self.left = self.left, None
        if left is not None and not left.ended.done():
            self._arm.stop(left.ended)
            await self._arm.wait((left.ended,), BRAKING_TIMEOUT_S)

    def _on_contact(self, contact: PlanningFailure) -> None:
        self._brake(Answer.of(contact))

    def _brake(self, end: Answer) -> None:
        if self._motion is not None:
            self._end = self._end or end
            self._arm.stop(self._motion)

    def _from_s(self, motion: Certified) -> float:
        """What is behind of the motion [s]; on the way back that may still be to come."""
        state = self._arm.state
        back = state.pace.course is Course.BACK or state.mode is not Mode.MOVING
        return 0.0 if back or self._just_begun else state.fraction * motion.trajectory.duration_s

    @property
    def _just_begun(self) -> bool:
        """Whether the arm's state may still tell of the motion before: it is late where the arm or the server is."""
        passed_s = min(self._clock() - self._began_s, self._arm.clock_s - self._began_by_arm_s)
        return passed_s < STATE_AGE_S

    async def _until_ended(
        self,
        ended: asyncio.Future[MotionEnded],
        leaving: asyncio.Future[None],
        motion: Certified,
        report: Callable[[Progress], None],
    ) -> Answer:
        patience = Patience(motion.trajectory.duration_s, self._allowance)
        arm_time = ArmTime(self._arm, self._clock)
        ends: tuple[asyncio.Future[Any], ...] = (ended, leaving)
        while not ended.done() and patience.end is None:
            await asyncio.wait(ends, timeout=PROGRESS_PERIOD_S, return_when=asyncio.FIRST_COMPLETED)
            if leaving.done() and not ended.done():
                return self._left_behind(motion, ended)
            state = self._arm.state
            patience.pass_time(arm_time.passed_s(), state.pace)
            if not ended.done() and state.mode is Mode.MOVING:
                report(Progress(GoalState.EXECUTING, motion.summary, state.fraction, state.remaining_s))
        if not ended.done():
            self._brake(Answer(MoveItErrorCode.TIMED_OUT, f"{patience.end}; {_lagging(self._arm.state)}"))
            await self._arm.wait((ended,), BRAKING_TIMEOUT_S)
        if not ended.done():
            return Answer(CODE_OF_OUTCOME[Outcome.PROCESS_LOST], f"{patience.end}, and does not brake either")
        return self._answer(ended.result())

    def _left_behind(self, motion: Certified, ended: asyncio.Future[MotionEnded]) -> Answer:
        if self._end is None:
            raise AssertionError("a motion is left for no reason")
        branch = None if self._just_begun else branch_of(motion.trajectory, self._arm.state, self._arm.state_age_s)
        self.left = Left(motion, ended, branch, self._clock() + HORIZON_S - SENDING_S)
        # Whatever becomes of the other motion; one that has ended by then is not concerned.
        asyncio.get_running_loop().call_later(HORIZON_S, self._arm.stop, ended)
        return self._end

    def _answer(self, ended: MotionEnded) -> Answer:
        if ended.outcome is not Outcome.STOPPED:
            return Answer(CODE_OF_OUTCOME[ended.outcome], ended.message, {"outcome": ended.outcome.value})
        if self._end is None:
            return Answer(MoveItErrorCode.PREEMPTED, ended.message)
        return Answer(self._end.code, f"{self._end.message}: {ended.message}", self._end.details)


def _lagging(state: ArmState) -> str:
    """Which joint is farthest from where it should be."""
    if state.goal_rad is None or state.position_rad is None:
        return "where its joints are is not known"
    error_rad = np.abs(state.goal_rad - state.position_rad)
    worst = int(np.argmax(error_rad))
    return f"joint {state.joint_names[worst]} is {error_rad[worst]:.3f} rad behind"

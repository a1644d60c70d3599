"""Player of one motion on the arm: reports its progress, and ends it when it overruns or the scene gets in its way.

Time limits are counted on the arm's clock: a simulated arm that a busy machine slows down has all its time. A process
that falls silent is ended by :class:`robot.arm.Arm`, and with it the motion.

Executor of goals: plans from where the arm holds, plays the plan, reports its progress.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np

from planners.pool import PlannerPool
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem, RecheckQuestion
from planners.scene import Scene
from robot.arm import Arm
from robot.description.model import RobotModel
from robot.messages import ArmState, Course, Mode, MotionEnded, Outcome
from robot.trajectory import Trajectory
from server.errors import RefusedError
from server.execution.failures import Alternatives, FailedGoals
from server.execution.monitors import ARM_START_TIMEOUT_S, CurrentState, SceneMonitor, SceneSource, check_ready
from server.execution.motions import (
    HORIZON_S,
    SENDING_S,
    START_TOLERANCE_RAD,
    STATE_AGE_S,
    ExternalTrajectory,
    Motion,
    PlannedMotion,
    PlannedSequence,
    Positions,
    SplicePoint,
    plan_sequence,
    splice_point_of,
    with_lead_in,
)
from server.execution.queue import Answer, GoalState, Performed, Progress
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
    """Motion that was found free of collisions.

    Attributes:
        group: of its joints, which are all joints of the group.
        trajectory: the motion.
        others_rad: position of every other joint [rad].
        scene_version: of the scene in which it was found free.
        summary: its name in progress reports.
    """

    group: str
    trajectory: Trajectory
    others_rad: Mapping[str, float]
    scene_version: int
    summary: str

    def question(self, from_s: float) -> RecheckQuestion:
        """Return the question to planners if the motion is free from a time of it on [s]."""
        return RecheckQuestion(self.group, self.trajectory, self.others_rad, from_s)


@dataclass(frozen=True)
class OutgoingMotion:
    """Motion that goes on for a moment after its goal was preempted, so that another can replace it.

    Attributes:
        motion: the motion.
        ended: its one end.
        splice_point: the point at which another can replace it; None if there is none.
        until_s: monotonic time by which the other has to be sent [s].
    """

    motion: CheckedMotion
    ended: asyncio.Future[MotionEnded]
    splice_point: SplicePoint | None
    until_s: float


class Player:
    """Player of one motion at a time.

    Args:
        arm: the arm.
        scene_monitor: monitors the motion.
        time_limits: of motions.
        clock: monotonic time of this machine [s].

    Attributes:
        outgoing: the motion of a preempted goal; None if there is none.
    """

    def __init__(
        self,
        arm: Arm,
        scene_monitor: SceneMonitor,
        time_limits: TimeLimits,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._arm = arm
        self._scene_monitor = scene_monitor
        self._time_limits = time_limits
        self._clock = clock
        self._motion: asyncio.Future[MotionEnded] | None = None
        self._began_s = self._began_by_arm_s = 0.0
        self._end: Answer | None = None
        self._preempted: asyncio.Future[None] | None = None
        self.outgoing: OutgoingMotion | None = None

    async def play(
        self, motion: CheckedMotion, report: Callable[[Progress], None], from_s: float | None = None
    ) -> Answer:
        """Play a motion to its end; every wait is bounded.

        Args:
            motion: the motion.
            report: called with its progress.
            from_s: time on the outgoing motion at which this one begins, to replace it [s]; None to begin at rest.
        """
        self._end = None
        self._preempted = asyncio.get_running_loop().create_future()
        self._began_s, self._began_by_arm_s = self._clock(), self._arm.clock_s
        if self.outgoing is None or from_s is None:
            self._motion = self._arm.execute(motion.trajectory)
        else:
            self._motion = self._arm.execute(motion.trajectory, continues=(self.outgoing.ended, from_s))
        self._scene_monitor.start(
            motion.scene_version, lambda: motion.question(self._played_s(motion)), self._on_contact
        )
        try:
            return await self._until_ended(self._motion, self._preempted, motion, report)
        finally:
            self._scene_monitor.stop()
            # The goal is over, and so is its motion, also after an error here; one that is handed over has its own end.
            if not self._motion.done() and not self._handed_over:
                self._arm.stop(self._motion)
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

    def _played_s(self, motion: CheckedMotion) -> float:
        """Return the part of the motion that is played for good [s]; on the way back all of it may be played again."""
        state = self._arm.state
        back = state.pace.course is Course.BACK or state.mode is not Mode.MOVING
        return 0.0 if back or self._just_begun else state.fraction * motion.trajectory.duration_s

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
            state = self._arm.state
            deadline.pass_time(arm_clock.elapsed_s(), state.pace)
            if not ended.done() and state.mode is Mode.MOVING:
                report(Progress(GoalState.EXECUTING, motion.summary, state.fraction, state.remaining_s))
        if not ended.done():
            self._brake(Answer(MoveItErrorCode.TIMED_OUT, f"{deadline.exceeded}; {_greatest_lag(self._arm.state)}"))
            await self._arm.wait((ended,), BRAKING_TIMEOUT_S)
        if not ended.done():
            return Answer(CODE_OF_OUTCOME[Outcome.PROCESS_LOST], f"{deadline.exceeded}, and does not brake either")
        return self._answer(ended.result())

    def _hand_over(self, motion: CheckedMotion, ended: asyncio.Future[MotionEnded]) -> Answer:
        if self._end is None:
            raise AssertionError("a motion is preempted without a reason")
        point = None if self._just_begun else splice_point_of(motion.trajectory, self._arm.state, self._arm.state_age_s)
        self.outgoing = OutgoingMotion(motion, ended, point, self._clock() + HORIZON_S - SENDING_S)
        # Braked then, whatever becomes of the other motion; one that has been replaced by then is not concerned.
        asyncio.get_running_loop().call_later(HORIZON_S, self._arm.stop, ended)
        return self._end

    def _answer(self, ended: MotionEnded) -> Answer:
        if ended.outcome is not Outcome.STOPPED:
            return Answer(CODE_OF_OUTCOME[ended.outcome], ended.message, {"outcome": ended.outcome.value})
        if self._end is None:
            return Answer(MoveItErrorCode.PREEMPTED, ended.message)
        return Answer(self._end.code, f"{self._end.message}: {ended.message}", self._end.details)


def _greatest_lag(state: ArmState) -> str:
    """Return a sentence that names the joint that is farthest from its goal."""
    if state.goal_rad is None or state.position_rad is None:
        return "where its joints are is not known"
    error_rad = np.abs(state.goal_rad - state.position_rad)
    worst = int(np.argmax(error_rad))
    return f"joint {state.joint_names[worst]} is {error_rad[worst]:.3f} rad behind"


log = logging.getLogger("armbridge.execution")

Confirm: TypeAlias = Callable[[], Coroutine[Any, Any, Answer | None]]
Result = TypeVar("Result")

# Codes after which another plan may do better, as in MoveIt's plan_execution.
REPLANNED = (
    MoveItErrorCode.PLANNING_FAILED,
    MoveItErrorCode.INVALID_MOTION_PLAN,
    MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE,
)

# Limit of plans when the arm is moved again and again while a motion is being planned.
MAX_STARTS = 3

# An arm that is steered comes to rest in half a second.
STREAMS_TIMEOUT_S = 2.0

# No scene has this version: an external trajectory is checked before it begins.
UNCHECKED = -1

# Durations in refusals, and the remedy for motions that planners time by the scalings.
GIVEN_DURATION = "the duration of the trajectory"
PLANNED_DURATION = "the duration of the planned motion"
FASTER = ": raise the velocity and acceleration scaling"

# Ten minutes at 50 Hz; of a longer motion the beginning is kept.
MAX_SAMPLES = 30_000


class MotionRecorder:
    """Recorder of the arm's states while a motion runs."""

    def __init__(self) -> None:
        self._states: list[ArmState] | None = None

    def start(self) -> None:
        """Start a new recording."""
        self._states = []

    def take_state(self, state: ArmState) -> None:
        """Record a state of the arm, while a motion runs."""
        if self._states is None or state.position_rad is None or state.velocity_rad_s is None:
            return
        if len(self._states) < MAX_SAMPLES and (not self._states or state.stamp_s > self._states[-1].stamp_s):
            self._states.append(state)

    def finish(self, joint_names: tuple[str, ...]) -> Trajectory | None:
        """End the recording; return the trajectory of these joints, or None when no state came.

        The servos measure no accelerations: those are 0.
        """
        states, self._states = self._states, None
        if not states:
            return None
        columns = [states[0].joint_names.index(name) for name in joint_names]
        time_s = np.array([state.stamp_s for state in states]) - states[0].stamp_s
        positions_rad = np.array([state.position_rad for state in states])[:, columns]
        velocities_rad_s = np.array([state.velocity_rad_s for state in states])[:, columns]
        return Trajectory(joint_names, time_s, positions_rad, velocities_rad_s, np.zeros_like(positions_rad))


class GoalExecutor:
    """Executor of one goal at a time, from its motion to its answer.

    Args:
        arm: the arm.
        robot: its description.
        pool: the planners.
        scene: the planning scene.
        failed_goals: keeps goals that could not be planned; None to keep none.
        show: called with every plan before it is executed.
        confirm: waits for a user's confirmation of a plan; returns None to execute it, else the goal's answer.
        time_limits: of motions.

    Attributes:
        recorder: records the arm's states for the answers.
    """

    def __init__(
        self,
        arm: Arm,
        robot: RobotModel,
        pool: PlannerPool,
        scene: SceneSource,
        failed_goals: FailedGoals | None = None,
        show: Callable[[Performed], None] = lambda _performed: None,
        confirm: Confirm | None = None,
        time_limits: TimeLimits | None = None,
    ) -> None:
        self._arm = arm
        self._robot = robot
        self._pool = pool
        self._scene = scene
        self._failed_goals = failed_goals
        self._show = show
        self._confirm = confirm
        self._current = CurrentState(arm, robot)
        self._alternatives = Alternatives(robot, pool)
        self._scene_monitor = SceneMonitor(pool, scene, arm.state_max_age_s)
        self.recorder = MotionRecorder()
        self._time_limits = time_limits or TimeLimits()
        self._player = Player(arm, self._scene_monitor, self._time_limits)
        self._work: asyncio.Task[Any] | None = None
        self._cancel_reason = ""

    # Methods for the queue.

    async def run(self, request: Motion, report: Callable[[Progress], None]) -> Answer:
        """Plan and play a motion; every wait is bounded, and every way out is an answer."""
        self._cancel_reason = ""
        match request:
            case ExternalTrajectory():
                return await _answered(self._play_external(request, report))
            case PlannedMotion():
                return await self._plan_and_play(request, report)

    def cancel(self, reason: str) -> None:
        """Cancel the active goal."""
        self._cancel_work(reason)
        self._player.stop(reason)

    def preempt(self, reason: str) -> None:
        """End the active goal for one that follows at once, which may replace its motion without a stop."""
        self._cancel_work(reason)
        self._player.preempt(reason)

    def stop(self, reason: str) -> None:
        """Cancel the active goal; the arm is stopped even when no goal is known, so that nothing keeps it moving."""
        self.cancel(reason)
        self._arm.stop()

    def _cancel_work(self, reason: str) -> None:
        self._cancel_reason = reason
        if self._work is not None:
            self._work.cancel()

    # Attempts: from a motion to an answer.

    async def _plan_and_play(self, request: PlannedMotion, report: Callable[[Progress], None]) -> Answer:
        answer = await self._replace_outgoing(request, report) or await _answered(self._attempt(request, report))
        for _ in range(request.attempts - 1):
            if self._cancel_reason or answer.code not in REPLANNED:
                break
            report(Progress(GoalState.PLANNING, f"planning anew: {answer.message}"))
            await self._unless_cancelled(asyncio.sleep(request.delay_s))
            answer = await _answered(self._attempt(request, report))
        return answer

    async def _replace_outgoing(self, request: PlannedMotion, report: Callable[[Progress], None]) -> Answer | None:
        """Replace the motion of a preempted goal without a stop; None where that is impossible."""
        outgoing = self._player.outgoing
        if outgoing is None or outgoing.splice_point is None or outgoing.ended.done():
            return None
        if len(request.steps) != 1 or request.scene is not None or request.confirm:
            return None
        point, scene = outgoing.splice_point, self._scene.scene
        try:
            problem = request.steps[0]({**self._held_rad(), **point.positions_rad})
        except RefusedError:
            return None
        if not isinstance(problem, PlanningProblem) or problem.group != outgoing.motion.group:
            return None
        report(Progress(GoalState.PLANNING, "; ".join(("planning in motion", *request.warnings))))
        moving = replace(problem, start_velocity_rad_s=point.velocities_rad_s)
        asking = asyncio.wait_for(self._pool.ask(moving, scene), outgoing.until_s - time.monotonic())
        plan = await self._unless_cancelled(_in_time(asking))
        if not isinstance(plan, Plan) or plan.trajectory.duration_s > self._time_limits.trajectory_s:
            return None
        whole = replace(plan, trajectory=point.splice(plan.trajectory))
        planned = PlannedSequence(Performed({**problem.start_rad, **point.start_rad})).with_plan(whole)
        self._show_soon(planned)
        report(Progress(GoalState.EXECUTING, planned.summary, 0.0, planned.duration_s))
        self.recorder.start()
        # A scene that has changed since the lead was found free is checked on the way.
        version = scene.version if scene.version == outgoing.motion.scene_version else UNCHECKED
        checked = CheckedMotion(problem.group, whole.trajectory, outgoing.motion.others_rad, version, planned.summary)
        answer = await self._player.play(checked, report, point.from_s)
        executed = self.recorder.finish(whole.trajectory.joint_names)
        if answer.details.get("outcome") == Outcome.REFUSED.value:
            return None
        return replace(answer, performed=replace(planned.performed, executed=executed))

    async def _attempt(self, request: PlannedMotion, report: Callable[[Progress], None]) -> Answer:
        await self._until_ready()
        report(Progress(GoalState.PLANNING, "; ".join(("planning", *request.warnings))))
        version = self._scene.scene.version
        planned = await self._plan(request)
        if planned.failure is not None:
            return Answer.of(planned.failure, planned.performed)
        self._time_limits.check_duration(planned.duration_s, PLANNED_DURATION, MoveItErrorCode.FAILURE, FASTER)
        self._show_soon(planned)
        discarded = await self._confirmed(planned, report) if request.confirm else None
        return discarded or await self._play(planned, version, report)

    async def _play_external(self, request: ExternalTrajectory, report: Callable[[Progress], None]) -> Answer:
        await self._until_ready()
        held_rad = self._held_rad()
        motion = request.trajectory(held_rad)
        self._time_limits.check_duration(motion.duration_s, GIVEN_DURATION, MoveItErrorCode.INVALID_MOTION_PLAN)
        planned = PlannedSequence(Performed(held_rad, (motion,)), ("as given",))
        self._show_soon(planned)
        return await self._play(planned, UNCHECKED, report)

    # Steps of an attempt.

    async def _until_ready(self) -> None:
        """Wait until a motion can begin; a client that steers the arm by velocities has to give way to a goal.

        Raises:
            RefusedError: none can begin, or the goal was cancelled.
        """
        await self._player.stop_outgoing()
        # A goal that comes while the server starts waits for the arm.
        await self._unless_cancelled(self._arm.until_started(ARM_START_TIMEOUT_S))
        self._check_not_cancelled("before the motion began")
        check_ready(self._arm)
        if not await self._arm.end_streams(STREAMS_TIMEOUT_S):
            message = f"the arm is being steered and did not come to rest within {STREAMS_TIMEOUT_S:g} s"
            raise RefusedError(PlanningFailure(MoveItErrorCode.CONTROL_FAILED, message))

    async def _plan(self, request: PlannedMotion) -> PlannedSequence:
        """Plan from where the arm holds, and anew when it was moved meanwhile.

        Raises:
            RefusedError: there is no such scene, or the goal was cancelled.
        """
        planned = None
        for _ in range(MAX_STARTS):
            held_rad = self._held_rad()
            scene = self._scene.scene if request.scene is None else request.scene(held_rad)
            planned = await self._unless_cancelled(plan_sequence(request.steps, held_rad, scene, self._pool.ask))
            if planned is None:
                break
            if planned.failure is not None:
                await self._save(planned, scene)
                return await self._with_alternative(planned, planned.failure, scene)
            if not self._moved_since(held_rad):
                break
        if planned is None:
            raise _preempted(f"{self._cancel_reason} while planning")
        return planned

    async def _with_alternative(
        self, planned: PlannedSequence, failure: PlanningFailure, scene: Scene
    ) -> PlannedSequence:
        added = await self._unless_cancelled(self._alternatives.add_to(failure, planned.problem, scene))
        return planned if added is None else replace(planned, failure=added)

    async def _save(self, planned: PlannedSequence, scene: Scene) -> None:
        problem, failure = planned.problem, planned.failure
        if self._failed_goals is None or failure is None or not isinstance(problem, PlanningProblem):
            return
        if failure.code is not MoveItErrorCode.PREEMPTED:
            await self._failed_goals.save(problem, scene, failure)

    def _show_soon(self, planned: PlannedSequence) -> None:
        """Show a plan when the arm has it: to write one down for viewers takes milliseconds."""
        asyncio.get_running_loop().call_soon(self._show, planned.performed)

    async def _confirmed(self, planned: PlannedSequence, report: Callable[[Progress], None]) -> Answer | None:
        """Wait for the confirmation of a plan; return None when it is given, or the goal was cancelled."""
        if self._confirm is None:
            return None
        report(Progress(GoalState.PLANNED, f"{planned.summary}; waits to be confirmed", 0.0, planned.duration_s))
        answer = await self._unless_cancelled(self._confirm())
        return None if answer is None else replace(answer, performed=planned.performed)

    async def _play(self, planned: PlannedSequence, version: int, report: Callable[[Progress], None]) -> Answer:
        """Play the motions one after the other.

        Args:
            planned: the motions.
            version: of the scene in which they were planned.
            report: called with the progress.
        """
        motions = planned.performed.planned
        answer = Answer(MoveItErrorCode.SUCCESS, "the arm was there already")
        report(Progress(GoalState.EXECUTING, planned.summary, 0.0, planned.duration_s))
        self.recorder.start()
        to_come_s = planned.duration_s
        for motion in motions:
            to_come_s -= motion.duration_s
            if motion.duration_s > 0.0 and answer.code is MoveItErrorCode.SUCCESS:
                playing = self._play_one(motion, version, planned.summary, _with_more_to_come(report, to_come_s))
                answer = await _answered(playing)
        executed = self.recorder.finish(motions[0].joint_names if motions else ())
        message = "; ".join((answer.message, *planned.notes))
        return replace(answer, message=message, performed=replace(planned.performed, executed=executed))

    async def _play_one(
        self, motion: Trajectory, version: int, summary: str, report: Callable[[Progress], None]
    ) -> Answer:
        held_rad = self._held_rad()
        whole = with_lead_in(motion, held_rad, self._robot)
        group = _group_of(self._robot, whole)
        others_rad = {name: value for name, value in held_rad.items() if name not in whole.joint_names}
        present_version = self._scene.scene.version
        checked = CheckedMotion(group, whole, others_rad, present_version, summary)
        if whole is not motion or present_version != version:
            await self._unless_cancelled(self._scene_monitor.check(lambda: checked.question(0.0)))
        self._check_not_cancelled("before the motion began")
        return await self._player.play(checked, report)

    # Positions, and the end of the active goal.

    def _held_rad(self) -> dict[str, float]:
        """Return the positions that the arm holds, not those it droops to: a motion then starts without a step."""
        held_rad = self._current.positions_rad()
        if held_rad is None:
            raise AssertionError("planning without a connected arm")
        return held_rad

    def _moved_since(self, before_rad: Positions) -> bool:
        return any(abs(value - before_rad[name]) > START_TOLERANCE_RAD for name, value in self._held_rad().items())

    def _check_not_cancelled(self, phase: str) -> None:
        if self._cancel_reason:
            raise _preempted(f"{self._cancel_reason} {phase}")

    async def _unless_cancelled(self, work: Coroutine[Any, Any, Result]) -> Result | None:
        """Wait for some work; return None when the goal is cancelled before or meanwhile."""
        if self._cancel_reason:
            work.close()
            return None
        self._work = asyncio.create_task(work, name="active goal")
        try:
            await asyncio.wait([self._work])
        finally:
            # Reached with the work still going on only when the server itself is being ended.
            self._work.cancel()
        return None if self._work.cancelled() else self._work.result()


async def _answered(attempt: Awaitable[Answer]) -> Answer:
    """Return the answer of an attempt; a refusal on the way is the answer as well."""
    try:
        return await attempt
    except RefusedError as error:
        return Answer.of(error.failure)


def _with_more_to_come(report: Callable[[Progress], None], to_come_s: float) -> Callable[[Progress], None]:
    """Return the report of one motion of a sequence, whose time left is that of the sequence.

    Args:
        report: of the sequence.
        to_come_s: duration of the motions after this one [s].
    """
    return lambda progress: report(replace(progress, remaining_s=progress.remaining_s + to_come_s))


async def _in_time(asking: Coroutine[Any, Any, Result]) -> Result | None:
    """Return the result of some work that is bounded, None when it takes too long."""
    try:
        return await asking
    except TimeoutError:
        return None


def _preempted(message: str) -> RefusedError:
    return RefusedError(PlanningFailure(MoveItErrorCode.PREEMPTED, message))


def _group_of(robot: RobotModel, motion: Trajectory) -> str:
    """Return the group that has just these joints; empty when there is none, and planners then reject it."""
    return next((name for name, group in robot.groups.items() if group.joints == motion.joint_names), "")

"""Executor of goals: plans from where the arm holds, plays the plan, reports its progress, and looks at the scene.

Goals of groups without a common joint are executed at the same time. A motion begins once its path is clear of every
motion of another group; else it waits for the other's end. A motion ends when it overruns, by the arm's clock, or when
the scene gets in its way.
"""

import asyncio
import contextlib
import functools
import logging
import statistics
from collections import deque
from collections.abc import Awaitable, Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from planners.interface import Planners
from planners.problem import (
    ConcurrencyQuestion,
    MoveItErrorCode,
    Plan,
    PlanningFailure,
    PlanningProblem,
    RecheckAnswer,
    RecheckQuestion,
)
from robot.arm import Splice
from robot.arm_group import AnyArm
from robot.description.model import RobotModel
from robot.messages import ArmState, MotionEnded, Outcome, PlaybackDirection
from robot.trajectory import PERIOD_S, Trajectory
from server.errors import RefusedError, refused
from server.execution.confirmation import Confirmation
from server.execution.failures import with_nearest_goal
from server.execution.goal import BRAKING_TIMEOUT_S, Answer, Goal, GoalState, MotionWatch, Progress, TimeLimits
from server.execution.monitors import ARM_START_TIMEOUT_S, CurrentScene, CurrentState, check_ready
from server.execution.motions import (
    HORIZON_S,
    OUTGOING_S,
    SENDING_S,
    SENDINGS_S,
    START_TOLERANCE_RAD,
    STATE_AGE_S,
    ExternalTrajectory,
    Joints,
    MotionInProgress,
    MotionsInProgress,
    PathTime,
    Performed,
    PlannedMotion,
    Positions,
    SplicePoint,
    plan_sequence,
    splice_point_of,
    with_lead_in,
)

log = logging.getLogger("armbridge.execution")

# Asked together about one motion: it is free if all answers are.
Questions: TypeAlias = Sequence[RecheckQuestion | ConcurrencyQuestion]

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

# A trajectory is expected at the arm after this multiple of the time that recent checks took: the first attempt by the
# median, which no busy moment lengthens, and the second where a check fits between two ticks; others by the longest.
CHECKS_AHEAD, RECENT_CHECKS = 1.1, 5

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
class ExecutionContext:
    """Parts that the executors of all goals share."""

    robot: RobotModel
    pool: Planners
    scene_state: CurrentScene
    current: CurrentState
    confirmation: Confirmation
    clock: Callable[[], float]
    time_limits: TimeLimits = field(default_factory=TimeLimits)
    show: Callable[[Performed], None] = lambda _performed: None  # called with every plan before it is executed


@dataclass(eq=False)
class PlayedMotion:
    """Motion that the arm plays, found free in a version of the scene; a preempted goal's goes on for a moment."""

    trajectory: Trajectory
    version: int
    ended: asyncio.Future[MotionEnded]
    path_time: PathTime
    end: Answer | None = None  # answer of a motion that is braked
    checking: asyncio.Task[None] | None = None  # task that checks it after changes of the scene
    until_s: float = 0.0  # time until which another motion can be sent to replace it


class GoalExecutor:
    """Executor of one goal at a time, from its motion to its answer."""

    def __init__(self, arm: AnyArm, context: ExecutionContext, in_progress: MotionsInProgress) -> None:
        self._arm = arm
        self._context, self._scene, self._clock = context, context.scene_state, context.clock
        self._in_progress = in_progress
        # The motion in progress, and the motion of a preempted goal, which another can replace.
        self._played: PlayedMotion | None = None
        self._outgoing: PlayedMotion | None = None
        self._scene.on_change(self._check_again)
        # Times that recent checks of trajectories in motion took [s]; the first is checked within the horizon.
        self._checks_s = deque(((HORIZON_S - SENDING_S) / CHECKS_AHEAD,), RECENT_CHECKS)

    async def run(self, goal: Goal) -> Answer:
        """Plan and play the motion of a goal; every wait is bounded, and every way out is an answer."""
        motion = goal.request.motion
        if goal.replaced:
            # The outgoing motion is left to the goal that comes next.
            return Answer(MoveItErrorCode.PREEMPTED, f"{goal.reason} before the motion began")
        if isinstance(motion, PlannedMotion):
            answer = await self._replace_outgoing(goal, motion) or await _answered(self._attempt(goal, motion))
            for _ in range(motion.attempts - 1):
                if goal.reason or answer.code not in REPLANNED:
                    break
                goal.report(Progress(GoalState.PLANNING, f"planning again: {answer.message}"))
                await goal.unless_cancelled(asyncio.sleep(motion.delay_s))
                answer = await _answered(self._attempt(goal, motion))
            return answer
        if motion is None:
            raise AssertionError("a rejected goal was queued")
        # An external trajectory is played up to a first contact where it may be cut.
        while True:
            answer = await _answered(self._play_external(goal, motion))
            if goal.reason or motion.cut is None:
                break
            shorter = motion.cut(PlanningFailure(answer.code, answer.message, answer.details))
            if shorter is None:
                break
            motion = shorter
        if answer.code is not MoveItErrorCode.SUCCESS and not goal.replaced:
            # Nothing takes the place of the motion before.
            await self._stop_outgoing()
        return answer

    # Attempts: from a motion to an answer.

    async def _replace_outgoing(self, goal: Goal, request: PlannedMotion) -> Answer | None:
        """Replace the motion of a preempted goal without a stop; None where that is impossible."""
        outgoing, point = self._outgoing, self._splice_point(self._clock(), HORIZON_S)
        if outgoing is None or point is None:
            return None
        if len(request.steps) != 1 or request.scene is not None or request.confirm:
            return None
        # There is no time to check contacts with another motion in progress.
        if self._in_progress.beside(request.joints):
            return None
        scene = self._scene.scene
        try:
            problem = request.steps[0]({**self._held_rad(), **point.positions_rad})
        except RefusedError:
            return None
        if not isinstance(problem, PlanningProblem):
            return None
        if self._context.robot.groups[problem.group].joints != outgoing.trajectory.joint_names:
            return None
        goal.report(Progress(GoalState.PLANNING, "; ".join(("planning in motion", *request.warnings))))
        moving = replace(problem, start_velocity_rad_s=point.velocities_rad_s)

        async def plan_in_time() -> object:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(HORIZON_S - SENDING_S):
                    return await self._context.pool.ask(moving, scene)
            return None

        plan = await goal.unless_cancelled(plan_in_time())
        if goal.reason or not isinstance(plan, Plan) or plan.trajectory.duration_s > goal.deadline.limits.trajectory_s:
            return None
        whole = replace(plan, trajectory=point.lead.then(plan.trajectory))
        start_rad = {**problem.start_rad, **point.start_rad}
        planned = Performed(start_rad, scene=scene).with_plan(problem, whole)
        # A scene that has changed since the lead was found free is checked on the way.
        version = scene.version if scene.version == outgoing.version else UNCHECKED
        return await self._play_spliced(goal, planned, version, point)

    async def _play_spliced(self, goal: Goal, planned: Performed, version: int, point: SplicePoint) -> Answer | None:
        """Play a motion in the place of the outgoing one; None where the arm has passed the splice point."""
        self._show_soon(planned)
        [motion] = planned.planned
        answer = await self._play(goal, motion, version, planned.summary, point=point)
        if answer.details.get("outcome") == Outcome.REFUSED.value:
            return None
        return replace(answer, performed=planned)

    async def _attempt(self, goal: Goal, request: PlannedMotion) -> Answer:
        try:
            await self._until_ready(goal)
            goal.report(Progress(GoalState.PLANNING, "; ".join(("planning", *request.warnings))))
            version = self._scene.scene.version
            planned = await self._plan(goal, request)
            if planned.failure is not None:
                return Answer.of(planned.failure, planned)
            goal.deadline.limits.check_duration(planned.duration_s, PLANNED_DURATION, MoveItErrorCode.FAILURE, FASTER)
            self._show_soon(planned)
            discarded = await self._confirmed(goal, planned) if request.confirm else None
            return discarded or await self._play_all(goal, planned, version)
        finally:
            self._in_progress.withdraw(request.joints)

    async def _splice_external(self, goal: Goal, request: ExternalTrajectory) -> Answer | None:
        """Have a trajectory take over from the setpoints of the motion of a preempted goal; None if that is impossible.

        As in ros2_control's joint_trajectory_controller ("Trajectory Replacement"), except that the whole is checked
        before, which takes some milliseconds: it takes over that much later.
        """
        for attempt, sending_s in enumerate(SENDINGS_S):
            asked_s, version = self._clock(), self._scene.scene.version
            brief = attempt == 0 or (attempt == 1 and self._checks_s[-1] < PERIOD_S)
            check_s = statistics.median_low(self._checks_s) if brief else max(self._checks_s)
            horizon_s = sending_s + CHECKS_AHEAD * check_s
            if goal.reason or (joined := self._joined(goal, request, asked_s, horizon_s)) is None:
                break
            whole, point, arrives_s, passes_s = joined
            planned = Performed({**self._held_rad(), **point.start_rad}, (whole,))
            goal.defer_replacement()
            await goal.unless_cancelled(self._check(functools.partial(self._questions, whole)))
            self._checks_s.append(self._clock() - asked_s)
            # A late point may still be ahead of the arm's last tick; the arm refuses a point that is not. Where another
            # goal waits, that goal would continue a motion that the arm has refused.
            latest_s = arrives_s - sending_s if goal.successor else passes_s
            if self._clock() <= latest_s and not goal.reason:
                answer = await self._play_spliced(goal, planned, version, point)
                if answer is not None:
                    return answer
            # The arm has passed the point by now: the next point is further ahead.
        return None

    def _joined(
        self, goal: Goal, request: ExternalTrajectory, now_s: float, horizon_s: float
    ) -> tuple[Trajectory, SplicePoint, float, float] | None:
        """Return a trajectory behind its lead, the splice point, the expected and the latest arrival; else None."""
        outgoing = self._outgoing
        if outgoing is None or not request.spliced:
            return None
        if frozenset(outgoing.trajectory.joint_names) != request.joints:
            return None
        arrives_s = min(outgoing.path_time.clear_of_tick(now_s + horizon_s), outgoing.until_s)
        leaves_s = outgoing.path_time.earliest_leave_s(arrives_s)
        point = self._splice_point(now_s, leaves_s - now_s)
        if point is None or arrives_s <= now_s:
            return None
        whole = point.lead.then(request.trajectory({**self._held_rad(), **point.positions_rad}, leaves_s, point))
        goal.deadline.limits.check_duration(whole.duration_s, GIVEN_DURATION, MoveItErrorCode.INVALID_MOTION_PLAN)
        return whole, point, arrives_s, outgoing.path_time.passes_s(arrives_s)

    async def _play_external(self, goal: Goal, request: ExternalTrajectory) -> Answer:
        if (answer := await self._splice_external(goal, request)) is not None:
            return answer
        await self._until_ready(goal)
        held_rad = self._held_rad()
        motion = request.trajectory(held_rad, self._clock(), None)
        goal.deadline.limits.check_duration(motion.duration_s, GIVEN_DURATION, MoveItErrorCode.INVALID_MOTION_PLAN)
        planned = Performed(held_rad, (motion,))
        self._show_soon(planned)
        goal.defer_replacement()
        return await self._play_all(goal, planned, UNCHECKED)

    # Steps of an attempt.

    async def _until_ready(self, goal: Goal) -> None:
        """Wait until a motion can begin; a client that steers the arm by velocities has to give way to a goal."""
        await self._stop_outgoing()
        # Motions of preempted goals of other groups with some of the same joints.
        preempted = [motion.ended for motion in self._in_progress.sharing(goal.request.joints)]
        for ended in preempted:
            self._arm.stop(ended)
        await self._arm.wait(preempted, BRAKING_TIMEOUT_S)
        # A goal that comes while the server starts waits for the arm.
        await goal.unless_cancelled(self._arm.until_started(ARM_START_TIMEOUT_S))
        goal.check("before the motion began")
        check_ready(self._arm)
        if not await self._arm.end_streams(STREAMS_TIMEOUT_S):
            message = f"the arm is being steered and did not come to rest within {STREAMS_TIMEOUT_S:g} s"
            raise refused(MoveItErrorCode.CONTROL_FAILED, message)

    async def _plan(self, goal: Goal, request: PlannedMotion) -> Performed:
        """Plan from where the arm holds, and again when it was moved meanwhile.

        Other groups may be moving: they are planned for at the end of their motions.
        """
        planned = None
        for _ in range(MAX_STARTS):
            self._in_progress.withdraw(request.joints)
            planned = await goal.unless_cancelled(self._plan_in_turn(request))
            if planned is None:
                break
            if planned.failure is not None:
                explaining = with_nearest_goal(planned.failure, planned.problem, planned.scene, self._context.pool)
                return replace(planned, failure=await goal.unless_cancelled(explaining) or planned.failure)
            if not self._moved_since(planned.start_rad, request.joints):
                break
        if planned is None:
            goal.check("while planning")
            raise AssertionError("a plan is missing")
        return planned

    async def _plan_in_turn(self, request: PlannedMotion) -> Performed:
        """Plan after the goals of other groups that came before."""
        async with self._in_progress.turn:
            start_rad = self._expected_rad(request.joints)
            scene = self._scene.scene if request.scene is None else request.scene(start_rad)
            planned = await plan_sequence(request.steps, start_rad, scene, self._context.pool)
            if planned.failure is None:
                self._in_progress.announce(request.joints, planned.end_rad)
            return planned

    def _show_soon(self, planned: Performed) -> None:
        """Show a plan when the arm has it: to write one down for viewers takes milliseconds."""
        asyncio.get_running_loop().call_soon(self._context.show, planned)

    async def _confirmed(self, goal: Goal, planned: Performed) -> Answer | None:
        answer = await goal.unless_cancelled(self._context.confirmation.wait(goal, planned))
        goal.check("before the motion began")
        return None if answer is None else replace(answer, performed=planned)

    async def _play_all(self, goal: Goal, planned: Performed, version: int) -> Answer:
        answer = Answer(MoveItErrorCode.SUCCESS, "the arm was there already")
        to_come_s = planned.duration_s
        for motion in planned.planned:
            to_come_s -= motion.duration_s
            if motion.duration_s > 0.0 and answer.code is MoveItErrorCode.SUCCESS:
                answer = await _answered(self._play_one(goal, motion, planned, version, to_come_s))
        return replace(answer, message="; ".join((answer.message, *planned.notes)), performed=planned)

    async def _play_one(
        self, goal: Goal, motion: Trajectory, planned: Performed, version: int, to_come_s: float
    ) -> Answer:
        """Play one of the motions, once its path is clear of every motion of another group."""
        joints = frozenset(motion.joint_names)
        # Positions of the other joints that the plan assumes.
        assumed_rad = {name: q for name, q in planned.start_rad.items() if name not in joints}
        while True:
            whole = with_lead_in(motion, self._held_rad(), self._context.robot)
            present_version, beside = self._scene.scene.version, self._in_progress.beside(joints)
            if whole is not motion or present_version != version or self._moved_since(assumed_rad, joints):
                await goal.unless_cancelled(self._check(functools.partial(self._questions, whole, alone=True)))
            in_the_way = await goal.unless_cancelled(self._first_meeting(whole, beside))
            goal.check("before the motion began")
            if in_the_way is not None:
                goal.allow_replacement()
                goal.report(Progress(GoalState.PLANNED, f"waits for {in_the_way.title}, which it might touch"))
                await goal.unless_cancelled(asyncio.wait([in_the_way.ended]))
            elif all(other in beside for other in self._in_progress.beside(joints)):
                return await self._play(goal, whole, present_version, planned.summary, to_come_s=to_come_s)

    async def _first_meeting(self, motion: Trajectory, beside: Sequence[MotionInProgress]) -> MotionInProgress | None:
        for other in beside:
            answer = await self._context.pool.ask(self._meeting_question(motion, other), self._scene.scene)
            if isinstance(answer, PlanningFailure):
                message = f"contact with {other.title} cannot be checked: {answer.message}"
                raise refused(MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE, message, **answer.details)
            if answer.contact is not None:
                log.info("waits for %s: %s", other.title, answer.contact.message)
                return other
        return None

    # One motion.

    async def _play(
        self,
        goal: Goal,
        motion: Trajectory,
        version: int,
        summary: str,
        *,
        point: SplicePoint | None = None,
        to_come_s: float = 0.0,
    ) -> Answer:
        """Play a motion, found free in a version of the scene, to its end; every wait is bounded.

        Where the goal is cancelled the motion brakes along its path. Where another goal replaces it, the motion goes on
        for a moment, and brakes unless the other motion has taken its place by then.

        Args:
            point: splice point at which the motion replaces the outgoing one; None to begin at rest.
            to_come_s: duration of the goal's motions after this one [s].
        """
        outgoing, now_s, continues = self._outgoing, self._clock(), None
        path_time = PathTime(now_s, 0.0, self._arm.rate)
        if outgoing is not None and point is not None:
            continues = Splice(outgoing.ended, point.from_s, point.leaves_s)
            path_time = PathTime(now_s, outgoing.path_time.at(now_s) - point.from_s, outgoing.path_time.rate)
        ended = self._arm.execute(motion, continues=continues, epoch=goal.epoch)
        goal.allow_replacement()
        self._in_progress.add(motion, ended)
        played = self._played = PlayedMotion(motion, version, ended, path_time)
        self._check_again()
        try:
            return await self._until_ended(goal, played, summary, to_come_s)
        finally:
            self._played = None
            if played.checking is not None:
                played.checking.cancel()
            # The goal is over, and so is its motion, also after an error here; an outgoing motion has its own end.
            if not ended.done() and self._outgoing is not played:
                self._arm.stop(ended)

    async def _until_ended(self, goal: Goal, played: PlayedMotion, summary: str, to_come_s: float) -> Answer:
        motion, ended = played.trajectory, played.ended
        goal.deadline.begin(motion.duration_s)
        # Not before the arm has the motion: listeners take milliseconds, in which it would pass the splice point.
        goal.report(Progress(GoalState.EXECUTING, summary, 0.0, motion.duration_s + to_come_s))
        watch = MotionWatch(self._arm, ended, goal, self._clock)
        period_s, shown_by_s = PROGRESS_PERIOD_S, self._clock() + STATE_AGE_S
        while not watch.over:
            progress = await watch.step(period_s)
            if goal.replaced and progress is None and not ended.done() and self._clock() < shown_by_s:
                # The arm may yet refuse it, and its place on the path is not known to a tick.
                period_s = PERIOD_S
                continue
            if goal.reason and played.end is None:
                if goal.replaced and not ended.done():
                    played.path_time, played.until_s = self._path_time(played), self._clock() + OUTGOING_S - SENDING_S
                    self._outgoing = played
                    # Braked then, whatever becomes of the other motion; a motion that was replaced by then goes on.
                    asyncio.get_running_loop().call_later(OUTGOING_S, self._arm.stop, ended)
                    return Answer(MoveItErrorCode.PREEMPTED, goal.reason)
                played.end = Answer(MoveItErrorCode.PREEMPTED, goal.reason)
            if progress is not None:
                left_s = progress.remaining_s + to_come_s
                goal.report(Progress(GoalState.EXECUTING, summary, progress.fraction, left_s))
        if not ended.done():
            lag = _greatest_lag(self._arm.state, motion.joint_names, self._context.robot)
            played.end = played.end or Answer(MoveItErrorCode.TIMED_OUT, f"{goal.deadline.exceeded}; {lag}")
        end = await watch.end()
        if end.outcome is not Outcome.STOPPED:
            return Answer(CODE_OF_OUTCOME[end.outcome], end.message, {"outcome": end.outcome.value})
        if played.end is None:
            return Answer(MoveItErrorCode.PREEMPTED, end.message)
        return replace(played.end, message=f"{played.end.message}; {end.message}")

    async def _stop_outgoing(self) -> None:
        outgoing, self._outgoing = self._outgoing, None
        if outgoing is not None and not outgoing.ended.done():
            self._arm.stop(outgoing.ended)
            await self._arm.wait((outgoing.ended,), BRAKING_TIMEOUT_S)

    def _splice_point(self, now_s: float, horizon_s: float) -> SplicePoint | None:
        """Return the point, so far ahead [s], at which another motion can replace the outgoing one; else None."""
        outgoing = self._outgoing
        if outgoing is None or outgoing.ended.done():
            return None
        return splice_point_of(outgoing.trajectory, outgoing.path_time, now_s, horizon_s)

    def _path_time(self, played: PlayedMotion) -> PathTime:
        """Return the time on the path by the arm's latest state, or since the beginning, which it does not show yet."""
        progress, pace, now_s = self._arm.progress(played.ended), self._arm.state.pace, self._clock()
        rate = self._arm.rate * (pace.speed_factor if pace.direction is PlaybackDirection.FORWARD else 0.0)
        if progress is None:
            return PathTime(now_s, played.path_time.at(now_s), min(rate, played.path_time.rate))
        rate = min(rate, self._arm.rate * progress.rate)
        path_s = progress.fraction * played.trajectory.duration_s
        if (tick_s := self._arm.state.tick_s) and self._arm.rate == 1.0:
            return PathTime(tick_s, path_s, rate, at_tick=True)
        return PathTime(now_s, path_s + self._arm.state_age_s * rate, rate)

    # Contacts.

    def _check_again(self) -> None:
        """Check the rest of the motion in progress if the scene has changed."""
        played = self._played
        if played is not None and played.checking is None and played.version != self._scene.scene.version:
            played.checking = asyncio.create_task(self._check_changes(played), name="check the rest of the motion")

    async def _check_changes(self, played: PlayedMotion) -> None:
        """Check until the scene no longer changes meanwhile; brake the motion unless it is free."""
        try:
            while played.version != self._scene.scene.version:
                played.version = await self._check(lambda: self._questions(played.trajectory, self._done_s(played)))
        except RefusedError as error:
            log.warning("the scene has changed: %s", error)
            played.end = played.end or Answer.of(error.failure)
            self._arm.stop(played.ended)
        else:
            played.checking = None

    async def _check(self, questions: Callable[[], Questions]) -> int:
        """Raise RefusedError unless a motion is free; return the version of the scene in which it is.

        Planners that do not answer in time are asked again for as long as the arm may be silent: a busy machine keeps
        both from the cores.
        """
        until_s = self._clock() + self._arm.state_max_age_s
        while True:
            scene = self._scene.scene
            answer: RecheckAnswer | PlanningFailure = RecheckAnswer(None)
            for question in questions():
                answer = await self._context.pool.ask(question, scene)
                if isinstance(answer, PlanningFailure) or answer.contact is not None:
                    break
            late = isinstance(answer, PlanningFailure) and answer.code is MoveItErrorCode.TIMED_OUT
            if not late or self._clock() >= until_s:
                break
        if isinstance(answer, PlanningFailure):
            message = f"the motion cannot be checked for contacts: {answer.message}"
            raise refused(MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE, message, **answer.details)
        if answer.contact is not None:
            raise RefusedError(answer.contact)
        return scene.version

    def _done_s(self, played: PlayedMotion) -> float:
        """Return the part of a motion that is not played again [s]; on the way back all of it may be."""
        progress = self._arm.progress(played.ended)
        if progress is None or self._arm.state.pace.direction is PlaybackDirection.BACK:
            return 0.0
        return progress.fraction * played.trajectory.duration_s

    def _questions(self, motion: Trajectory, from_s: float = 0.0, *, alone: bool = False) -> Questions:
        """Return the questions about the contacts of a motion from one of its times on [s].

        They are about the scene and, unless it is asked about ``alone``, about each motion beside it.
        """
        joints, groups = motion.joint_names, self._context.robot.groups
        # Planners reject the empty group of joints that no group has.
        group = next((name for name, group in groups.items() if group.joints == joints), "")
        rest = RecheckQuestion(group, motion, self._others_rad(joints, joints), from_s)
        beside = () if alone else self._in_progress.beside(frozenset(joints))
        return rest, *(self._meeting_question(motion, other) for other in beside)

    def _meeting_question(self, motion: Trajectory, other: MotionInProgress) -> ConcurrencyQuestion:
        """Return the question whether a motion may touch another in progress.

        It is about the whole of the other, not its rest alone: paused motions can be sent back to where they began.
        """
        moving = (*motion.joint_names, *other.trajectory.joint_names)
        return ConcurrencyQuestion(motion, other.trajectory, self._others_rad(motion.joint_names, moving))

    def _others_rad(self, joints: Sequence[str], moving: Sequence[str]) -> dict[str, float]:
        """Return where the joints that do not move are expected during a motion of some joints [rad]."""
        return {name: q for name, q in self._expected_rad(frozenset(joints)).items() if name not in moving}

    # Positions.

    def _held_rad(self) -> dict[str, float]:
        """Return the positions that the arm holds, not those it droops to: a motion then starts without a step."""
        held_rad = self._context.current.positions_rad()
        if held_rad is None:
            # This arm is connected by now: another arm is not.
            message = "joint positions of another arm unknown: it was not connected yet"
            raise refused(MoveItErrorCode.ROBOT_STATE_STALE, message)
        return held_rad

    def _expected_rad(self, joints: Joints) -> dict[str, float]:
        """Return the positions that some joints hold, and that the others will hold when their motions end [rad]."""
        return self._in_progress.expected_rad(self._held_rad(), joints)

    def _moved_since(self, before_rad: Positions, joints: Joints) -> bool:
        """Return true if a joint is expected elsewhere than before; arguments as for :meth:`_expected_rad`."""
        now_rad = self._expected_rad(joints)
        return any(abs(value - now_rad[name]) > START_TOLERANCE_RAD for name, value in before_rad.items())


async def _answered(attempt: Awaitable[Answer]) -> Answer:
    try:
        return await attempt
    except RefusedError as error:
        return Answer.of(error.failure)


def _greatest_lag(state: ArmState, joints: tuple[str, ...], robot: RobotModel) -> str:
    if state.goal_rad is None or state.position_rad is None:
        return "its joint positions are unknown"
    error_rad = np.abs(state.goal_rad - state.position_rad)
    lags = {name: float(error_rad[state.joint_names.index(name)]) for name in joints}
    worst = max(lags, key=lambda name: lags[name])
    return f"joint {worst} is {lags[worst]:.3f} {robot.joints[worst].unit} behind"


class GoalExecutors:
    """Executors of goals: one for each set of joints, so that a goal can replace the motion of the one before."""

    def __init__(self, arm: AnyArm, context: ExecutionContext) -> None:
        self._arm = arm
        self._context = context
        self.time_limits = context.time_limits
        self.in_progress = MotionsInProgress()
        self._executors: dict[Joints, GoalExecutor] = {}

    def executor(self, joints: Joints) -> GoalExecutor:
        if joints not in self._executors:
            self._executors[joints] = GoalExecutor(self._arm.part(joints), self._context, self.in_progress)
        return self._executors[joints]

    def last_stop(self, joints: Joints) -> int:
        return self._arm.part(joints).last_stop

    def stop(self, joints: Iterable[str] | None = None) -> None:
        """Stop the arms that have some joints, even when no goal is known, so that nothing keeps them moving."""
        stopped = self._arm if joints is None else self._arm.part(frozenset(joints))
        stopped.stop()

    def brake(self) -> None:
        """Bring all arms to rest, also motions of no goal."""
        self._arm.brake()

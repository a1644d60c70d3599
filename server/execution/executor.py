"""Executor of goals: plans from where the arm holds, plays the plan, reports its progress.

Goals of groups without a common joint are executed at the same time. A motion begins when it can touch no motion of
another group, wherever each of both is on its way; else it waits for the other's end.
"""

import asyncio
import functools
import logging
import statistics
import time
from array import array
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np

from planners.interface import Planners
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.scene import Scene
from robot.arm_group import AnyArm
from robot.control.pacing import PERIOD_S
from robot.description.model import RobotModel
from robot.messages import ArmState, Outcome
from robot.trajectory import Trajectory
from server.errors import RefusedError, refused
from server.execution.failures import FailedGoals, with_nearest_goal
from server.execution.goal import Answer, Goal, GoalState, Progress, TimeLimits
from server.execution.monitors import (
    ARM_START_TIMEOUT_S,
    CurrentScene,
    CurrentState,
    Questions,
    SceneMonitor,
    check_ready,
)
from server.execution.motions import (
    HORIZON_S,
    SENDING_S,
    SENDINGS_S,
    START_TOLERANCE_RAD,
    ExternalTrajectory,
    Joints,
    Performed,
    PlannedMotion,
    PlannedSequence,
    Positions,
    SplicePoint,
    plan_sequence,
    with_lead_in,
)
from server.execution.player import (
    BRAKING_TIMEOUT_S,
    CheckedMotion,
    MotionInProgress,
    MotionsInProgress,
    Player,
    meeting_question,
)

log = logging.getLogger("armbridge.execution")

Confirm: TypeAlias = Callable[[Goal, PlannedSequence], Coroutine[Any, Any, Answer | None]]
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

# A trajectory is expected at the arm after this multiple of the time that recent checks took: the first attempt by the
# median, which no busy moment lengthens, and the second where a check fits between two ticks; others by the longest.
CHECKS_AHEAD, RECENT_CHECKS = 1.1, 5

# Ten minutes at 50 Hz; of a longer motion the beginning is kept.
MAX_SAMPLES = 30_000


class MotionRecorder:
    """Recorder of the arm's states while a motion runs, with times of the arm's clock."""

    def __init__(self) -> None:
        self._joint_names: tuple[str, ...] = ()
        # Of each state its time, positions and velocities, written down at once: at the end of a long motion that would
        # hold the event loop up.
        self._samples: array[float] | None = None

    def start(self) -> None:
        self._samples = array("d")

    def take_state(self, state: ArmState) -> None:
        if self._samples is None or state.position_rad is None or state.velocity_rad_s is None:
            return
        width = 1 + 2 * len(state.joint_names)
        if len(self._samples) < MAX_SAMPLES * width and (not self._samples or state.clock_s > self._samples[-width]):
            self._joint_names = state.joint_names
            self._samples.extend((state.clock_s, *state.position_rad.tolist(), *state.velocity_rad_s.tolist()))

    def discard(self) -> None:
        """End the recording without a trajectory."""
        self._samples = None

    def finish(self, joint_names: tuple[str, ...]) -> Trajectory | None:
        """End the recording; return the trajectory of these joints, or None when no state came.

        The servos measure no accelerations: those are 0.
        """
        samples, self._samples = self._samples, None
        if not samples:
            return None
        times, positions, velocities = np.split(
            np.array(samples).reshape(-1, 1 + 2 * len(self._joint_names)), (1, 1 + len(self._joint_names)), axis=1
        )
        columns = [self._joint_names.index(name) for name in joint_names]
        positions_rad, velocities_rad_s = positions[:, columns], velocities[:, columns]
        time_s = times[:, 0] - times[0]
        return Trajectory(joint_names, time_s, positions_rad, velocities_rad_s, np.zeros_like(positions_rad))


@dataclass(frozen=True)
class ExecutionContext:
    """Parts that the executors of all goals share."""

    robot: RobotModel
    pool: Planners
    scene: CurrentScene
    current: CurrentState
    time_limits: TimeLimits = field(default_factory=TimeLimits)
    failed_goals: FailedGoals | None = None  # keeps goals that could not be planned; None to keep none
    show: Callable[[Performed], None] = lambda _performed: None  # called with every plan before it is executed
    # Reports that a plan waits, and waits for a user's confirmation; returns None to execute the plan, else the goal's
    # answer.
    confirm: Confirm | None = None
    clock: Callable[[], float] = time.monotonic


class GoalExecutor:
    """Executor of one goal at a time, from its motion to its answer."""

    def __init__(self, arm: AnyArm, context: ExecutionContext, in_progress: MotionsInProgress) -> None:
        self._arm = arm
        self._context, self._scene = context, context.scene
        self._in_progress = in_progress
        self._scene_monitor = SceneMonitor(context.pool, context.scene, arm.state_max_age_s, context.clock)
        self.recorder = MotionRecorder()
        self._player = Player(arm, context.robot, self._scene_monitor, in_progress, context.clock)
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
            await self._player.stop_outgoing()
        return answer

    # Attempts: from a motion to an answer.

    async def _replace_outgoing(self, goal: Goal, request: PlannedMotion) -> Answer | None:
        """Replace the motion of a preempted goal without a stop; None where that is impossible."""
        outgoing = self._player.outgoing
        point = None if outgoing is None else outgoing.splice_point(self._context.clock(), HORIZON_S)
        if outgoing is None or point is None:
            return None
        if len(request.steps) != 1 or request.scene is not None or request.confirm:
            return None
        # There is no time to check contacts with another motion in progress.
        if self._in_progress.beside(request.joints):
            return None
        scene = self._scene.scene
        try:
            problem = request.steps[0].problem({**self._held_rad(), **point.positions_rad})
        except RefusedError:
            return None
        if not isinstance(problem, PlanningProblem) or problem.group != outgoing.motion.group:
            return None
        goal.report(Progress(GoalState.PLANNING, "; ".join(("planning in motion", *request.warnings))))
        moving = replace(problem, start_velocity_rad_s=point.velocities_rad_s)
        ask = functools.partial(self._context.pool.ask, moving, scene)
        plan = await goal.unless_cancelled(_in_time(ask, HORIZON_S - SENDING_S))
        if goal.reason or not isinstance(plan, Plan) or plan.trajectory.duration_s > goal.deadline.limits.trajectory_s:
            return None
        whole = replace(plan, trajectory=point.splice(plan.trajectory))
        planned = PlannedSequence(Performed({**problem.start_rad, **point.start_rad})).with_plan(whole)
        # A scene that has changed since the lead was found free is checked on the way.
        version = scene.version if scene.version == outgoing.motion.scene_version else UNCHECKED
        checked = CheckedMotion(problem.group, whole.trajectory, version, planned.summary)
        return await self._play_spliced(goal, planned, checked, point)

    async def _play_spliced(
        self, goal: Goal, planned: PlannedSequence, motion: CheckedMotion, point: SplicePoint
    ) -> Answer | None:
        """Play a motion in the place of the outgoing one; None where the arm has passed the splice point."""
        self._show_soon(planned)
        self.recorder.start()
        answer = await self._player.play(goal, motion, self._questions(motion), from_s=point.from_s)
        executed = None
        if goal.unlogged:
            # Nobody asks for the states of a motion in a stream.
            self.recorder.discard()
        else:
            executed = self.recorder.finish(motion.trajectory.joint_names)
        if answer.details.get("outcome") == Outcome.REFUSED.value:
            return None
        return replace(answer, performed=replace(planned.performed, executed=executed))

    async def _attempt(self, goal: Goal, request: PlannedMotion) -> Answer:
        try:
            await self._until_ready(goal)
            goal.report(Progress(GoalState.PLANNING, "; ".join(("planning", *request.warnings))))
            version = self._scene.scene.version
            planned = await self._plan(goal, request)
            if planned.failure is not None:
                return Answer.of(planned.failure, planned.performed)
            goal.deadline.limits.check_duration(planned.duration_s, PLANNED_DURATION, MoveItErrorCode.FAILURE, FASTER)
            self._show_soon(planned)
            discarded = await self._confirmed(goal, planned) if request.confirm else None
            return discarded or await self._play(goal, planned, version)
        finally:
            self._in_progress.withdraw(request.joints)

    async def _splice_external(self, goal: Goal, request: ExternalTrajectory) -> Answer | None:
        """Have a trajectory take over from the setpoints of the motion of a preempted goal; None if that is impossible.

        As in ros2_control's joint_trajectory_controller ("Trajectory Replacement"), except that the whole is checked
        before, which takes some milliseconds: it takes over that much later.
        """
        for attempt, sending_s in enumerate(SENDINGS_S):
            asked_s, version = self._context.clock(), self._scene.scene.version
            brief = attempt == 0 or (attempt == 1 and self._checks_s[-1] < PERIOD_S)
            check_s = statistics.median_low(self._checks_s) if brief else max(self._checks_s)
            horizon_s = sending_s + CHECKS_AHEAD * check_s
            if goal.reason or (joined := self._joined(goal, request, asked_s, horizon_s)) is None:
                break
            whole, point, arrives_s, passes_s = joined
            planned = PlannedSequence(Performed({**self._held_rad(), **point.start_rad}, (whole,)))
            checked = CheckedMotion(_group_of(self._context.robot, whole), whole, version, planned.summary)
            goal.defer_replacement()
            await goal.unless_cancelled(self._scene_monitor.check(functools.partial(self._questions(checked), 0.0)))
            self._checks_s.append(self._context.clock() - asked_s)
            # The arm compares the point with its last tick, so that a late one may still be ahead; it refuses others.
            # Where another goal waits, that goal would continue a motion that the arm has refused.
            latest_s = arrives_s - sending_s if goal.replacement_waits else passes_s
            if self._context.clock() <= latest_s and not goal.reason:
                answer = await self._play_spliced(goal, planned, checked, point)
                if answer is not None:
                    return answer
            # The arm has passed the point, or will have: the next point is further ahead.
        return None

    def _joined(
        self, goal: Goal, request: ExternalTrajectory, now_s: float, horizon_s: float
    ) -> tuple[Trajectory, SplicePoint, float, float] | None:
        """Return a trajectory behind its lead, the splice point, the expected and the latest arrival; else None."""
        outgoing = self._player.outgoing
        if outgoing is None or not request.spliced:
            return None
        if frozenset(outgoing.motion.trajectory.joint_names) != request.joints:
            return None
        arrives_s = min(now_s + horizon_s, outgoing.until_s)
        leaves_s = outgoing.path_time.earliest_leave_s(arrives_s)
        point = outgoing.splice_point(now_s, leaves_s - now_s)
        if point is None or arrives_s <= now_s:
            return None
        whole = point.splice(request.trajectory({**self._held_rad(), **point.positions_rad}, leaves_s, point))
        goal.deadline.limits.check_duration(whole.duration_s, GIVEN_DURATION, MoveItErrorCode.INVALID_MOTION_PLAN)
        return whole, point, arrives_s, outgoing.path_time.passes_s(arrives_s)

    async def _play_external(self, goal: Goal, request: ExternalTrajectory) -> Answer:
        if (answer := await self._splice_external(goal, request)) is not None:
            return answer
        await self._until_ready(goal)
        held_rad = self._held_rad()
        motion = request.trajectory(held_rad, self._context.clock(), None)
        goal.deadline.limits.check_duration(motion.duration_s, GIVEN_DURATION, MoveItErrorCode.INVALID_MOTION_PLAN)
        planned = PlannedSequence(Performed(held_rad, (motion,)))
        self._show_soon(planned)
        goal.defer_replacement()
        return await self._play(goal, planned, UNCHECKED)

    # Steps of an attempt.

    async def _until_ready(self, goal: Goal) -> None:
        """Wait until a motion can begin; a client that steers the arm by velocities has to give way to a goal."""
        await self._player.stop_outgoing()
        # Motions of preempted goals of other groups with some of the same joints.
        preempted = [motion.ended for motion in self._in_progress.of(goal.request.joints)]
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

    async def _plan(self, goal: Goal, request: PlannedMotion) -> PlannedSequence:
        """Plan from where the arm holds, and again when it was moved meanwhile.

        Other groups may be moving: they are planned for at the end of their motions.
        """
        found = planned = None
        for _ in range(MAX_STARTS):
            self._in_progress.withdraw(request.joints)
            found = await goal.unless_cancelled(self._plan_in_turn(request))
            if found is None:
                break
            planned, scene = found
            if planned.failure is not None:
                await self._save(planned, scene)
                explaining = with_nearest_goal(planned.failure, planned.problem, scene, self._context.pool)
                return replace(planned, failure=await goal.unless_cancelled(explaining) or planned.failure)
            if not self._moved_since(planned.performed.start_rad, request.joints):
                break
        if found is None or planned is None:
            goal.check("while planning")
            raise AssertionError("a plan is missing")
        return planned

    async def _plan_in_turn(self, request: PlannedMotion) -> tuple[PlannedSequence, Scene]:
        """Plan after the goals of other groups that came before; return the scene as well."""
        async with self._in_progress.turn:
            start_rad = self._expected_rad(request.joints)
            scene = self._scene.scene if request.scene is None else request.scene(start_rad)
            planned = await plan_sequence(request.steps, start_rad, scene, self._context.pool)
            if planned.failure is None:
                self._in_progress.announce(request.joints, planned.end_rad)
            return planned, scene

    async def _save(self, planned: PlannedSequence, scene: Scene) -> None:
        problem, failure = planned.problem, planned.failure
        if self._context.failed_goals is None or failure is None or not isinstance(problem, PlanningProblem):
            return
        if failure.code is not MoveItErrorCode.PREEMPTED:
            await self._context.failed_goals.save(problem, scene, failure)

    def _show_soon(self, planned: PlannedSequence) -> None:
        """Show a plan when the arm has it: to write one down for viewers takes milliseconds."""
        asyncio.get_running_loop().call_soon(self._context.show, planned.performed)

    async def _confirmed(self, goal: Goal, planned: PlannedSequence) -> Answer | None:
        if self._context.confirm is None:
            return None
        answer = await goal.unless_cancelled(self._context.confirm(goal, planned))
        goal.check("before the motion began")
        return None if answer is None else replace(answer, performed=planned.performed)

    async def _play(self, goal: Goal, planned: PlannedSequence, version: int) -> Answer:
        motions = planned.performed.planned
        answer = Answer(MoveItErrorCode.SUCCESS, "the arm was there already")
        self.recorder.start()
        to_come_s = planned.duration_s
        for motion in motions:
            to_come_s -= motion.duration_s
            if motion.duration_s > 0.0 and answer.code is MoveItErrorCode.SUCCESS:
                answer = await _answered(self._play_one(goal, motion, planned, version, to_come_s))
        executed = self.recorder.finish(motions[0].joint_names if motions else ())
        message = "; ".join((answer.message, *planned.notes))
        return replace(answer, message=message, performed=replace(planned.performed, executed=executed))

    async def _play_one(
        self, goal: Goal, motion: Trajectory, planned: PlannedSequence, version: int, to_come_s: float
    ) -> Answer:
        """Play one of the motions, as soon as it can touch no motion of another group."""
        joints = frozenset(motion.joint_names)
        # Where the other joints were to be while it was planned.
        assumed_rad = {name: q for name, q in planned.performed.start_rad.items() if name not in joints}
        while True:
            whole = with_lead_in(motion, self._held_rad(), self._context.robot)
            present_version, beside = self._scene.scene.version, self._in_progress.beside(joints)
            checked = CheckedMotion(_group_of(self._context.robot, whole), whole, present_version, planned.summary)
            if whole is not motion or present_version != version or self._moved_since(assumed_rad, joints):
                question = checked.question(0.0, self._expected_rad(joints))
                await goal.unless_cancelled(self._scene_monitor.check(functools.partial(tuple, (question,))))
            in_the_way = await goal.unless_cancelled(self._first_meeting(whole, beside))
            goal.check("before the motion began")
            if in_the_way is not None:
                goal.allow_replacement()
                goal.report(Progress(GoalState.PLANNED, f"waits for {in_the_way.title}, which it might touch"))
                await goal.unless_cancelled(asyncio.wait([in_the_way.ended]))
            elif all(one in beside for one in self._in_progress.beside(joints)):
                return await self._player.play(goal, checked, self._questions(checked), to_come_s=to_come_s)

    async def _first_meeting(self, motion: Trajectory, beside: Sequence[MotionInProgress]) -> MotionInProgress | None:
        for other in beside:
            question = meeting_question(motion, other, self._expected_rad(frozenset(motion.joint_names)))
            answer = await self._context.pool.ask(question, self._scene.scene)
            if isinstance(answer, PlanningFailure):
                message = f"contact with {other.title} cannot be checked: {answer.message}"
                raise refused(MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE, message, **answer.details)
            if answer.contact is not None:
                log.info("waits for %s: %s", other.title, answer.contact.message)
                return other
        return None

    def _questions(self, motion: CheckedMotion) -> Callable[[float], Questions]:
        """Return the function that asks if a motion is free from a time of it on, also of motions beside it."""

        def questions(from_s: float) -> Questions:
            joints = frozenset(motion.trajectory.joint_names)
            expected_rad, beside = self._expected_rad(joints), self._in_progress.beside(joints)
            meetings = (meeting_question(motion.trajectory, other, expected_rad) for other in beside)
            return motion.question(from_s, expected_rad), *meetings

        return questions

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


async def _in_time(work: Callable[[], Awaitable[Result]], limit_s: float) -> Result | None:
    """Return the result of some work, None when it takes longer than the limit [s]; it begins when this is awaited."""
    try:
        return await asyncio.wait_for(work(), limit_s)
    except TimeoutError:
        return None


def _group_of(robot: RobotModel, motion: Trajectory) -> str:
    """Return the group that has just these joints; empty when there is none, and planners then reject it."""
    return next((name for name, group in robot.groups.items() if group.joints == motion.joint_names), "")


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

    def take_state(self, state: ArmState) -> None:
        for executor in self._executors.values():
            executor.recorder.take_state(state)

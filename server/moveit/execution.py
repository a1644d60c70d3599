"""Carries a goal out: plans from where the arm holds, plays the plan, tells how it goes."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any, TypeAlias, TypeVar

from planners.pool import PlannerPool
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.scene import Scene
from robot.arm import Arm
from robot.description.model import RobotModel
from robot.messages import Outcome
from robot.trajectory import Trajectory
from server.goal_queue import Answer, GoalState, Performed, Progress
from server.moveit.alternatives import Alternatives
from server.moveit.current_state import CurrentState
from server.moveit.failed_goals import FailedGoals
from server.moveit.motions import GivenMotion, Motion, PlannedMotion, Positions
from server.moveit.patience import Allowance
from server.moveit.playing import Certified, Player
from server.moveit.readiness import ARM_START_TIMEOUT_S, unusable
from server.moveit.recorder import Recorder
from server.moveit.scene_watch import SceneWatch, WatchedScene
from server.moveit.step_planning import Planned, plan_steps
from server.moveit.stitching import STITCH_TOLERANCE_RAD, stitched

log = logging.getLogger("armbridge.execution")

Confirm: TypeAlias = Callable[[], Coroutine[Any, Any, Answer | None]]
End = TypeVar("End")

# Ends after which another plan may do better, as MoveIt's plan_execution sees it.
PLANNED_ANEW = (
    MoveItErrorCode.PLANNING_FAILED,
    MoveItErrorCode.INVALID_MOTION_PLAN,
    MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE,
)

# Somebody moves the arm again and again while a motion is being planned.
MAX_STARTS = 3

# An arm that is steered comes to rest in half a second.
STREAMS_TIMEOUT_S = 2.0

# No scene has this version: a motion that somebody else has planned is looked at before it begins.
NEVER_SEEN = -1


class GoalExecutor:
    """Runs one goal at a time, from request to answer.

    Args:
        arm: the arm.
        robot: its description.
        pool: the planners.
        scene: the planning scene.
        failed_goals: keeps those that could not be planned, or None.
        show: called with every plan before it is carried out.
        confirm: waits for the word on a plan; gives None to carry it out, else the goal's answer.
        allowance: what motions may take.
    """

    def __init__(
        self,
        arm: Arm,
        robot: RobotModel,
        pool: PlannerPool,
        scene: WatchedScene,
        failed_goals: FailedGoals | None = None,
        show: Callable[[Performed], None] = lambda _performed: None,
        confirm: Confirm | None = None,
        allowance: Allowance | None = None,
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
        self._watch = SceneWatch(pool, scene, arm.state_max_age_s)
        self.recorder = Recorder()
        self._player = Player(arm, self._watch, allowance or Allowance())
        self._work: asyncio.Task[Any] | None = None
        self._end_reason = ""

    async def run(self, request: Motion, report: Callable[[Progress], None]) -> Answer:
        """Plan and play; every wait is bounded, and every way out is an answer."""
        self._end_reason = ""
        match request:
            case GivenMotion():
                return await self._follow(request, report)
            case PlannedMotion():
                return await self._plan_and_play(request, report)

    def end(self, reason: str) -> None:
        """End the goal in hand."""
        self._end_reason = reason
        if self._work is not None:
            self._work.cancel()
        self._player.stop(reason)

    def give_way(self, reason: str) -> None:
        """End the goal in hand for one that follows at once, which may go on from its motion."""
        self._end_reason = reason
        if self._work is not None:
            self._work.cancel()
        self._player.leave(reason)

    def stop(self, reason: str) -> None:
        """End the goal in hand; the arm is told even when no goal is known, so that nothing can keep it moving."""
        self.end(reason)
        self._arm.stop()

    async def _plan_and_play(self, request: PlannedMotion, report: Callable[[Progress], None]) -> Answer:
        answer = await self._go_on(request, report) or await self._attempt(request, report)
        for _ in range(request.attempts - 1):
            if self._end_reason or answer.code not in PLANNED_ANEW:
                break
            report(Progress(GoalState.PLANNING, f"planning anew: {answer.message}"))
            await self._unless_ended(asyncio.sleep(request.delay_s))
            answer = await self._attempt(request, report)
        return answer

    async def _go_on(self, request: PlannedMotion, report: Callable[[Progress], None]) -> Answer | None:
        """Go over into the motion from one that gave way to it, without a stop; None where that cannot be."""
        left = self._player.left
        if left is None or left.branch is None or left.ended.done():
            return None
        if len(request.steps) != 1 or request.scene is not None or request.confirm:
            return None
        branch, scene = left.branch, self._scene.scene
        problem = request.steps[0]({**self._held_rad(), **branch.positions_rad})
        if not isinstance(problem, PlanningProblem) or problem.group != left.motion.group:
            return None
        report(Progress(GoalState.PLANNING, "; ".join(("planning in motion", *request.warnings))))
        moving = replace(problem, start_velocity_rad_s=branch.velocities_rad_s)
        asking = asyncio.wait_for(self._pool.ask(moving, scene), left.until_s - time.monotonic())
        plan = await self._unless_ended(_in_time(asking))
        if not isinstance(plan, Plan):
            return None
        whole = replace(plan, trajectory=branch.into(plan.trajectory))
        planned = Planned(Performed({**problem.start_rad, **branch.start_rad})).with_plan(whole)
        self._show_soon(planned)
        report(Progress(GoalState.EXECUTING, planned.summary, 0.0, planned.duration_s))
        self.recorder.start()
        # A scene that has changed since the lead was found free is looked at on the way.
        seen = scene.version if scene.version == left.motion.scene_version else NEVER_SEEN
        certified = Certified(problem.group, whole.trajectory, left.motion.others_rad, seen, planned.summary)
        answer = await self._player.play(certified, report, branch.from_s)
        executed = self.recorder.finish(whole.trajectory.joint_names)
        if answer.details.get("outcome") == Outcome.REFUSED.value:
            return None
        return replace(answer, performed=replace(planned.performed, executed=executed))

    async def _attempt(self, request: PlannedMotion, report: Callable[[Progress], None]) -> Answer:
        failure = await self._not_ready()
        if failure is not None:
            return Answer.of(failure)
        report(Progress(GoalState.PLANNING, "; ".join(("planning", *request.warnings))))
        seen = self._scene.scene.version
        planned = await self._plan(request)
        if planned is None:
            return Answer(MoveItErrorCode.PREEMPTED, f"{self._end_reason} while planning")
        if isinstance(planned, PlanningFailure):
            return Answer.of(planned)
        if planned.failure is not None:
            return Answer.of(planned.failure, planned.performed)
        self._show_soon(planned)
        discarded = await self._discarded(planned, report) if request.confirm else None
        return discarded or await self._carry_out(planned, seen, report)

    def _show_soon(self, planned: Planned) -> None:
        """Show a plan when the arm has it: to write one down for viewers takes milliseconds."""
        asyncio.get_running_loop().call_soon(self._show, planned.performed)

    async def _discarded(self, planned: Planned, report: Callable[[Progress], None]) -> Answer | None:
        """Wait for the word on a plan; None when it is to be carried out, or the goal was ended."""
        if self._confirm is None:
            return None
        report(Progress(GoalState.PLANNED, f"{planned.summary}; waits to be confirmed", 0.0, planned.duration_s))
        answer = await self._unless_ended(self._confirm())
        return None if answer is None else replace(answer, performed=planned.performed)

    async def _plan(self, request: PlannedMotion) -> Planned | PlanningFailure | None:
        """Plan from where the arm holds, and anew when it was moved meanwhile; None when the goal was ended."""
        planned: Planned | None = None
        for _ in range(MAX_STARTS):
            held_rad = self._held_rad()
            scene = self._scene.scene if request.scene is None else request.scene(held_rad)
            if isinstance(scene, PlanningFailure):
                return scene
            planned = await self._unless_ended(plan_steps(request.steps, held_rad, scene, self._pool.ask))
            if planned is None:
                return None
            if planned.failure is not None:
                await self._save(planned, scene)
                return await self._with_alternative(planned, planned.failure, scene)
            if not self._moved_since(held_rad):
                return planned
        return planned

    async def _with_alternative(self, planned: Planned, failure: PlanningFailure, scene: Scene) -> Planned:
        added = await self._unless_ended(self._alternatives.added(failure, planned.problem, scene))
        return planned if added is None else replace(planned, failure=added)

    async def _save(self, planned: Planned, scene: Scene) -> None:
        problem, failure = planned.problem, planned.failure
        if self._failed_goals is None or failure is None or not isinstance(problem, PlanningProblem):
            return
        if failure.code is not MoveItErrorCode.PREEMPTED:
            await self._failed_goals.save(problem, scene, failure)

    async def _follow(self, request: GivenMotion, report: Callable[[Progress], None]) -> Answer:
        failure = await self._not_ready()
        if failure is not None:
            return Answer.of(failure)
        held_rad = self._held_rad()
        motion = request.trajectory(held_rad)
        if isinstance(motion, PlanningFailure):
            return Answer.of(motion)
        planned = Planned(Performed(held_rad, (motion,)), ("as given",))
        self._show_soon(planned)
        return await self._carry_out(planned, NEVER_SEEN, report)

    async def _carry_out(self, planned: Planned, seen: int, report: Callable[[Progress], None]) -> Answer:
        motions = planned.performed.planned
        answer = Answer(MoveItErrorCode.SUCCESS, "the arm was there already")
        report(Progress(GoalState.EXECUTING, planned.summary, 0.0, planned.duration_s))
        self.recorder.start()
        for motion in motions:
            if motion.duration_s > 0.0 and answer.code is MoveItErrorCode.SUCCESS:
                answer = await self._carry_one_out(motion, seen, planned.summary, report)
        executed = self.recorder.finish(motions[0].joint_names if motions else ())
        message = "; ".join((answer.message, *planned.notes))
        return replace(answer, message=message, performed=replace(planned.performed, executed=executed))

    async def _carry_one_out(
        self, motion: Trajectory, seen: int, summary: str, report: Callable[[Progress], None]
    ) -> Answer:
        held_rad = self._held_rad()
        whole = stitched(motion, held_rad, self._robot)
        if isinstance(whole, PlanningFailure):
            return Answer.of(whole)
        group = _group_of(self._robot, whole)
        others_rad = {name: value for name, value in held_rad.items() if name not in whole.joint_names}
        now_seen = self._scene.scene.version
        certified = Certified(group, whole, others_rad, now_seen, summary)
        if whole is not motion or now_seen != seen:
            contact = await self._unless_ended(self._watch.look(lambda: certified.question(0.0)))
            if contact is not None:
                return Answer.of(contact)
        if self._end_reason:
            return Answer(MoveItErrorCode.PREEMPTED, f"{self._end_reason} before the motion began")
        return await self._player.play(certified, report)

    async def _not_ready(self) -> PlanningFailure | None:
        """Why no motion can begin; who steers the arm by velocities has to give way to a goal."""
        await self._player.rest()
        # A goal that comes while the server starts waits for the arm.
        await self._unless_ended(self._arm.until_started(ARM_START_TIMEOUT_S))
        if self._end_reason:
            return PlanningFailure(MoveItErrorCode.PREEMPTED, f"{self._end_reason} before the motion began")
        failure = unusable(self._arm)
        if failure is None and not await self._arm.end_streams(STREAMS_TIMEOUT_S):
            message = f"the arm is being steered and did not come to rest within {STREAMS_TIMEOUT_S:g} s"
            return PlanningFailure(MoveItErrorCode.CONTROL_FAILED, message)
        return failure

    def _held_rad(self) -> dict[str, float]:
        """What the arm holds, not where it droops to: the motion then starts without a step."""
        held_rad = self._current.positions_rad()
        if held_rad is None:
            raise AssertionError("planning without a connected arm")
        return held_rad

    def _moved_since(self, before_rad: Positions) -> bool:
        return any(abs(value - before_rad[name]) > STITCH_TOLERANCE_RAD for name, value in self._held_rad().items())

    async def _unless_ended(self, work: Coroutine[Any, Any, End]) -> End | None:
        """Wait for some work; None when the goal is ended before or meanwhile."""
        if self._end_reason:
            work.close()
            return None
        self._work = asyncio.create_task(work, name="goal in hand")
        try:
            await asyncio.wait([self._work])
        finally:
            # Reached with the work still going on only when the server itself is being ended.
            self._work.cancel()
        return None if self._work.cancelled() else self._work.result()


async def _in_time(asking: Coroutine[Any, Any, End]) -> End | None:
    """What comes of some work that is bounded, None when it takes too long."""
    try:
        return await asking
    except TimeoutError:
        return None


def _group_of(robot: RobotModel, motion: Trajectory) -> str:
    """The group that has just these joints, empty when there is none: planners then say what they want."""
    return next((name for name, group in robot.groups.items() if group.joints == motion.joint_names), "")

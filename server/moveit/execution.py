"""Carries a goal out: plans from where the arm holds, plays the plan, tells how it goes."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable

from planners.pool import PlannerPool
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.scene import EMPTY_SCENE
from robot.arm import Arm
from robot.messages import Mode, MotionEnded, Outcome
from server.goal_queue import Answer, GoalState, Progress
from server.moveit.failed_goals import FailedGoals
from server.moveit.goals import MotionRequest
from server.moveit.parameters import MoveItParameters
from server.moveit.readiness import unusable

log = logging.getLogger("armbridge.execution")

# MoveIt's allowance for an execution, 1.1, at the half speed of an arm with a hot servo, plus the time the driver
# gives the arm to settle.
DURATION_FACTOR = 2.2
DURATION_MARGIN_S = 2.0

# A motion that overran is braked; no arm needs longer for that.
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


class GoalExecutor:
    """Runs one goal at a time, from request to answer.

    Args:
        arm: the arm.
        pool: the planners.
        parameters: how goals are planned.
        failed_goals: keeps those that could not be planned, or None.
    """

    def __init__(
        self, arm: Arm, pool: PlannerPool, parameters: MoveItParameters, failed_goals: FailedGoals | None = None
    ) -> None:
        self._arm = arm
        self._pool = pool
        self._parameters = parameters
        self._failed_goals = failed_goals
        self._planning: asyncio.Task[Plan | PlanningFailure] | None = None
        self._stop_reason = ""

    async def run(self, request: MotionRequest, report: Callable[[Progress], None]) -> Answer:
        """Plan and play; every wait is bounded, and every way out is an answer."""
        self._stop_reason = ""
        failure = unusable(self._arm.state, self._arm.state_age_s)
        if failure is not None:
            return Answer.of(failure)
        report(Progress(GoalState.PLANNING, "; ".join(("planning", *request.warnings))))
        problem = self._problem(request)
        plan = await self._plan(problem)
        if isinstance(plan, PlanningFailure):
            if self._failed_goals is not None and plan.code is not MoveItErrorCode.PREEMPTED:
                await self._failed_goals.save(problem, EMPTY_SCENE, plan)
            return Answer.of(plan)
        if self._stop_reason:
            return Answer(MoveItErrorCode.PREEMPTED, f"{self._stop_reason} before the motion began")
        report(Progress(GoalState.EXECUTING, _summary(plan), 0.0, plan.trajectory.duration_s))
        if plan.trajectory.duration_s == 0.0:
            return Answer(MoveItErrorCode.SUCCESS, "the arm was there already")
        return self._answer(await self._play(plan, report))

    def stop(self, reason: str) -> None:
        """End the goal in hand; the arm is told even when no goal is known, so that nothing can keep it moving."""
        self._stop_reason = reason
        if self._planning is not None:
            self._planning.cancel()
        self._arm.stop()

    async def _plan(self, problem: PlanningProblem) -> Plan | PlanningFailure:
        planning = asyncio.create_task(self._pool.ask(problem), name="plan")
        self._planning = planning
        try:
            await asyncio.wait([planning])
        finally:
            # Reached with the planning still going on only when the server itself is being ended.
            planning.cancel()
            self._planning = None
        if planning.cancelled():
            return PlanningFailure(MoveItErrorCode.PREEMPTED, f"{self._stop_reason} while planning")
        return planning.result()

    def _problem(self, request: MotionRequest) -> PlanningProblem:
        state = self._arm.state
        if state.goal_rad is None:
            raise AssertionError("planning without a connected arm")
        return PlanningProblem(
            group=self._parameters.group_name,
            # What the arm holds, not where it droops to: the motion then starts without a step.
            start_rad=dict(zip(state.joint_names, state.goal_rad.tolist(), strict=True)),
            goal=request.goal,
            velocity_scaling=self._parameters.max_velocity_scaling,
            acceleration_scaling=self._parameters.max_acceleration_scaling,
            allowed_time_s=self._parameters.allowed_planning_time,
            attempts=self._parameters.num_planning_attempts,
            planner_id=self._parameters.planner_id,
            optimization_time_s=self._parameters.optimization_time,
        )

    async def _play(self, plan: Plan, report: Callable[[Progress], None]) -> MotionEnded:
        allowed_s = plan.trajectory.duration_s * DURATION_FACTOR + DURATION_MARGIN_S
        until_s = time.monotonic() + allowed_s
        ended = self._arm.execute(plan.trajectory)
        while not ended.done() and time.monotonic() < until_s:
            await asyncio.wait([ended], timeout=PROGRESS_PERIOD_S)
            state = self._arm.state
            if not ended.done() and state.mode is Mode.MOVING:
                report(Progress(GoalState.EXECUTING, _summary(plan), state.fraction, state.remaining_s))
        if not ended.done():
            self._arm.stop()
            await asyncio.wait([ended], timeout=BRAKING_TIMEOUT_S)
        if not ended.done():
            return MotionEnded(0, Outcome.PROCESS_LOST, f"the arm did not end the motion within {allowed_s:.1f} s")
        return ended.result()

    def _answer(self, ended: MotionEnded) -> Answer:
        message = ended.message
        if ended.outcome is Outcome.STOPPED:
            message = f"{self._stop_reason or 'stopped'}: {message}"
        return Answer(CODE_OF_OUTCOME[ended.outcome], message)


def _summary(plan: Plan) -> str:
    return f"{plan.method}, {plan.trajectory.duration_s:.2f} s, planned in {plan.planning_time_s * 1e3:.0f} ms"

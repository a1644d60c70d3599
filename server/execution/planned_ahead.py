"""Plan of the goal that comes next, made while the motion before it is in progress."""

from __future__ import annotations

import asyncio
import logging
import time
from dataclasses import replace

from planners.interface import Planners
from planners.problem import PLANNER_IDS, VIA_POINT, CartesianPlan, Plan, PlanningFailure, PlanningProblem
from planners.scene import Scene
from server.errors import RefusedError
from server.execution.motions import Motion, PlannedMotion, Positions, Problem

log = logging.getLogger("armbridge.execution")

# Against 6 ms, this shortened 24 searched motions of the SO-101 between walls by a tenth on average, in 0.1 s of
# processor time as a rule; 0.6 s did no more.
LONGEST_OPTIMIZATION_S = 0.3

# Share of the time left of the motion in progress that is spent on shortening the next: the rest is for a slow machine.
OPTIMIZATION_SHARE = 0.5


class PlannedAhead:
    """Plan of one motion, made in advance.

    It answers the very problem that it was made for, in the very scene: the start of the arm bit for bit, goal, limits
    and settings. Planners answer everything else, so that goals end as if nothing had been planned in advance.
    """

    def __init__(self, pool: Planners) -> None:
        self._pool = pool
        # Goal, end of the motion before it, and version of the scene; None to begin again.
        self._made_for: tuple[Motion, Positions, int] | None = None
        self._problem: PlanningProblem | None = None
        self._scene_version = 0
        self._plan: Plan | None = None
        self._task: asyncio.Task[None] | None = None

    def begin(self, request: Motion, held_rad: Positions, end_rad: Positions, scene: Scene, left_s: float) -> None:
        """Begin to plan a goal's motion, unless that was done; another goal's plan is dropped.

        Args:
            end_rad: positions of the joints that move, at the end of the motion in progress [rad].
        """
        made_for = (request, end_rad, scene.version)
        if self._made_for == made_for:
            return
        self.cancel()
        if not isinstance(request, PlannedMotion) or not _is_known(request):
            return
        self._made_for = made_for
        planning = self._make(request, {**held_rad, **end_rad}, scene, time.monotonic() + left_s)
        self._task = asyncio.create_task(planning, name="planning ahead")

    def cancel(self) -> None:
        """Drop the plan, and stop planning."""
        if self._task is not None:
            self._task.cancel()
        self._task = self._made_for = self._problem = self._plan = None

    def forget(self, request: Motion) -> None:
        """Drop the plan if it is of this goal."""
        if self._made_for is not None and self._made_for[0] is request:
            self.cancel()

    async def ask(self, request: Problem, scene: Scene) -> Plan | CartesianPlan | PlanningFailure:
        """Answer a problem with the plan made in advance, if it is the same problem, else have planners answer it."""
        plan = self._plan if (self._problem, self._scene_version) == (request, scene.version) else None
        self.cancel()
        if plan is None:
            return await self._pool.ask(request, scene)
        return replace(plan, method=f"{plan.method}, in advance")

    async def _make(self, request: PlannedMotion, start_rad: Positions, scene: Scene, until_s: float) -> None:
        try:
            problem = request.steps[0](start_rad)
            if not isinstance(problem, PlanningProblem):
                return
            plan = await self._pool.ask_in_background(problem, scene)
            if isinstance(plan, Plan):
                self._problem, self._scene_version, self._plan = problem, scene.version, plan
                self._plan = await self._shortened(plan, problem, scene, until_s)
            elif plan is None:
                # The planners had something else to plan: the next report of the motion in progress tries again.
                self._made_for = None
        except RefusedError:
            # The goal is refused in its turn, if the reason still holds then.
            pass
        except Exception:  # a bug must cost this plan only
            log.exception("planning ahead failed")

    async def _shortened(self, plan: Plan, problem: PlanningProblem, scene: Scene, until_s: float) -> Plan:
        """Return the shorter of a plan and another that more time was spent on; the latter is given up in time."""
        optimization_s = min(LONGEST_OPTIMIZATION_S, OPTIMIZATION_SHARE * (until_s - time.monotonic()))
        if optimization_s <= problem.optimization_time_s or not _may_be_shortened(plan, problem):
            return plan
        longer = replace(problem, optimization_time_s=optimization_s)
        other = await self._pool.ask_in_background(longer, scene)
        if not isinstance(other, Plan):
            return plan
        shortest = min(plan, other, key=lambda each: each.trajectory.duration_s)
        return replace(shortest, planning_time_s=plan.planning_time_s + other.planning_time_s)


def _is_known(request: PlannedMotion) -> bool:
    """Tell if a goal's problem is known before its turn: one motion, in the present scene, that nobody confirms."""
    return len(request.steps) == 1 and request.scene is None and not request.confirm


def _may_be_shortened(plan: Plan, problem: PlanningProblem) -> bool:
    """Tell if a motion was searched for, by the default settings: those who choose others get what they give."""
    settings = (problem.optimization_time_s, problem.attempts, problem.planner_id)
    defaults = (PlanningProblem.optimization_time_s, PlanningProblem.attempts, PlanningProblem.planner_id)
    return plan.method in (VIA_POINT, *PLANNER_IDS) and settings == defaults

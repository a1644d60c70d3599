"""Plans several motions, each from where the one before ends."""

from __future__ import annotations

from collections.abc import Awaitable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from planners.problem import CartesianPlan, CartesianProblem, Plan, PlanningFailure, PlanningProblem
from planners.scene import Scene
from robot.trajectory import Trajectory
from server.goal_queue import Performed
from server.moveit.motions import Positions, Step
from server.moveit.requests.error_codes import deviation_note


class Ask(Protocol):
    """Has a planner answer, as `planners.pool.PlannerPool.ask` does."""

    def __call__(
        self, request: PlanningProblem | CartesianProblem, scene: Scene, /
    ) -> Awaitable[Plan | CartesianPlan | PlanningFailure]:
        """Plan a motion in a scene."""


@dataclass(frozen=True)
class Planned:
    """What came of planning.

    Attributes:
        performed: the motions that were found.
        methods: how each was found.
        notes: what of the goals could not be had, a sentence each.
        failure: why there is no further one; None when there are all.
        problem: the one that has no answer, when it came to that.
    """

    performed: Performed
    methods: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    failure: PlanningFailure | None = None
    problem: PlanningProblem | CartesianProblem | None = None

    @property
    def duration_s(self) -> float:
        """Of all motions together [s]."""
        return sum(motion.duration_s for motion in self.performed.planned)

    @property
    def summary(self) -> str:
        """How the motions were found, for people."""
        found = f"{', '.join(self.methods)}, {self.duration_s:.2f} s"
        planning_s = self.performed.planning_time_s
        return f"{found}, planned in {planning_s * 1e3:.0f} ms" if planning_s else found

    def with_plan(self, plan: Plan | CartesianPlan) -> Planned:
        """The same with one more motion."""
        note = deviation_note(plan.deviation)
        performed = replace(
            self.performed,
            planned=(*self.performed.planned, plan.trajectory),
            planning_time_s=self.performed.planning_time_s + plan.planning_time_s,
        )
        method = plan.method if isinstance(plan, Plan) else "path of the tip"
        return Planned(performed, (*self.methods, method), (*self.notes, note) if note else self.notes)


async def plan_steps(steps: Sequence[Step], start_rad: Positions, scene: Scene, ask: Ask) -> Planned:
    """Plan all steps, or those before the first that cannot be planned.

    Args:
        steps: make the problems.
        start_rad: position of every movable joint at the first one's start [rad].
        scene: to plan in.
        ask: plans one.
    """
    now_rad, planned = dict(start_rad), Planned(Performed(start_rad))
    for number, step in enumerate(steps):
        problem = step(now_rad)
        plan = problem if isinstance(problem, PlanningFailure) else await ask(problem, scene)
        failure = _failure(plan)
        if isinstance(plan, PlanningFailure) or failure is not None:
            named = failure if len(steps) == 1 or failure is None else _in_item(number, failure)
            return replace(planned, failure=named, problem=None if isinstance(problem, PlanningFailure) else problem)
        planned = planned.with_plan(plan)
        # A new mapping: the problem keeps the one it was made for.
        now_rad = {**now_rad, **_end(plan.trajectory)}
    return planned


def _failure(plan: Plan | CartesianPlan | PlanningFailure) -> PlanningFailure | None:
    if isinstance(plan, PlanningFailure):
        return plan
    return plan.stopped_by if isinstance(plan, CartesianPlan) else None


def _in_item(number: int, failure: PlanningFailure) -> PlanningFailure:
    return replace(failure, message=f"items[{number}]: {failure.message}", details={**failure.details, "item": number})


def _end(motion: Trajectory) -> dict[str, float]:
    return dict(zip(motion.joint_names, motion.positions_rad[-1].tolist(), strict=True))

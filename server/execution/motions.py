"""Motions that goals ask for: those to plan, one after the other, and those planned elsewhere."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

from planners.problem import CartesianPlan, CartesianProblem, Plan, PlanningFailure, PlanningProblem
from planners.scene import Scene
from robot.trajectory import Trajectory
from server.errors import RefusedError
from server.execution.queue import Performed
from server.moveit.requests.error_codes import deviation_note

# Position of every movable joint [rad].
Positions: TypeAlias = Mapping[str, float]

# Makes a problem for a start, or raises RefusedError; when a goal's turn comes the arm may hold elsewhere than when the
# goal came.
Step: TypeAlias = Callable[[Positions], PlanningProblem | CartesianProblem]


@dataclass(frozen=True)
class PlannedMotion:
    """Sequence of motions to plan and then to execute.

    Attributes:
        steps: each makes its problem from the end of the one before.
        scene: makes the scene to plan in for the arm's positions, or raises RefusedError; None for the present scene.
        attempts: limit of planning attempts, when no motion is found or the scene invalidates it.
        delay_s: pause before another attempt [s].
        warnings: parts of the request that were ignored, a sentence each.
        confirm: true if a user is to confirm the plan before the arm moves.
    """

    steps: tuple[Step, ...]
    scene: Callable[[Positions], Scene] | None = None
    attempts: int = 1
    delay_s: float = 0.0
    warnings: tuple[str, ...] = ()
    confirm: bool = False


@dataclass(frozen=True)
class ExternalTrajectory:
    """Trajectory that a client has planned.

    Attributes:
        trajectory: makes it for the positions that the arm holds, or raises RefusedError.
    """

    trajectory: Callable[[Positions], Trajectory]


Motion: TypeAlias = PlannedMotion | ExternalTrajectory


class AskPlanner(Protocol):
    """Function that has a planner answer, as `planners.pool.PlannerPool.ask` does."""

    def __call__(
        self, request: PlanningProblem | CartesianProblem, scene: Scene, /
    ) -> Awaitable[Plan | CartesianPlan | PlanningFailure]:
        """Plan a motion in a scene."""


@dataclass(frozen=True)
class PlannedSequence:
    """Result of planning a sequence.

    Attributes:
        performed: the motions that were found.
        methods: the method that found each.
        notes: deviations from the goals, a sentence each.
        failure: the reason why the next motion is missing; None when all were found.
        problem: the problem without a plan; None when there is none.
    """

    performed: Performed
    methods: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    failure: PlanningFailure | None = None
    problem: PlanningProblem | CartesianProblem | None = None

    @property
    def duration_s(self) -> float:
        """Duration of all motions together [s]."""
        return sum(motion.duration_s for motion in self.performed.planned)

    @property
    def summary(self) -> str:
        """Methods and times, for people."""
        found = f"{', '.join(self.methods)}, {self.duration_s:.2f} s"
        planning_s = self.performed.planning_time_s
        return f"{found}, planned in {planning_s * 1e3:.0f} ms" if planning_s else found

    def with_plan(self, plan: Plan | CartesianPlan) -> PlannedSequence:
        """Return the sequence with one more motion."""
        note = deviation_note(plan.deviation)
        performed = replace(
            self.performed,
            planned=(*self.performed.planned, plan.trajectory),
            planning_time_s=self.performed.planning_time_s + plan.planning_time_s,
        )
        method = plan.method if isinstance(plan, Plan) else "path of the tip"
        return PlannedSequence(performed, (*self.methods, method), (*self.notes, note) if note else self.notes)


async def plan_sequence(steps: Sequence[Step], start_rad: Positions, scene: Scene, ask: AskPlanner) -> PlannedSequence:
    """Plan all steps, or those before the first that cannot be planned.

    Args:
        steps: make the problems.
        start_rad: position of every movable joint at the start of the first [rad].
        scene: to plan in.
        ask: plans one.
    """
    now_rad, planned = dict(start_rad), PlannedSequence(Performed(start_rad))
    for number, step in enumerate(steps):
        problem = None
        try:
            problem = step(now_rad)
            plan = await _plan(problem, scene, ask)
        except RefusedError as error:
            failure = error.failure if len(steps) == 1 else _in_item(number, error.failure)
            return replace(planned, failure=failure, problem=problem)
        planned = planned.with_plan(plan)
        # A new mapping: the problem keeps the one it was made for.
        now_rad = {**now_rad, **_end_positions(plan.trajectory)}
    return planned


def _end_positions(motion: Trajectory) -> dict[str, float]:
    """Return the positions of a motion's joints at its end [rad]."""
    return dict(zip(motion.joint_names, motion.positions_rad[-1].tolist(), strict=True))


async def _plan(problem: PlanningProblem | CartesianProblem, scene: Scene, ask: AskPlanner) -> Plan | CartesianPlan:
    """Plan one motion to its end.

    Raises:
        RefusedError: there is no plan, or only one of the beginning.
    """
    plan = await ask(problem, scene)
    if isinstance(plan, PlanningFailure):
        raise RefusedError(plan)
    if isinstance(plan, CartesianPlan) and plan.stopped_by is not None:
        raise RefusedError(plan.stopped_by)
    return plan


def _in_item(number: int, failure: PlanningFailure) -> PlanningFailure:
    return replace(failure, message=f"items[{number}]: {failure.message}", details={**failure.details, "item": number})

"""CPU time of planning, by kind of goal, in a planner without its process."""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import replace

import numpy as np

from harness.figures import percentiles, print_table
from planners.goals import AnyGoal, JointGoal, PositionGoal
from planners.pipeline import Planner
from planners.problem import Plan, PlanningFailure, PlanningProblem
from robot.description.robot_folder import built_in

PROBLEMS = 450
SEED = 5
TIP = "gripper_frame_link"

# Lines between folded poses that lead through the arm itself; random ones hardly ever do. Gripper at 0.
BLOCKED_LINES = (
    ((1.2103, -1.5715, 1.0747, 1.6046, -1.0008), (0.2147, -1.0755, 1.4794, 0.6402, 1.7224)),
    ((1.6716, -1.6307, 1.4725, 1.3381, 1.8154), (-1.4271, -1.3359, 1.5133, 1.0121, -0.8616)),
    ((1.0899, -1.4202, 1.3815, 1.3879, -1.7040), (-1.1337, -1.2821, 1.4034, 1.2004, 1.2428)),
    ((1.0545, -1.7384, 1.5604, 1.3571, -0.7895), (-0.7158, -1.0169, 0.9073, 1.2089, 1.0427)),
)


AT_ZERO = {**dict.fromkeys(built_in("so101").model.groups["arm"].joints, 0.0), "gripper": 0.0}
EASY = PlanningProblem("arm", AT_ZERO, JointGoal({"shoulder_pan": 0.5}))


def blocked_problem(number: int, attempts: int) -> PlanningProblem:
    """Return a joint goal that needs a search, seeded by its number."""
    start, end = BLOCKED_LINES[number % len(BLOCKED_LINES)]
    arm = built_in("so101").model.groups["arm"].joints
    start_rad = {**dict(zip(arm, start, strict=True)), "gripper": 0.0}
    goal = JointGoal(dict(zip(arm, end, strict=True)))
    return PlanningProblem("arm", start_rad, goal, 0.3, 0.3, attempts=attempts, seed=number)


# RRT* searches for shorter paths until the time is over.
LONG = replace(blocked_problem(2, attempts=1), allowed_time_s=60.0, planner_id="RRTstar")


class Draw:
    """Random problems for the built-in arm."""

    def __init__(self) -> None:
        self._robot = built_in("so101").model
        self._rng = np.random.default_rng(SEED)
        self._names = [joint.name for joint in self._robot.movable_joints]
        self._lower = np.array([joint.lower for joint in self._robot.movable_joints])
        self._upper = np.array([joint.upper for joint in self._robot.movable_joints])

    def problem(self, number: int) -> PlanningProblem:
        """Return by turns a position goal, a joint goal, and a joint goal that needs a search."""
        kind = number % 3
        if kind == 2:
            return blocked_problem(number, attempts=5)
        start, end = self._pose(), self._pose()
        goal: AnyGoal = JointGoal({name: end[name] for name in self._robot.groups["arm"].joints})
        if kind == 0:
            x, y, z = self._rng.uniform([-0.4, -0.4, -0.1], [0.4, 0.4, 0.4]).tolist()
            goal = PositionGoal(TIP, (x, y, z), 0.01)
        return PlanningProblem("arm", start, goal, 0.3, 0.3, attempts=5)

    def _pose(self) -> dict[str, float]:
        return dict(zip(self._names, self._rng.uniform(self._lower, self._upper).tolist(), strict=True))


def run() -> None:
    """Plan random problems; group them by kind of goal and by outcome."""
    planner, draw = Planner(built_in("so101").model), Draw()
    times_s: dict[str, list[float]] = defaultdict(list)
    for number in range(PROBLEMS):
        problem = draw.problem(number)
        started_s = time.process_time()
        answer = planner.plan(problem)
        times_s[_kind(problem.goal, answer)].append(time.process_time() - started_s)
    print_table(
        "Planning, CPU time [ms]",
        ["goal", "problems", "p50", "p95", "max"],
        [[kind, str(len(values)), *percentiles(values, 50, 95, 100)] for kind, values in sorted(times_s.items())],
    )


def _kind(goal: AnyGoal, answer: Plan | PlanningFailure) -> str:
    name = "joint" if isinstance(goal, JointGoal) else "position"
    return f"{name}: {answer.method if isinstance(answer, Plan) else answer.code.name}"

"""Part of a tip path that works in place of a whole path that does not, verified by a plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from planners.budget import Budget
from planners.cartesian.planning import DIGITS, plan_cartesian
from planners.cartesian.tip_path import TipPath, first_part
from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.goals import PoseGoal, PositionGoal
from planners.problem import (
    CartesianPlan,
    CartesianProblem,
    MoveItErrorCode,
    PathGoal,
    Plan,
    PlanningFailure,
    PlanningProblem,
)
from robot.description.model import RobotModel

# The end is rounded, and a path that ends there brakes there, so it may have to be a little shorter [m].
LESS_M = (0.0, 0.0005, 0.002, 0.005)

# Shares that are tried where no part near the end could be planned.
SHARES = (0.9, 0.75, 0.5, 0.25)

# Shorter parts are no motion [m].
LEAST_M = 0.001

# Tolerance of the path's end as a goal of its own, as most clients of MoveIt have it [m].
TOLERANCE_M = 0.001

# Failures of a path that could be followed in part: it takes too long to plan, or cannot be timed.
UNFOLLOWED = (MoveItErrorCode.TIMED_OUT, MoveItErrorCode.PLANNING_FAILED)

# A search for another way has no more of the time than this share.
OTHER_WAY_SHARE = 0.5


def nearest_end(
    problem: CartesianProblem,
    robot: RobotModel,
    collision: CollisionModel,
    forward: ForwardKinematics,
    plan: Callable[[PlanningProblem], Plan | PlanningFailure],
    budget: Budget,
) -> PathGoal | None:
    """Find how far a path that fails can be followed, and whether there is another way to its end; None if neither.

    ``plan`` plans a motion that need not follow the path.
    """

    def follow(path: CartesianProblem) -> CartesianPlan | PlanningFailure:
        return plan_cartesian(path, robot, collision, forward, budget)

    followed = follow(problem)
    if isinstance(followed, PlanningFailure) and followed.code not in UNFOLLOWED:
        return None
    forward.place(collision.start(problem.start_rad, robot.groups[problem.group].joints))
    start = forward.placement(problem.link).copy()
    length_m = TipPath(start, problem.segments).length_m
    most_m = followed.fraction * length_m if isinstance(followed, CartesianPlan) else length_m
    end, along_m = None, 0.0
    lengths_m = [most_m - less_m for less_m in LESS_M] + [share * most_m for share in SHARES]
    for part_m in sorted({length_m for length_m in lengths_m if length_m > LEAST_M}, reverse=True):
        if budget.used_up():
            break
        part = replace(problem, segments=first_part(start, problem.segments, part_m, DIGITS))
        found = follow(part)
        if isinstance(found, CartesianPlan) and found.stopped_by is None:
            end, along_m = part.segments[-1].end, part_m
            break
    other_way = not budget.used_up() and isinstance(plan(end_as_goal(problem, OTHER_WAY_SHARE * budget.left_s)), Plan)
    if end is None and not other_way:
        return None
    return PathGoal(end, along_m / length_m if length_m > 0.0 else 0.0, length_m, other_way)


def end_as_goal(problem: CartesianProblem, allowed_time_s: float) -> PlanningProblem:
    """Return the problem of a motion to a path's end that need not follow the path."""
    end = problem.segments[-1].end
    goal: PositionGoal | PoseGoal = PositionGoal(problem.link, end.position_m, TOLERANCE_M)
    if problem.keep_orientation:
        goal = PoseGoal(problem.link, end, TOLERANCE_M, (problem.orientation_tolerance_rad,) * 3, strict=True)
    return PlanningProblem(
        problem.group,
        problem.start_rad,
        goal,
        problem.velocity_scaling,
        problem.acceleration_scaling,
        allowed_time_s,
        path_constraints=problem.path_constraints,
        optimization_time_s=0.0,
    )

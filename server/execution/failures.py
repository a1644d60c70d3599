"""Goals that cannot be planned, and the nearest goals that can be planned."""

import asyncio
from dataclasses import replace
from typing import Any

from planners.goals import JointGoal, PoseGoal, PositionGoal
from planners.interface import Planners
from planners.problem import (
    CartesianProblem,
    MoveItErrorCode,
    NearestGoalAnswer,
    NearestGoalQuestion,
    PathGoal,
    PlanningFailure,
    PlanningProblem,
)
from planners.scene import Scene
from server.execution.motions import Problem

# Goals that have no plan for a reason that another goal nearby may not have.
SUGGESTED_FOR = (
    MoveItErrorCode.GOAL_IN_COLLISION,
    MoveItErrorCode.NO_IK_SOLUTION,
    MoveItErrorCode.TIMED_OUT,
    MoveItErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS,
)

# Likewise of paths of the tip: another end may be reached along the same path, or the same end by another way.
SUGGESTED_FOR_PATHS = (
    MoveItErrorCode.NO_IK_SOLUTION,
    MoveItErrorCode.PLANNING_FAILED,
    MoveItErrorCode.INVALID_MOTION_PLAN,
    MoveItErrorCode.TIMED_OUT,
)

# The answer takes 0.3 s at most; other motions to plan may come first.
ASKING_TIMEOUT_S = 2.0


async def with_nearest_goal(
    failure: PlanningFailure, problem: Problem | None, scene: Scene, pool: Planners
) -> PlanningFailure:
    """Add the nearest goal that works to a failure, if one was found: its detail ``free_rad`` or ``free_m``.

    Of a path of the tip ``free_m`` and ``free_orientation`` are the end to which it can be followed, ``free_fraction``
    is its share up to there, and ``end_by_other_way`` says if its end can be reached by a motion that does not follow
    it. The message says the same.
    """
    match problem:
        case PlanningProblem():
            suggested = failure.code in SUGGESTED_FOR or _beyond_limits(failure, problem)
        case CartesianProblem():
            suggested = failure.code in SUGGESTED_FOR_PATHS
        case _:
            return failure
    if not suggested:
        return failure
    try:
        question = NearestGoalQuestion(problem, code=failure.code)
        answer = await asyncio.wait_for(pool.ask(question, scene), ASKING_TIMEOUT_S)
    except TimeoutError:
        return failure
    found: dict[str, Any] = {}
    match answer:
        case NearestGoalAnswer(PathGoal() as goal):
            return _with_path(failure, goal)
        case NearestGoalAnswer(JointGoal(positions_rad)):
            found = {"free_rad": dict(positions_rad)}
        case NearestGoalAnswer(PositionGoal() as goal):
            found = {"free_m": list(goal.position_m)}
        case NearestGoalAnswer(PoseGoal() as goal):
            found = {"free_m": list(goal.pose.position_m)}
    return replace(failure, details={**failure.details, **found})


def _beyond_limits(failure: PlanningFailure, problem: PlanningProblem) -> bool:
    goal, details = problem.goal, failure.details
    if not isinstance(goal, JointGoal) or not {"joint", "lower_rad", "upper_rad"} <= details.keys():
        return False
    position_rad = goal.positions_rad.get(details["joint"])
    return position_rad is not None and not details["lower_rad"] <= position_rad <= details["upper_rad"]


def _with_path(failure: PlanningFailure, found: PathGoal) -> PlanningFailure:
    details: dict[str, Any] = {"end_by_other_way": found.end_by_other_way}
    ways = []
    if found.end is not None:
        details |= {
            "free_m": list(found.end.position_m),
            "free_orientation": list(found.end.orientation),
            "free_fraction": found.fraction,
            "length_m": found.length_m,
        }
        x, y, z = found.end.position_m
        along, whole = 100.0 * found.fraction * found.length_m, 100.0 * found.length_m
        ways.append(f"the same path to ({x:.3f}, {y:.3f}, {z:.3f}) m, {along:.1f} of {whole:.1f} cm")
    if found.end_by_other_way:
        ways.append("its end by a motion that does not follow it")
    message = f"{failure.message}; what would work: {', or '.join(ways)}"
    return replace(failure, message=message, details={**failure.details, **details})

"""Checks before any search: each gives the code that is true of the case, with its figures.

Every check returns a :class:`PlanningFailure`, or None.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from planners.geometry.collision import CollidingPair
from planners.ik.goal_checks import check_constraints, check_goal, invalid_goal
from planners.problem import (
    PLANNER_IDS,
    CartesianProblem,
    IkQuestion,
    MoveItErrorCode,
    PlanningFailure,
    PlanningProblem,
    StateQuestion,
    planner_name,
)
from robot.description.model import Group, RobotModel

# A relaxed arm may hang this far beyond a soft limit, and a servo's zero is set by hand.
START_LIMIT_TOLERANCE_RAD = 0.05

# The hulls reach up to 20 mm beyond the links: a folded arm touches itself in the hulls only, and must get out.
START_CONTACT_DEPTH_M = 0.01

# Searches and time to improve are bounded, since a request occupies a planner.
MAX_ATTEMPTS = 1000
MAX_PLANNING_TIME_S = 3600.0

# Pairs in contact that an answer names; a scene of 1000 shapes has thousands where the arm is amid them.
MAX_PAIRS = 100

# A joint that is measured while it moves at its limit may be reported a little faster.
SPEED_TOLERANCE = 1e-6


def check_request(robot: RobotModel, problem: PlanningProblem) -> PlanningFailure | None:
    """Check names and numbers of a problem."""
    refusal = check_group(robot, problem.group)
    if refusal is not None:
        return refusal
    group = robot.groups[problem.group]
    return (
        next(_number_flaws(problem), None)
        or next(_moving_start_flaws(robot, group, problem), None)
        or check_goal(robot, group, problem.goal)
        or check_constraints(robot, problem.path_constraints)
    )


def check_ik_question(robot: RobotModel, question: IkQuestion) -> PlanningFailure | None:
    """Check names and numbers of a question for configurations."""
    return (
        check_group(robot, question.group)
        or next(_time_flaws(question.allowed_time_s), None)
        or check_goal(robot, robot.groups[question.group], question.goal)
        or check_constraints(robot, question.constraints)
    )


def check_state_question(robot: RobotModel, question: StateQuestion) -> PlanningFailure | None:
    """Check names and numbers of a question about a state; whether it is within limits is the question itself."""
    return (
        check_group(robot, question.group)
        or next(_position_flaws(robot, question.positions_rad), None)
        or check_constraints(robot, question.constraints)
    )


def check_group(robot: RobotModel, name: str) -> PlanningFailure | None:
    """Tell whether there is a planning group of this name."""
    if name in robot.groups:
        return None
    known = ", ".join(sorted(robot.groups))
    return PlanningFailure(
        MoveItErrorCode.INVALID_GROUP_NAME, f"there is no planning group {name!r}; there are: {known}", {"group": name}
    )


def check_start(robot: RobotModel, start_rad: Mapping[str, float]) -> PlanningFailure | None:
    """Check the positions of all joints at the start."""
    return next(_position_flaws(robot, start_rad), None) or next(
        limit_flaws(robot, start_rad, START_LIMIT_TOLERANCE_RAD, MoveItErrorCode.START_STATE_INVALID), None
    )


def limit_flaws(
    robot: RobotModel, positions_rad: Mapping[str, float], tolerance_rad: float, code: MoveItErrorCode
) -> Iterator[PlanningFailure]:
    """Yield a failure for each joint beyond its limits by more than a tolerance."""
    for joint in robot.movable_joints:
        value = positions_rad[joint.name]
        if not joint.lower - tolerance_rad <= value <= joint.upper + tolerance_rad:
            yield PlanningFailure(
                code,
                f"the arm stands with joint {joint.name!r} at {value:.4g} {joint.unit}, beyond its limits"
                f" {joint.lower:.4g} to {joint.upper:.4g} {joint.unit}",
                {"joint": joint.name, "position_rad": value, "lower_rad": joint.lower, "upper_rad": joint.upper},
            )


def check_start_contact(pairs: Sequence[CollidingPair]) -> PlanningFailure | None:
    """Check for contact at the start; shallow contacts may be left and are no failure."""
    if all(pair.depth_m <= START_CONTACT_DEPTH_M for pair in pairs):
        return None
    return contact_failure(MoveItErrorCode.START_STATE_IN_COLLISION, "the arm stands in collision", pairs)


def contact_failure(code: MoveItErrorCode, what: str, pairs: Sequence[CollidingPair]) -> PlanningFailure:
    """Return the failure that names the pairs in contact."""
    return PlanningFailure(code, f"{what}: {describe_pairs(pairs)}", {"pairs": pairs_as_data(pairs)})


def describe_pairs(pairs: Sequence[CollidingPair]) -> str:
    """The pairs in words, with depths in millimetres."""
    return ", ".join(f"{pair.first} and {pair.second} by {1000.0 * pair.depth_m:.1f} mm" for pair in pairs)


def pairs_as_data(pairs: Sequence[CollidingPair]) -> list[dict[str, Any]]:
    """The pairs as plain values, `MAX_PAIRS` of them at most."""
    return [asdict(pair) for pair in pairs[:MAX_PAIRS]]


def rate_flaws(problem: PlanningProblem | CartesianProblem) -> Iterator[PlanningFailure]:
    """Yield a failure for each share of the limits, and for a time, that cannot be."""
    scalings = {
        "velocity scaling": problem.velocity_scaling,
        "acceleration scaling": problem.acceleration_scaling,
    }
    for name, value in scalings.items():
        if not 0.0 < value <= 1.0:
            yield invalid_goal(f"the {name} must be above 0 and at most 1, not {value:g}", value=value)
    yield from _time_flaws(problem.allowed_time_s)


def _number_flaws(problem: PlanningProblem) -> Iterator[PlanningFailure]:
    yield from rate_flaws(problem)
    if not 0.0 <= problem.optimization_time_s <= MAX_PLANNING_TIME_S:
        value = problem.optimization_time_s
        yield invalid_goal(f"the optimization time must be 0 to {MAX_PLANNING_TIME_S:g} s, not {value:g}", value=value)
    if not 1 <= problem.attempts <= MAX_ATTEMPTS:
        yield invalid_goal(f"the attempts must be 1 to {MAX_ATTEMPTS}, not {problem.attempts}", value=problem.attempts)
    if planner_name(problem.planner_id) is None:
        known = ", ".join(PLANNER_IDS)
        yield invalid_goal(
            f"there is no planner {problem.planner_id!r}; there are: {known}", planner_id=problem.planner_id
        )


def _time_flaws(allowed_time_s: float) -> Iterator[PlanningFailure]:
    if not (math.isfinite(allowed_time_s) and allowed_time_s > 0.0):
        yield invalid_goal(f"the allowed planning time must be a finite number above 0 s, not {allowed_time_s:g}")


def _moving_start_flaws(robot: RobotModel, group: Group, problem: PlanningProblem) -> Iterator[PlanningFailure]:
    for name, value in problem.start_velocity_rad_s.items():
        if name not in group.joints:
            yield _start_invalid(f"the start has a velocity of {name!r}, no joint of group {group.name!r}", joint=name)
            return
        limit = problem.velocity_scaling * robot.joints[name].max_velocity
        if not abs(value) <= limit * (1.0 + SPEED_TOLERANCE):
            yield _start_invalid(
                f"the start velocity of joint {name!r}, {value:.4g} rad/s, is beyond its limit {limit:.4g} rad/s"
                f" at a velocity scaling of {problem.velocity_scaling:g}",
                joint=name,
                velocity_rad_s=value,
                limit_rad_s=limit,
            )


def _position_flaws(robot: RobotModel, positions_rad: Mapping[str, float]) -> Iterator[PlanningFailure]:
    for joint in robot.movable_joints:
        value = positions_rad.get(joint.name)
        if value is None or not math.isfinite(value):
            said = "is missing" if value is None else f"is {value}"
            yield _start_invalid(f"the start position of joint {joint.name!r} {said}", joint=joint.name)


def _start_invalid(message: str, **details: str | float) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.START_STATE_INVALID, message, details)

"""What can be refused of a path of the tip before it is followed, each with the code that is true of the case."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planners.cartesian.tip_path import arc_flaw
from planners.checks import check_group
from planners.ik.goal_checks import check_constraints, invalid_goal
from planners.problem import Arc, CartesianProblem, Line, MoveItErrorCode, PlanningFailure
from robot.description.model import RobotModel

Vector = NDArray[np.float64]

# Following takes some 0.3 ms a point: more would take longer than anyone waits for.
MOST_POINTS = 10_000

# Quaternions from single precision are off by less; others are mistakes.
NORM_TOLERANCE = 1e-3


def check_path(robot: RobotModel, problem: CartesianProblem) -> PlanningFailure | None:
    """Names and numbers of a problem."""
    refusal = check_group(robot, problem.group) or check_constraints(robot, problem.path_constraints)
    if refusal is not None:
        return refusal
    if problem.link not in robot.links:
        known = ", ".join(robot.links)
        return PlanningFailure(
            MoveItErrorCode.INVALID_LINK_NAME, f"the robot has no link {problem.link!r}; it has: {known}"
        )
    flaw = next(_flaws(problem), None)
    return None if flaw is None else invalid_goal(flaw)


def check_shape(start_m: Vector, problem: CartesianProblem) -> PlanningFailure | None:
    """Whether each arc's three points make one and the path is not too long.

    Args:
        start_m: the tip's position at the start, shape (3,) [m].
        problem: the path.
    """
    length_m = 0.0
    for index, segment in enumerate(problem.segments):
        flaw = arc_flaw(start_m, segment) if isinstance(segment, Arc) else None
        if flaw is not None:
            return invalid_goal(f"segment {index} is no arc: {flaw}")
        length_m += float(np.linalg.norm(np.asarray(segment.end.position_m) - start_m))
        start_m = np.asarray(segment.end.position_m)
    if length_m > MOST_POINTS * problem.max_step_m:
        return invalid_goal(
            f"a path of {length_m:.4g} m in steps of {problem.max_step_m:g} m has more than {MOST_POINTS} points"
        )
    return None


def _flaws(problem: CartesianProblem) -> Iterator[str]:
    for name, value in (
        ("velocity scaling", problem.velocity_scaling),
        ("acceleration scaling", problem.acceleration_scaling),
    ):
        if not 0.0 < value <= 1.0:
            yield f"the {name} must be above 0 and at most 1, not {value:g}"
    for name, value in _positive(problem):
        if not (math.isfinite(value) and value > 0.0):
            yield f"the {name} must be a finite number above 0, not {value:g}"
    if not (math.isfinite(problem.max_joint_step_rad) and problem.max_joint_step_rad >= 0.0):
        yield f"the greatest joint step must be a finite number of 0 rad or more, not {problem.max_joint_step_rad:g}"
    if not problem.segments:
        yield "the path has no segment"
    for index, segment in enumerate(problem.segments):
        yield from (f"segment {index}: {flaw}" for flaw in _segment_flaws(segment))


def _positive(problem: CartesianProblem) -> Iterator[tuple[str, float]]:
    yield "allowed planning time [s]", problem.allowed_time_s
    yield "greatest step [m]", problem.max_step_m
    if problem.tip_speed_m_s is not None:
        yield "tip speed [m/s]", problem.tip_speed_m_s
    if problem.keep_orientation:
        yield "orientation tolerance [rad]", problem.orientation_tolerance_rad


def _segment_flaws(segment: Line | Arc) -> Iterator[str]:
    if not np.all(np.isfinite(segment.end.position_m)):
        yield f"its end {tuple(segment.end.position_m)} m is not finite"
    norm = float(np.linalg.norm(segment.end.orientation))
    if not abs(norm - 1.0) <= NORM_TOLERANCE:
        yield f"the quaternion at its end has the length {norm:.4g}, not 1"
    if isinstance(segment, Arc) and not np.all(np.isfinite(segment.via_m)):
        yield f"the point {tuple(segment.via_m)} m on its way is not finite"

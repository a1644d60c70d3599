"""What can be refused before any search: each check gives the code that is true of the case, with its figures.

Every check takes a problem and gives a :class:`PlanningFailure`, or None when there is nothing to say against it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planners.collision import CollidingPair, CollisionModel
from planners.goals import JointGoal, PositionGoal
from planners.kinematics import IkResult
from planners.problem import MoveItErrorCode, PlanningFailure, PlanningProblem
from robot.model import Group, RobotModel

Vector = NDArray[np.float64]

# A relaxed arm may hang this far beyond a soft limit, and a servo's zero is set by hand.
START_LIMIT_TOLERANCE_RAD = 0.05

# The hulls reach up to 20 mm beyond the links: a folded arm touches itself in the hulls only, and must get out.
START_CONTACT_DEPTH_M = 0.01


def check_request(robot: RobotModel, problem: PlanningProblem) -> PlanningFailure | None:
    """Names and scalars of a problem."""
    group = robot.groups.get(problem.group)
    if group is None:
        known = ", ".join(sorted(robot.groups))
        return PlanningFailure(
            MoveItErrorCode.INVALID_GROUP_NAME, f"there is no planning group {problem.group!r}; there are: {known}"
        )
    scalars = {
        "velocity scaling": problem.velocity_scaling,
        "acceleration scaling": problem.acceleration_scaling,
    }
    for name, value in scalars.items():
        if not 0.0 < value <= 1.0:
            return _invalid_goal(f"the {name} must be above 0 and at most 1, not {value:g}", value=value)
    if not (math.isfinite(problem.allowed_time_s) and problem.allowed_time_s > 0.0):
        return _invalid_goal(
            f"the allowed planning time must be a finite number above 0 s, not {problem.allowed_time_s:g}"
        )
    if isinstance(problem.goal, JointGoal):
        return _check_joint_goal(robot, group, problem.goal)
    return _check_position_goal(robot, problem.goal)


def check_start(robot: RobotModel, start_rad: Mapping[str, float]) -> PlanningFailure | None:
    """Positions of all joints at the start."""
    for joint in robot.movable_joints:
        value = start_rad.get(joint.name)
        if value is None or not math.isfinite(value):
            said = "is missing" if value is None else f"is {value}"
            return PlanningFailure(
                MoveItErrorCode.START_STATE_INVALID,
                f"the start position of joint {joint.name!r} {said}",
                {"joint": joint.name},
            )
        if not joint.lower - START_LIMIT_TOLERANCE_RAD <= value <= joint.upper + START_LIMIT_TOLERANCE_RAD:
            return PlanningFailure(
                MoveItErrorCode.START_STATE_INVALID,
                f"the arm stands with joint {joint.name!r} at {value:.4g} rad, beyond its limits"
                f" {joint.lower:.4g} to {joint.upper:.4g} rad",
                {"joint": joint.name, "position_rad": value, "lower_rad": joint.lower, "upper_rad": joint.upper},
            )
    return None


def check_start_contact(pairs: Sequence[CollidingPair]) -> PlanningFailure | None:
    """Links that touch at the start; shallow contacts may be left and are no failure."""
    if all(pair.depth_m <= START_CONTACT_DEPTH_M for pair in pairs):
        return None
    return PlanningFailure(
        MoveItErrorCode.START_STATE_IN_COLLISION,
        f"the arm already touches itself: {describe_pairs(pairs)}",
        {"pairs": pairs_as_data(pairs)},
    )


def check_goal_contact(collision: CollisionModel, goal_q: Vector) -> PlanningFailure | None:
    """Links that touch in the goal configuration."""
    pairs = collision.colliding_pairs(goal_q)
    return goal_in_collision(pairs) if pairs else None


def goal_in_collision(pairs: Sequence[CollidingPair]) -> PlanningFailure:
    """The goal can only be had with links touching."""
    return PlanningFailure(
        MoveItErrorCode.GOAL_IN_COLLISION,
        f"in the goal the arm would touch itself: {describe_pairs(pairs)}",
        {"pairs": pairs_as_data(pairs)},
    )


def out_of_reach(goal: PositionGoal, found: IkResult) -> PlanningFailure:
    """No configuration brings the link to the point."""
    nearest_m = [round(float(value), 4) for value in found.nearest_m]
    return PlanningFailure(
        MoveItErrorCode.NO_IK_SOLUTION,
        f"{goal.link!r} cannot reach {_point(goal.position_m)} m, whatever its orientation: the nearest point it can"
        f" reach is {_point(nearest_m)} m, {100.0 * found.distance_m:.1f} cm away",
        {"distance_m": found.distance_m, "nearest_m": nearest_m, "tolerance_m": goal.tolerance_m},
    )


def describe_pairs(pairs: Sequence[CollidingPair]) -> str:
    """The pairs in words, with depths in millimetres."""
    return ", ".join(f"{pair.first} and {pair.second} by {1000.0 * pair.depth_m:.1f} mm" for pair in pairs)


def pairs_as_data(pairs: Sequence[CollidingPair]) -> list[dict[str, str | float]]:
    """The pairs as plain values."""
    return [{"first": pair.first, "second": pair.second, "depth_m": pair.depth_m} for pair in pairs]


def _check_joint_goal(robot: RobotModel, group: Group, goal: JointGoal) -> PlanningFailure | None:
    for name, value in goal.positions_rad.items():
        if name not in group.joints:
            known = ", ".join(group.joints)
            return _invalid_goal(f"group {group.name!r} has no joint {name!r}; it has: {known}", joint=name)
        if not math.isfinite(value):
            return _invalid_goal(f"the goal of joint {name!r} is {value}, not a finite number", joint=name)
        joint = robot.joints[name]
        if not joint.lower - goal.tolerance_rad <= value <= joint.upper + goal.tolerance_rad:
            return _invalid_goal(
                f"the goal of joint {name!r}, {value:.4g} rad, is beyond its limits"
                f" {joint.lower:.4g} to {joint.upper:.4g} rad",
                joint=name,
                position_rad=value,
                lower_rad=joint.lower,
                upper_rad=joint.upper,
            )
    return None


def _check_position_goal(robot: RobotModel, goal: PositionGoal) -> PlanningFailure | None:
    if goal.link not in robot.links:
        known = ", ".join(robot.links)
        return PlanningFailure(
            MoveItErrorCode.INVALID_LINK_NAME, f"the robot has no link {goal.link!r}; it has: {known}"
        )
    if not all(math.isfinite(value) for value in goal.position_m):
        return _invalid_goal(f"the goal position {_point(goal.position_m)} m is not finite")
    if not (math.isfinite(goal.tolerance_m) and goal.tolerance_m > 0.0):
        return _invalid_goal(f"the position tolerance must be above 0 m, not {goal.tolerance_m:g}")
    return None


def _invalid_goal(message: str, **details: str | float) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, details)


def _point(position_m: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in position_m) + ")"

"""Timing of a given path of the joints, such as a path taught by hand, and its check as it will be executed.

The path's parameter is time: the path is followed no faster than a share of that time says, and slower wherever the
limits of the joints demand it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planners import checks
from planners.budget import Budget
from planners.geometry.certificate import Contact, certify
from planners.geometry.collision import CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.motions.path_timing import MAX_DURATION_S, time_along
from planners.motions.spline import NaturalSpline
from planners.problem import JointPathProblem, MoveItErrorCode, Plan, PlanningFailure, RateLimits
from robot.description.model import RobotModel
from robot.trajectory import Trajectory

METHOD = "given path"

# The spline may leave the limits between points that keep them, by no more than the arm's controller tolerates.
LIMIT_TOLERANCE_RAD = 0.002


def plan_joint_path(
    problem: JointPathProblem, robot: RobotModel, collision: CollisionModel, budget: Budget
) -> Plan | PlanningFailure:
    """Time a path of the joints, and make sure that it keeps the limits and touches nothing.

    A failure names the time on the motion.
    """
    refusal = _flaw(problem, robot) or checks.check_start(robot, problem.start_rad)
    if refusal is not None:
        return refusal
    joints = [robot.joints[name] for name in problem.joint_names]
    limits = RateLimits.of(joints)
    path = NaturalSpline(problem.time_s, problem.positions_rad)
    motion = time_along(path, problem.joint_names, limits, np.full(len(path.grid), problem.speed))
    if budget.used_up():
        return budget.failure()
    if motion is None:
        return _invalid(
            f"the path stands still, bends too sharply to be timed, or takes more than {MAX_DURATION_S:g} s"
        )
    refusal = _beyond_limits(motion, robot) or _contact(problem, motion, collision, budget.should_stop)
    if budget.used_up():
        return budget.failure()
    return refusal or Plan(motion, METHOD, budget.spent_s)


def _flaw(problem: JointPathProblem, robot: RobotModel) -> PlanningFailure | None:
    names, points = problem.joint_names, problem.positions_rad
    unknown = [name for name in names if name not in robot.joints or not robot.joints[name].movable]
    if not names or unknown or len(set(names)) < len(names):
        return _invalid(f"the path must name movable joints of the robot, each once, not {', '.join(names) or 'none'}")
    if len(problem.time_s) < 2 or points.shape != (len(problem.time_s), len(names)):
        return _invalid(f"the path must have 2 points or more, each of {len(names)} joints, not {points.shape}")
    if not (np.isfinite(problem.time_s).all() and np.isfinite(points).all() and (np.diff(problem.time_s) > 0.0).all()):
        return _invalid("the path must have finite numbers and times that increase")
    if not 0.0 < problem.speed < np.inf:
        return _invalid(f"speed must be above 0, not {problem.speed:g}")
    return None


def _beyond_limits(motion: Trajectory, robot: RobotModel) -> PlanningFailure | None:
    for column, name in enumerate(motion.joint_names):
        joint, values = robot.joints[name], motion.positions_rad[:, column]
        beyond = np.maximum(joint.lower - values, values - joint.upper)
        worst = int(np.argmax(beyond))
        if beyond[worst] > LIMIT_TOLERANCE_RAD:
            return PlanningFailure(
                MoveItErrorCode.INVALID_MOTION_PLAN,
                f"at {motion.time_s[worst]:.2f} s of the motion joint {name!r} would be at {values[worst]:.4g}"
                f" {joint.unit}, beyond its limits {joint.lower:.4g} to {joint.upper:.4g} {joint.unit}",
                {"joint": name, "position_rad": float(values[worst]), "time_s": float(motion.time_s[worst])},
            )
    return None


def _contact(
    problem: JointPathProblem, motion: Trajectory, collision: CollisionModel, should_stop: Callable[[], bool]
) -> PlanningFailure | None:
    start_rad = {**problem.start_rad, **dict(zip(motion.joint_names, motion.positions_rad[0].tolist(), strict=True))}
    start_q = collision.clipped(start_rad)
    contacts = collision.colliding_pairs(start_q)
    if checks.check_start_contact(contacts) is not None:
        return touching(Contact(0.0, tuple(contacts)))
    space = JointSpace(collision, motion.joint_names, start_q, collision.overlaps_m(start_q), should_stop=should_stop)
    found = certify(space, motion)
    return None if found is None else touching(found)


def touching(contact: Contact) -> PlanningFailure:
    """Return the failure of a motion that touches something: when, what and how deep."""
    return PlanningFailure(
        MoveItErrorCode.INVALID_MOTION_PLAN,
        f"at {contact.time_s:.2f} s of the motion would touch: {checks.describe_pairs(contact.pairs)}",
        {"pairs": checks.pairs_as_data(contact.pairs), "contact_s": contact.time_s},
    )


def _invalid(message: str) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, message)

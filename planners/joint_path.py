"""Timing of a given path of the joints, no faster than a share of its own time, and its check during execution."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from planners import checks
from planners.budget import Budget
from planners.geometry.certificate import Contact, certify
from planners.geometry.collision import CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.motions.path_timing import MAX_DURATION_S, time_along
from planners.motions.spline import NaturalSpline
from planners.problem import JointPathProblem, MoveItErrorCode, Plan, PlanningError, PlanningFailure, RateLimits
from robot.description.model import RobotModel
from robot.trajectory import Trajectory

METHOD = "given path"

# The spline may leave the limits between points that keep them, by no more than the arm's controller tolerates.
LIMIT_TOLERANCE_RAD = 0.002

SPARSE_STEP_M = 0.03  # the arm's own links are thicker than this, so a check this sparse misses only grazing contacts


def plan_joint_path(
    problem: JointPathProblem, robot: RobotModel, collision: CollisionModel, budget: Budget
) -> Plan | PlanningFailure:
    """Time a path of the joints that keeps the limits and touches nothing; PlanningError: the path is refused."""
    _check(problem, robot)
    checks.check_start(robot, problem.start_rad)
    joints = [robot.joints[name] for name in problem.joint_names]
    limits = RateLimits.of(joints)
    path = NaturalSpline(problem.time_s, problem.positions_rad)
    motion = time_along(path, problem.joint_names, limits, np.full(len(path.grid), problem.speed))
    if budget.used_up():
        return budget.failure()
    if motion is None:
        text = f"the path stands still, bends too sharply to be timed, or takes more than {MAX_DURATION_S:g} s"
        raise invalid_motion(text)
    _check_limits(motion, robot)
    contact = contact_on(motion, problem.start_rad, collision, budget.should_stop)
    if budget.used_up():
        return budget.failure()
    if contact is not None:
        return touching(contact, MoveItErrorCode.INVALID_MOTION_PLAN)
    return Plan(motion, METHOD, budget.spent_s)


def _check(problem: JointPathProblem, robot: RobotModel) -> None:
    names, points = problem.joint_names, problem.positions_rad
    unknown = [name for name in names if name not in robot.joints or not robot.joints[name].movable]
    if not names or unknown or len(set(names)) < len(names):
        named = ", ".join(names) or "none"
        raise invalid_motion(f"the path must name movable joints of the robot, each once, not {named}")
    if len(problem.time_s) < 2 or points.shape != (len(problem.time_s), len(names)):
        raise invalid_motion(f"the path must have 2 points or more, each of {len(names)} joints, not {points.shape}")
    if not (np.isfinite(problem.time_s).all() and np.isfinite(points).all() and (np.diff(problem.time_s) > 0.0).all()):
        raise invalid_motion("the path must have finite numbers and times that increase")
    if not 0.0 < problem.speed < np.inf:
        raise invalid_motion(f"speed must be above 0, not {problem.speed:g}")


def _check_limits(motion: Trajectory, robot: RobotModel) -> None:
    for column, name in enumerate(motion.joint_names):
        joint, values = robot.joints[name], motion.positions_rad[:, column]
        beyond = np.maximum(joint.lower - values, values - joint.upper)
        worst = int(np.argmax(beyond))
        if beyond[worst] > LIMIT_TOLERANCE_RAD:
            text = f"at {motion.time_s[worst]:.2f} s of the motion joint {name!r} would be at {values[worst]:.4g}"
            text += f" {joint.unit}, beyond its limits {joint.lower:.4g} to {joint.upper:.4g} {joint.unit}"
            details = {"position_rad": float(values[worst]), "time_s": float(motion.time_s[worst])}
            raise invalid_motion(text, joint=name, **details)


def contact_on(
    motion: Trajectory, others_rad: Mapping[str, float], collision: CollisionModel, should_stop: Callable[[], bool]
) -> Contact | None:
    """Return the first contact of a motion, None if certified; shallow ones at its start count if deepened."""
    names = motion.joint_names
    moving_rad = dict(zip(names, motion.positions_rad[0].tolist(), strict=True))
    start_q = collision.start({**others_rad, **moving_rad}, names)
    contacts = collision.colliding_pairs(start_q)
    if any(pair.depth_m > checks.START_CONTACT_DEPTH_M for pair in contacts):
        return Contact(0.0, tuple(contacts))
    space = JointSpace(collision, names, start_q, collision.overlaps_m(start_q), should_stop=should_stop)
    return _sparse_contact(space, motion) or certify(space, motion)


def _sparse_contact(space: JointSpace, motion: Trajectory) -> Contact | None:
    """Return the first sample in contact, found in a quarter of the time that the certificate takes."""
    travel_m = np.cumsum(np.abs(np.diff(motion.positions_rad, axis=0)) @ space.travel_m_per_rad)
    checked = np.flatnonzero(np.diff(np.floor(travel_m / SPARSE_STEP_M), prepend=0.0)) + 1
    before = 0
    for index in checked:
        if not space.free_by_parts(motion.positions_rad[index]):
            touching = (i for i in range(before + 1, index + 1) if not space.free_by_parts(motion.positions_rad[i]))
            first = next(touching)
            return Contact(float(motion.time_s[first]), space.contacts(motion.positions_rad[first]))
        before = int(index)
    return None


def touching(contact: Contact, code: MoveItErrorCode) -> PlanningFailure:
    """Return the failure of a motion that touches something: when, what and how deep."""
    text = f"at {contact.time_s:.2f} s of the motion would touch: {checks.describe_pairs(contact.pairs)}"
    details = {"pairs": checks.pairs_as_data(contact.pairs), "contact_s": contact.time_s}
    return PlanningFailure(code, text, details)


def invalid_motion(message: str, **details: str | float) -> PlanningError:
    """Return the error of a motion that cannot be meant."""
    return PlanningError(PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, message, details))

"""Is the rest of a motion that runs still free? Asked when the scene has changed on the way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planners import checks
from planners.geometry.certificate import Contact, certify
from planners.geometry.collision import CollidingPair, CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.problem import MoveItErrorCode, PlanningFailure, RecheckAnswer, RecheckQuestion
from robot.description.model import RobotModel
from robot.trajectory import Trajectory

Vector = NDArray[np.float64]

# The arm's own links are thicker than this, so a glance this often misses only what is grazed.
LOOK_STEP_M = 0.03


def recheck(question: RecheckQuestion, robot: RobotModel, collision: CollisionModel) -> RecheckAnswer | PlanningFailure:
    """Check the rest of a motion against the present scene, as plans are checked before they leave.

    Contacts that are shallow where the motion is now do not count unless it deepens them, as at the start of a plan.

    Args:
        question: the motion, and how much of it is behind.
        robot: the arm.
        collision: its collisions with itself and the scene.

    Returns:
        The first contact with its time on the motion, or that there is none; a failure for a question that is none.
    """
    refusal = _check_question(question, robot)
    if refusal is not None:
        return refusal
    rest = _rest(question.trajectory, question.from_s)
    positions = dict(question.others_rad) | dict(zip(rest.joint_names, rest.positions_rad[0].tolist(), strict=True))
    refusal = checks.check_start(robot, positions)
    if refusal is not None:
        return refusal
    now_q = np.array([positions[name] for name in collision.joint_names])
    contacts = collision.colliding_pairs(now_q)
    if checks.check_start_contact(contacts) is not None:
        return RecheckAnswer(_contact(contacts, question.from_s), question.from_s)
    space = JointSpace(collision, robot.groups[question.group], now_q, collision.overlaps_m(now_q))
    found = _seen(space, rest) or certify(space, rest)
    if found is None:
        return RecheckAnswer(None)
    return RecheckAnswer(_contact(found.pairs, question.from_s + found.time_s), question.from_s + found.time_s)


def _seen(space: JointSpace, motion: Trajectory) -> Contact | None:
    """The first sample that touches something, by a look at some of them in their order.

    What is in the way is seen in a quarter of the time that the certificate takes to say where it begins.
    """
    travel_m = np.cumsum(np.abs(np.diff(motion.positions_rad, axis=0)) @ space.travel_m_per_rad)
    looked = np.flatnonzero(np.diff(np.floor(travel_m / LOOK_STEP_M), prepend=0.0)) + 1
    before = 0
    for index in looked:
        if not _free(space, motion.positions_rad[index]):
            touching = (i for i in range(before + 1, index + 1) if not _free(space, motion.positions_rad[i]))
            first = next(touching)
            return Contact(float(motion.time_s[first]), space.contacts(motion.positions_rad[first]))
        before = int(index)
    return None


def _free(space: JointSpace, point: Vector) -> bool:
    """Whether nothing touches at a point, by the full meshes where only hulls do."""
    return space.free(point) or (space.look_closer(point) and space.free(point))


def _check_question(question: RecheckQuestion, robot: RobotModel) -> PlanningFailure | None:
    refusal = checks.check_group(robot, question.group)
    if refusal is not None:
        return refusal
    group = robot.groups[question.group]
    motion = question.trajectory
    if motion.joint_names != group.joints:
        return _invalid(f"a motion of {', '.join(motion.joint_names)} is none of the joints {', '.join(group.joints)}")
    if not all(np.all(np.isfinite(part)) for part in (motion.time_s, motion.positions_rad, motion.velocities_rad_s)):
        return _invalid("the motion has numbers that are not finite")
    if not 0.0 <= question.from_s <= motion.duration_s:
        return _invalid(
            f"the motion lasts from 0 to {motion.duration_s:.4g} s, there is no time {question.from_s:.4g} s"
        )
    return None


def _rest(motion: Trajectory, from_s: float) -> Trajectory:
    """The part of a motion after a time, with times that start at 0."""
    position, velocity, acceleration = motion.sample(from_s)
    after = motion.time_s > from_s
    return Trajectory(
        motion.joint_names,
        np.concatenate(([0.0], motion.time_s[after] - from_s)),
        np.vstack((position, motion.positions_rad[after])),
        np.vstack((velocity, motion.velocities_rad_s[after])),
        np.vstack((acceleration, motion.accelerations_rad_s2[after])),
    )


def _contact(pairs: Sequence[CollidingPair], time_s: float) -> PlanningFailure:
    return PlanningFailure(
        MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE,
        f"at {time_s:.2f} s of the motion would touch: {checks.describe_pairs(pairs)}",
        {"pairs": checks.pairs_as_data(pairs), "contact_s": time_s},
    )


def _invalid(message: str) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, message)

"""moveit_msgs/JointConstraint: ranges of joints, checked against the robot and narrowed where several meet."""

from __future__ import annotations

import math
from collections.abc import Sequence

from planners.goals import JointConstraint
from robot.description.model import Joint
from server.moveit.requests.context import Message, RequestContext
from server.moveit.requests.refusals import invalid

# Positions this near to each other are one: MoveGroupInterface's default joint tolerance.
LEAST_TOLERANCE_RAD = 1e-4


def joint_constraints(messages: Sequence[Message], context: RequestContext, where: str) -> tuple[JointConstraint, ...]:
    """Read constraints on joints, one of each joint: several on the same joint are their common range.

    Args:
        messages: moveit_msgs/JointConstraint.
        context: what they are read against.
        where: path of their field.

    Raises:
        RefusedError: an unknown joint, a number that is not finite, a negative tolerance, a position beyond the
            limits, or ranges that have nothing in common.
    """
    found: dict[str, JointConstraint] = {}
    for index, message in enumerate(messages):
        constraint = _constraint(message, context, f"{where}.joint_constraints[{index}]")
        known = found.get(constraint.joint)
        found[constraint.joint] = constraint if known is None else _common(known, constraint, where)
    return tuple(found.values())


def _constraint(message: Message, context: RequestContext, where: str) -> JointConstraint:
    joint = context.robot.joints.get(message["joint_name"])
    if joint is None or not joint.movable:
        known = ", ".join(one.name for one in context.robot.movable_joints)
        raise invalid(
            f"{where}: there is no joint {message['joint_name']!r}; there are: {known}", joint=message["joint_name"]
        )
    for field in ("position", "tolerance_above", "tolerance_below", "weight"):
        if not math.isfinite(message[field]):
            raise invalid(f"{where}.{field} of joint {joint.name} must be a finite number, not {message[field]}")
    above, below = message["tolerance_above"], message["tolerance_below"]
    for field, value in (("tolerance_above", above), ("tolerance_below", below)):
        if value < 0.0:
            raise invalid(
                f"{where}.{field} of joint {joint.name} must be 0 rad or more, not {value:g}", joint=joint.name
            )
    position = _within_limits(joint, message, context, where)
    lower, upper = min(position, message["position"] - below), max(position, message["position"] + above)
    return JointConstraint(joint.name, position, upper - position, position - lower, max(0.0, message["weight"]))


def _within_limits(joint: Joint, message: Message, context: RequestContext, where: str) -> float:
    """The position, moved to the limit that it is a little beyond, or beyond by less than its own tolerance."""
    asked = float(message["position"])
    inside = min(max(asked, joint.lower), joint.upper)
    own = message["tolerance_below"] if asked > inside else message["tolerance_above"]
    if abs(asked - inside) > max(context.parameters.joint_tolerance, own):
        raise invalid(
            f"{where}: the position of joint {joint.name!r}, {asked:.4g} rad, is beyond its limits"
            f" {joint.lower:.4g} to {joint.upper:.4g} rad",
            joint=joint.name,
            position_rad=asked,
            lower_rad=joint.lower,
            upper_rad=joint.upper,
        )
    if inside != asked:
        context.warnings.append(
            f"the goal of joint {joint.name} is moved from {asked:.4g} rad to its limit {inside:.4g} rad"
        )
    return inside


def _common(first: JointConstraint, second: JointConstraint, where: str) -> JointConstraint:
    """The range that two constraints on one joint have in common."""
    lower = max(first.position_rad - first.below_rad, second.position_rad - second.below_rad)
    upper = min(first.position_rad + first.above_rad, second.position_rad + second.above_rad)
    if lower > upper + LEAST_TOLERANCE_RAD:
        raise invalid(
            f"{where}: the constraints on joint {first.joint!r} leave it no position:"
            f" one ends at {upper:.4g} rad, another begins at {lower:.4g} rad",
            joint=first.joint,
        )
    position = min(max(first.position_rad, lower), upper)
    weight = max(first.weight, second.weight)
    return JointConstraint(first.joint, position, max(0.0, upper - position), max(0.0, position - lower), weight)

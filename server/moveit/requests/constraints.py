"""moveit_msgs/Constraints: as a goal to reach, and as what must hold on the way."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from planners.goals import (
    AnyOf,
    ConstraintGoal,
    Constraints,
    Goal,
    JointConstraint,
    JointGoal,
    OrientationConstraint,
    PoseGoal,
    PositionGoal,
    SingleGoal,
)
from planners.scene import Pose
from server.moveit.requests import joint_constraints as joints
from server.moveit.requests.context import Message, RequestContext
from server.moveit.requests.orientations import is_binding, is_free, orientation_constraint
from server.moveit.requests.refusals import invalid, refusals_as_data
from server.moveit.requests.regions import Region, regions

# The planners' own bound; each alternative takes milliseconds to solve.
MAX_ALTERNATIVES = 64


@refusals_as_data
def goal_of(messages: Sequence[Message], context: RequestContext) -> Goal:
    """Read the goal of a motion: any one of the constraints will do.

    Args:
        messages: moveit_msgs/Constraints.
        context: what they are read against; gets the warnings.
    """
    if not messages:
        raise invalid("goal_constraints is empty: there is nothing to plan for")
    found: list[SingleGoal] = []
    for index, message in enumerate(messages):
        found += _goals(message, context, f"goal_constraints[{index}]", MAX_ALTERNATIVES - len(found))
    return found[0] if len(found) == 1 else AnyOf(tuple(found))


@refusals_as_data
def path_constraints_of(message: Message, context: RequestContext, where: str = "path_constraints") -> Constraints:
    """Read what must hold from start to end; :attr:`Constraints.empty` when nothing must.

    Args:
        message: a moveit_msgs/Constraints.
        context: what it is read against.
        where: path of its field.
    """
    _refuse_visibility(message, where)
    turned = _orientations(message, context, where)
    inside = []
    for index, region in enumerate(_regions(message, context, where)):
        if len(region) > 1:
            raise invalid(f"{where}.position_constraints[{index}] has {len(region)} regions; on the way it can be one")
        inside.append(region[0].constraint)
    return Constraints(joints.joint_constraints(message["joint_constraints"], context, where), tuple(inside), turned)


def _goals(message: Message, context: RequestContext, where: str, most: int) -> Iterator[SingleGoal]:
    """The alternatives that one moveit_msgs/Constraints leaves."""
    _refuse_visibility(message, where)
    ranges = _of_group(joints.joint_constraints(message["joint_constraints"], context, where), context, where)
    turned = _orientations(message, context, where)
    choices = _regions(message, context, where)
    if not (message["joint_constraints"] or choices or turned):
        raise invalid(f"{where} is empty: give joint, position or orientation constraints")
    count = math.prod(len(choice) for choice in choices)
    if count > most:
        raise invalid(f"{where} and those before it have more than {MAX_ALTERNATIVES} alternatives of regions")
    for chosen in itertools.product(*choices):
        yield _goal(ranges, chosen, turned, context)


def _goal(
    ranges: tuple[JointConstraint, ...],
    chosen: tuple[Region, ...],
    turned: tuple[OrientationConstraint, ...],
    context: RequestContext,
) -> SingleGoal:
    if not (chosen or turned):
        return JointGoal({one.joint: one.position_rad for one in ranges}, context.parameters.joint_tolerance)
    turned = tuple(one for one in turned if not is_free(one.tolerance_rad)) if chosen else turned
    if not ranges and len(chosen) == 1:
        goal = _link_goal(chosen[0], turned, context)
        if goal is not None:
            return goal
    return ConstraintGoal(
        Constraints(tuple(map(_solvable, ranges)), tuple(region.constraint for region in chosen), turned)
    )


def _link_goal(
    region: Region, turned: tuple[OrientationConstraint, ...], context: RequestContext
) -> PositionGoal | PoseGoal | None:
    """The goal for one link alone, whose refusal tells the nearest point; None where the constraints are more."""
    at = region.constraint
    if region.elongated:
        return None
    if not turned:
        return PositionGoal(at.link, at.region.position_m, region.within_m, at.offset_m)
    if len(turned) > 1 or turned[0].link != at.link or any(at.offset_m):
        return None
    pose = Pose(at.region.position_m, turned[0].orientation)
    tolerance_rad = turned[0].tolerance_rad
    return PoseGoal(at.link, pose, region.within_m, tolerance_rad, strict=is_binding(tolerance_rad, context))


def _solvable(constraint: JointConstraint) -> JointConstraint:
    """A range that a search can end in, for joints that are not simply set."""
    above = max(constraint.above_rad, joints.LEAST_TOLERANCE_RAD)
    below = max(constraint.below_rad, joints.LEAST_TOLERANCE_RAD)
    return replace(constraint, above_rad=above, below_rad=below)


def _of_group(ranges: tuple[JointConstraint, ...], context: RequestContext, where: str) -> tuple[JointConstraint, ...]:
    """Those of the group's joints; the others cannot move, and must hold already."""
    for one in ranges:
        if one.joint in context.group.joints:
            continue
        away = context.start_rad[one.joint] - one.position_rad
        least = context.parameters.joint_tolerance
        if not -max(one.below_rad, least) <= away <= max(one.above_rad, least):
            known = ", ".join(context.group.joints)
            raise invalid(
                f"{where}: group {context.group.name!r} does not move joint {one.joint!r}; it moves: {known}",
                joint=one.joint,
            )
        context.warnings.append(f"joint {one.joint} is not in group {context.group.name} and stays where it is")
    return tuple(one for one in ranges if one.joint in context.group.joints)


def _regions(message: Message, context: RequestContext, where: str) -> list[tuple[Region, ...]]:
    return [
        regions(constraint, context, f"{where}.position_constraints[{index}]")
        for index, constraint in enumerate(message["position_constraints"])
    ]


def _orientations(message: Message, context: RequestContext, where: str) -> tuple[OrientationConstraint, ...]:
    return tuple(
        orientation_constraint(constraint, context, f"{where}.orientation_constraints[{index}]")
        for index, constraint in enumerate(message["orientation_constraints"])
    )


def _refuse_visibility(message: Message, where: str) -> None:
    if message["visibility_constraints"]:
        raise invalid(f"{where}.visibility_constraints: what a sensor sees is not planned for; leave them out")

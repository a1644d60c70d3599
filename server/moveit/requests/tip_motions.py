"""Pilz's motions of the tip, ``LIN`` and ``CIRC``, in a moveit_msgs/MotionPlanRequest.

https://moveit.picknik.ai/main/doc/how_to_guides/pilz_industrial_motion_planner: the goal is that of any request; a
circle's path constraint is no constraint but names a point on its way (``interim``) or its middle (``center``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from planners.goals import JointGoal, PoseGoal, PositionGoal
from planners.problem import Arc, CartesianProblem, Line, PlanningProblem
from planners.scene import Point, Pose
from robot.trajectory import Vector
from server.moveit.requests.context import Message, RequestContext
from server.moveit.requests.refusals import invalid, required

POINT_TO_POINT, STRAIGHT, CIRCULAR = "PTP", "LIN", "CIRC"

INTERIM, CENTER = "interim", "center"

# Unit vectors whose sum is shorter point in opposite directions: their mean says nothing.
OPPOSITE = 1e-6


def names_arc(constraints: Message) -> bool:
    """Whether a moveit_msgs/Constraints is the point of a circle."""
    return constraints["name"] in (INTERIM, CENTER)


def tip_problem(
    planner: str, problem: PlanningProblem, arc: Message, tip_speed: float, context: RequestContext
) -> CartesianProblem:
    """The path of the tip that a request for `STRAIGHT` or `CIRCULAR` asks for.

    Args:
        planner: which of them.
        problem: the same request as a motion between its ends.
        arc: the request's path constraints, which name a point of a circle.
        tip_speed: its ``max_cartesian_speed`` [m/s].
        context: what the request is read against.

    Raises:
        RefusedError: a goal that is no single pose, or a circle that is none.
    """
    link, end, tolerance_rad = _end(problem, context)
    segment = Line(end) if planner == STRAIGHT else Arc(_via_m(arc, link, end, context), end)
    return CartesianProblem(
        group=problem.group,
        start_rad=problem.start_rad,
        link=link,
        segments=(segment,),
        keep_orientation=tolerance_rad is not None,
        orientation_tolerance_rad=tolerance_rad or math.pi,
        tip_speed_m_s=tip_speed if tip_speed > 0.0 else None,
        velocity_scaling=problem.velocity_scaling,
        acceleration_scaling=problem.acceleration_scaling,
        allowed_time_s=problem.allowed_time_s,
        path_constraints=problem.path_constraints,
    )


def _end(problem: PlanningProblem, context: RequestContext) -> tuple[str, Pose, float | None]:
    """Link, end, and the rotation from the asked orientation that may be on the way; None for any [rad]."""
    match problem.goal:
        case PositionGoal(link, position_m, _, offset_m) if not any(offset_m):
            return link, Pose(position_m, _pose(link, problem.start_rad, context).orientation), None
        case PoseGoal() as goal:
            return goal.link, goal.pose, max(goal.orientation_tolerance_rad) if goal.strict else None
        case JointGoal(positions_rad):
            link = context.link("")
            return link, _pose(link, {**problem.start_rad, **positions_rad}, context), None
    raise invalid("goal_constraints must be one pose of one link, or joint positions, for a path of the tip")


def _pose(link: str, positions_rad: Mapping[str, float], context: RequestContext) -> Pose:
    return required(context.frames.resolve(link, positions_rad))


def _via_m(arc: Message, link: str, end: Pose, context: RequestContext) -> Point:
    """A point of the circle between its ends, in the robot's root link [m]."""
    if not names_arc(arc) or len(arc["position_constraints"]) != 1:
        raise invalid(
            f"path_constraints must have one position constraint, and the name {INTERIM!r} or {CENTER!r}, for"
            f" {CIRCULAR}"
        )
    constraint = arc["position_constraints"][0]
    poses = constraint["constraint_region"]["primitive_poses"]
    if not poses:
        raise invalid("path_constraints.position_constraints[0].constraint_region.primitive_poses is empty")
    where = "path_constraints.position_constraints[0].constraint_region.primitive_poses[0]"
    point = context.placed(constraint["header"]["frame_id"], poses[0], where).position_m
    if arc["name"] == INTERIM:
        return point
    start = np.array(_pose(link, context.start_rad, context).position_m)
    return _beyond_center(np.array(point), start, np.array(end.position_m))


def _beyond_center(center: Vector, start: Vector, end: Vector) -> Point:
    """The middle of the shorter arc around a point [m]."""
    to_start, to_end = start - center, end - center
    radius = float(np.linalg.norm(to_start))
    across = to_start + to_end
    length = float(np.linalg.norm(across))
    if radius == 0.0 or length <= OPPOSITE * radius:
        raise invalid("path_constraints: start and end are opposite each other: name a point on the way instead")
    x, y, z = (center + radius / length * across).tolist()
    return x, y, z

"""moveit_msgs/OrientationConstraint: the orientation of a link, and how seriously it is meant."""

from __future__ import annotations

import math

from planners.goals import OrientationConstraint, Point
from server.moveit.requests.context import Message, RequestContext
from server.moveit.requests.refusals import invalid

AXES = ("x", "y", "z")

# No client asks for less than MoveGroupInterface's default; no search ends on a point.
LEAST_TOLERANCE_RAD = 1e-3

# The widest tolerance that a client fills in without being asked: compas_fab's. MoveGroupInterface's is 0.001, and
# sparse goals have 0. Nobody with five joints means these.
UNMEANT_TOLERANCE_RAD = 0.01

# From pi on an axis is free, as a rotation vector is never longer.
FREE_RAD = math.pi


def orientation_constraint(message: Message, context: RequestContext, where: str) -> OrientationConstraint:
    """Read one.

    Args:
        message: a moveit_msgs/OrientationConstraint; its tolerances are about the link's axes, whatever the
            ``parameterization``: those of the two kinds differ only where they are wide about several axes.
        context: what it is read against.
        where: path of its field.

    Raises:
        RefusedError: an unknown link or frame, a number that is not finite, or a negative tolerance.
    """
    link = context.link(message["link_name"])
    pose = {"position": dict.fromkeys(AXES, 0.0), "orientation": message["orientation"]}
    wanted = context.placed(message["header"]["frame_id"], pose, where)
    tolerances = [_tolerance(message, axis, where) for axis in AXES]
    if not math.isfinite(message["weight"]):
        raise invalid(f"{where}.weight must be a finite number, not {message['weight']}")
    x, y, z = tolerances
    return OrientationConstraint(link, wanted.orientation, (x, y, z), max(0.0, float(message["weight"])))


def is_free(tolerance_rad: Point) -> bool:
    """Whether any orientation will do."""
    return min(tolerance_rad) >= FREE_RAD


def is_binding(tolerance_rad: Point, context: RequestContext) -> bool:
    """Whether an orientation outside its tolerance is to be refused rather than told.

    It is where the group has the joints to meet any orientation. Where it has fewer, tolerances that a client
    fills in by itself are a wish; one that is wider about any axis was chosen, and is kept.
    """
    return context.chooses_orientation or max(tolerance_rad) > UNMEANT_TOLERANCE_RAD


def _tolerance(message: Message, axis: str, where: str) -> float:
    field = f"absolute_{axis}_axis_tolerance"
    value = float(message[field])
    if math.isnan(value) or value < 0.0:
        raise invalid(f"{where}.{field} must be a number of 0 rad or more, not {value:g}")
    return min(max(value, LEAST_TOLERANCE_RAD), 2.0 * FREE_RAD)

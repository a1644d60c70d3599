"""moveit_msgs/PositionConstraint: the regions that a point of a link may be in."""

from __future__ import annotations

import math
from dataclasses import dataclass

from planners.goals import Point, PositionConstraint
from server.moveit.requests.context import Message, RequestContext
from server.moveit.requests.refusals import invalid

# A point within this of another is there: MoveGroupInterface's default position tolerance, which a servo arm misses
# anyway. Regions that are smaller, and those of size 0, are taken as if they were as large.
LEAST_TOLERANCE_M = 1e-4

# shape_msgs/SolidPrimitive's types.
UNSET, BOX, SPHERE, CYLINDER = 0, 1, 2, 3

DIMENSIONS = {BOX: ("x", "y", "z"), SPHERE: ("radius",), CYLINDER: ("height", "radius")}


@dataclass(frozen=True)
class Region:
    """One of the regions of a constraint.

    Attributes:
        constraint: the constraint as if this were its only region.
        within_m: radius of the largest ball around the region's middle that is inside it [m].
        elongated: whether that ball leaves out much of the region.
    """

    constraint: PositionConstraint
    within_m: float
    elongated: bool


# A box whose edges differ by more than this factor is a shape of its own, not a tolerance around a point.
ELONGATED_FACTOR = 2.0


def regions(message: Message, context: RequestContext, where: str) -> tuple[Region, ...]:
    """The regions of one constraint; any one of them will do.

    A pose in ``primitive_poses`` that has no primitive, and one whose primitive says nothing, is a point to reach
    within the position tolerance of the parameters.

    Args:
        message: a moveit_msgs/PositionConstraint.
        context: what it is read against.
        where: path of its field.

    Raises:
        RefusedError: an unknown link or frame, no region, a region of a kind or size that cannot be had.
    """
    link = context.link(message["link_name"])
    volume = message["constraint_region"]
    if volume["meshes"]:
        raise invalid(f"{where}.constraint_region.meshes: regions can be boxes, spheres and cylinders, not meshes")
    primitives, poses = list(volume["primitives"]), volume["primitive_poses"]
    if not poses:
        what = "no pose for its primitive" if primitives else "no region: give a primitive and its pose"
        raise invalid(f"{where}.constraint_region has {what}", link=link)
    if len(primitives) > len(poses):
        raise invalid(f"{where}.constraint_region has {len(primitives)} primitives and {len(poses)} primitive_poses")
    primitives += [None] * (len(poses) - len(primitives))
    offset = _offset(message["target_point_offset"], f"{where}.target_point_offset")
    weight = _weight(message["weight"], where)
    frame, found = message["header"]["frame_id"], []
    for index, (primitive, pose) in enumerate(zip(primitives, poses, strict=True)):
        at = context.placed(frame, pose, f"{where}.constraint_region.primitive_poses[{index}]")
        size_m = _size(primitive, context, f"{where}.constraint_region.primitives[{index}]")
        found.append(_region(PositionConstraint(link, at, *size_m, offset, weight)))
    return tuple(found)


def _region(constraint: PositionConstraint) -> Region:
    if constraint.half_size_m is None:
        return Region(constraint, constraint.radius_m or LEAST_TOLERANCE_M, elongated=False)
    least, most = min(constraint.half_size_m), max(constraint.half_size_m)
    return Region(constraint, least, elongated=most > ELONGATED_FACTOR * least)


def _size(primitive: Message | None, context: RequestContext, where: str) -> tuple[Point | None, float | None]:
    """Half the edges of a box or the radius of a sphere, the other None [m]."""
    if primitive is None or (primitive["type"] == UNSET and not primitive["dimensions"]):
        return None, context.parameters.position_tolerance
    kind, given = primitive["type"], primitive["dimensions"]
    if kind not in DIMENSIONS:
        raise invalid(
            f"{where}.type: regions can be boxes ({BOX}), spheres ({SPHERE}) and cylinders ({CYLINDER}), not {kind}"
        )
    names = DIMENSIONS[kind]
    if len(given) != len(names):
        raise invalid(f"{where}.dimensions must have {len(names)} values ({', '.join(names)}), not {len(given)}")
    for name, value in zip(names, given, strict=True):
        if not (math.isfinite(value) and value >= 0.0):
            raise invalid(f"{where}.dimensions: {name} must be a finite number of 0 m or more, not {value:g}")
    if kind == SPHERE:
        return None, max(float(given[0]), LEAST_TOLERANCE_M)
    if kind == CYLINDER:
        # The largest upright box with a square base in it: what is in the box is in the cylinder.
        height, across = given[0], math.sqrt(2.0) * given[1]
        given = (across, across, height)
    x, y, z = (max(0.5 * float(edge), LEAST_TOLERANCE_M) for edge in given)
    return (x, y, z), None


def _offset(message: Message, where: str) -> Point:
    for axis in "xyz":
        if not math.isfinite(message[axis]):
            raise invalid(f"{where}.{axis} must be a finite number, not {message[axis]}")
    return float(message["x"]), float(message["y"]), float(message["z"])


def _weight(weight: float, where: str) -> float:
    """Weights that are not above 0 count like any other, as with MoveIt."""
    if not math.isfinite(weight):
        raise invalid(f"{where}.weight must be a finite number, not {weight}")
    return max(0.0, float(weight))

"""Shapes of shape_msgs as the planners have them: primitives, meshes and planes."""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Sequence

import numpy as np

from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Shape, Sphere
from planners.scene_checks import MAX_TRIANGLES, shape_fault
from robot.trajectory import Vector
from server.moveit.error_codes import invalid
from server.moveit.poses import Message

Corner = tuple[float, float]

# shape_msgs/SolidPrimitive
BOX, SPHERE, CYLINDER, CONE, PRISM = 1, 2, 3, 4, 5
NAMES = {BOX: "box", SPHERE: "sphere", CYLINDER: "cylinder", CONE: "cone", PRISM: "prism"}
DIMENSIONS = {BOX: 3, SPHERE: 1, CYLINDER: 2, CONE: 2, PRISM: 1}

_COORDINATES = operator.itemgetter("x", "y", "z")
_INDICES = operator.itemgetter("vertex_indices")

# Ear clipping takes time by the square of the corners; this many take up to 10 ms.
MAX_PRISM_CORNERS = 100


def prism_mesh(polygon: Sequence[Corner], height_m: float) -> Mesh | None:
    """Return the surface of a prism, its middle at z = 0; None for a polygon that crosses itself or has no area.

    Args:
        polygon: corners in their order, whichever way round [m]; the last is joined to the first.
    """
    corners = polygon if _area(polygon) > 0.0 else polygon[::-1]
    lid = _ears(corners)
    if lid is None:
        return None
    count = len(corners)
    flat = np.array(corners)
    levels = [np.column_stack((flat, np.full(count, z_m))) for z_m in (-0.5 * height_m, 0.5 * height_m)]
    floor = [(a, c, b) for a, b, c in lid]
    roof = [(a + count, b + count, c + count) for a, b, c in lid]
    walls = []
    for i in range(count):
        j = (i + 1) % count
        walls += [(i, j, j + count), (i, j + count, i + count)]
    return Mesh(np.vstack(levels), np.array([*floor, *roof, *walls], dtype=np.int32))


def _ears(corners: Sequence[Corner]) -> list[tuple[int, int, int]] | None:
    """Triangulate a counter-clockwise polygon by ear clipping; None if it crosses itself or has no area.

    The search goes on where an ear was cut, since only its two neighbours can have become ears.
    """
    points = np.array(corners)
    left = list(range(len(corners)))
    triangles = []
    i, tried = 0, 0
    while len(left) >= 3:
        if tried == len(left):
            return None
        i %= len(left)
        around = (left[i - 1], left[i], left[(i + 1) % len(left)])
        if not _is_ear(corners, points[left], around):
            i, tried = i + 1, tried + 1
            continue
        triangles.append(around)
        del left[i]
        i, tried = i - 1, 0
    return triangles or None


def _is_ear(corners: Sequence[Corner], points: Vector, around: tuple[int, int, int]) -> bool:
    """Tell if three consecutive corners turn to the left, and no point is inside them or on an edge."""
    a, b, c = (corners[k] for k in around)
    if _area((a, b, c)) <= 0.0:
        return False
    inside = np.ones(len(points), dtype=bool)
    for (x, y), (u, v) in ((a, b), (b, c), (c, a)):
        inside &= (u - x) * (points[:, 1] - y) >= (v - y) * (points[:, 0] - x)
    # The three corners themselves, on their own edges.
    return int(np.count_nonzero(inside)) == 3


def _area(corners: Sequence[Corner]) -> float:
    """Return twice the enclosed area, below 0 for clockwise corners [m^2]."""
    following = [*corners[1:], *corners[:1]]
    return sum(x * v - u * y for (x, y), (u, v) in zip(corners, following, strict=True))


def read_primitive(message: Message, where: str) -> Shape:
    """Read a shape_msgs/SolidPrimitive; dimensions beyond its type's are ignored, as in MoveIt."""
    kind, sizes_m = message["type"], message["dimensions"]
    if kind not in DIMENSIONS:
        known = ", ".join(f"{number} ({name})" for number, name in NAMES.items())
        raise invalid(f"{where}.type must be one of {known}, not {kind}")
    if len(sizes_m) < DIMENSIONS[kind]:
        raise invalid(f"{where}.dimensions of a {NAMES[kind]} are {DIMENSIONS[kind]}, not {len(sizes_m)}")
    if kind == PRISM:
        return _read_prism(message, where)
    shape: Shape
    if kind == BOX:
        shape = Box((sizes_m[0], sizes_m[1], sizes_m[2]))
    elif kind == SPHERE:
        shape = Sphere(sizes_m[0])
    else:
        # shape_msgs: CYLINDER_HEIGHT and CONE_HEIGHT are 0, the radii 1.
        shape = (Cylinder if kind == CYLINDER else Cone)(sizes_m[1], sizes_m[0])
    return _checked(shape, where)


def read_mesh(message: Message, where: str) -> Shape:
    """Read a shape_msgs/Mesh; arguments and errors as for :func:`read_primitive`."""
    # Counted first: arrays of a hostile message could fill the memory.
    count, points = len(message["triangles"]), len(message["vertices"])
    if count > MAX_TRIANGLES or points > 3 * MAX_TRIANGLES:
        raise invalid(f"{where} has {count} triangles and {points} vertices; {MAX_TRIANGLES} triangles are the limit")
    # Without a list in between, which takes twice as long.
    coordinates = itertools.chain.from_iterable(map(_COORDINATES, message["vertices"]))
    indices = itertools.chain.from_iterable(map(_INDICES, message["triangles"]))
    vertices_m = np.fromiter(coordinates, np.float64, 3 * points).reshape(-1, 3)
    triangles = np.fromiter(indices, np.int64, 3 * count).reshape(-1, 3)
    if count and triangles.max() >= points:
        raise invalid(f"{where}.triangles name the vertex {triangles.max()}; there are {points} vertices")
    return _checked(Mesh(vertices_m, triangles.astype(np.int32)), where)


def read_plane(message: Message, where: str) -> Shape:
    """Read a shape_msgs/Plane, a x + b y + c z + d = 0, solid on the side its normal points away from.

    Arguments and errors as for :func:`read_primitive`.
    """
    a, b, c, d = message["coef"]
    length = math.hypot(a, b, c)
    if not (math.isfinite(length) and length > 0.0):
        raise invalid(f"{where}.coef has no normal: {[a, b, c, d]}")
    return _checked(Plane((a / length, b / length, c / length), -d / length), where)


def _read_prism(message: Message, where: str) -> Shape:
    height_m = message["dimensions"][0]
    polygon = [(point["x"], point["y"]) for point in message["polygon"]["points"]]
    if not 3 <= len(polygon) <= MAX_PRISM_CORNERS:
        raise invalid(f"{where}.polygon has {len(polygon)} points, not 3 to {MAX_PRISM_CORNERS}")
    if not (math.isfinite(height_m) and height_m > 0.0):
        raise invalid(f"{where}.dimensions[0], the height of a prism, must be above 0, not {height_m:g}")
    if not all(math.isfinite(x) and math.isfinite(y) for x, y in polygon):
        raise invalid(f"{where}.polygon has a point that is not finite")
    surface = prism_mesh(polygon, height_m)
    if surface is None:
        raise invalid(f"{where}.polygon crosses itself or has no area")
    return _checked(surface, where)


def _checked(shape: Shape, where: str) -> Shape:
    fault = shape_fault(shape)
    if fault is not None:
        raise invalid(f"{where} {fault}", field=where)
    return shape

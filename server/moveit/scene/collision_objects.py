"""Collision objects and attached ones as moveit_msgs/CollisionObject describes them, and their shapes (shape_msgs)."""

import itertools
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np

from planners.scene import AttachedObject, Box, Cone, Cylinder, Mesh, Plane, Pose, SceneObject, Shape, Sphere
from planners.scene_checks import MAX_TRIANGLES, pose_fault, shape_fault
from robot.trajectory import Vector
from server.errors import RefusedError, invalid
from server.moveit.messages import Message, read_pose, write_pose

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
    """Return the surface of a prism over a polygon [m], its middle at z = 0; None if the polygon crosses itself."""
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
    """Return True if three consecutive corners turn to the left, and no other point is within them or on an edge."""
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


def _checked(shape: Shape, where: str) -> Shape:
    fault = shape_fault(shape)
    if fault is not None:
        raise invalid(f"{where} {fault}", field=where)
    return shape


Shapes = tuple[tuple[Shape, Pose], ...]

# moveit_msgs/CollisionObject.operation
ADD, REMOVE, APPEND, MOVE = 0, 1, 2, 3

IDENTITY = Pose()
NO_STAMP = {"sec": 0, "nanosec": 0}

# An object with a subframe for each of its places, such as a rack, has some dozens.
MAX_SUBFRAMES = 1000

# The three kinds of geometry in MoveIt's order: field of the shapes, field of their poses, reader of one shape.
GEOMETRY_KINDS: tuple[tuple[str, str, Callable[[Message, str], Shape]], ...] = (
    ("primitives", "primitive_poses", read_primitive),
    ("meshes", "mesh_poses", read_mesh),
    ("planes", "plane_poses", read_plane),
)


@dataclass(frozen=True, eq=False)
class CollisionObject:
    """Object with its geometry and pose, kept so that it can be published again as it came.

    ``==`` compares identities, which is quick; objects are equal if their messages are.
    """

    name: str
    frame: str  # frame of ``pose``: the planning frame, or the link that holds the object
    pose: Pose
    type: Message  # object_recognition_msgs/ObjectType, passed on unread
    geometry: Mapping[str, Sequence[Message]]  # the shapes as messages, by field of :data:`GEOMETRY_KINDS`
    shapes: Shapes  # the same in the order of :data:`GEOMETRY_KINDS`, each with its pose in the object's frame
    subframes: Mapping[str, Pose]

    @cached_property
    def scene_object(self) -> SceneObject:
        return SceneObject(self.name, self.shapes, self.pose)

    @cached_property
    def message(self) -> dict[str, Any]:
        """The moveit_msgs/CollisionObject that adds it."""
        poses = iter([write_pose(pose) for _, pose in self.shapes])
        geometry: dict[str, Any] = {}
        for field, poses_field, _ in GEOMETRY_KINDS:
            geometry[field] = self.geometry[field]
            geometry[poses_field] = list(islice(poses, len(self.geometry[field])))
        return {
            "header": {"stamp": NO_STAMP, "frame_id": self.frame},
            "pose": write_pose(self.pose),
            "id": self.name,
            "type": self.type,
            **geometry,
            "subframe_names": list(self.subframes),
            "subframe_poses": [write_pose(pose) for pose in self.subframes.values()],
            "operation": ADD,
        }

    def has_pose(self, pose: Message) -> bool:
        """Compare a geometry_msgs/Pose in the object's frame with its own pose, number by number."""
        position, orientation = pose["position"], pose["orientation"]
        return (position["x"], position["y"], position["z"]) == self.pose.position_m and (
            (orientation["x"], orientation["y"], orientation["z"], orientation["w"]) == self.pose.orientation
        )

    def equals_message(self, message: Message) -> bool:
        """Compare a moveit_msgs/CollisionObject in the object's frame with the message that adds this object."""
        return message == {**self.message, "header": message["header"]}


@dataclass(frozen=True, eq=False)
class AttachedCollisionObject:
    """Object that a link holds; its trajectory_msgs/JointTrajectory ``detach_posture`` is passed on unread."""

    collision_object: CollisionObject
    touch_links: tuple[str, ...]
    detach_posture: Message
    weight: float

    @property
    def link(self) -> str:
        return self.collision_object.frame

    @cached_property
    def attached_object(self) -> AttachedObject:
        return AttachedObject(self.collision_object.scene_object, self.link, frozenset(self.touch_links))

    @cached_property
    def message(self) -> dict[str, Any]:
        """The moveit_msgs/AttachedCollisionObject that attaches it."""
        return {
            "link_name": self.link,
            "object": self.collision_object.message,
            "touch_links": list(self.touch_links),
            "detach_posture": self.detach_posture,
            "weight": self.weight,
        }

    def equals_message(self, message: Message) -> bool:
        """Compare a moveit_msgs/AttachedCollisionObject with the message that attaches this object."""
        return (
            message["object"]["header"]["frame_id"] == self.link
            and all(value == self.message[field] for field, value in message.items() if field != "object")
            and self.collision_object.equals_message(message["object"])
        )


def has_geometry(message: Message) -> bool:
    return any(message[field] for field, _, _ in GEOMETRY_KINDS)


def read_collision_object(message: Message, frame: str, where: str) -> CollisionObject:
    """Read a moveit_msgs/CollisionObject that has geometry; its pose stays in the frame of its header.

    As in MoveIt, an object without a pose gets its shape's pose if it has just one shape.
    """
    name = message["id"]
    if not has_geometry(message):
        raise invalid(f"{where}: the object {name!r} has no shape", object=name)
    try:
        pose, shapes = with_object_pose(
            read_bounded_pose(message["pose"], f"{where}.pose"), _read_shapes(message, where)
        )
        subframes = _read_subframes(message, where)
    except RefusedError as error:
        details = {**error.failure.details, "object": name}
        raise invalid(f"the object {name!r}: {error.failure.message}", **details) from error
    geometry = {field: message[field] for field, _, _ in GEOMETRY_KINDS}
    return CollisionObject(name, frame, pose, message["type"], geometry, shapes, subframes)


def read_shape_poses(message: Message, where: str) -> tuple[Pose, ...]:
    """Read the poses of the shapes in a moveit_msgs/CollisionObject, in the order of :data:`GEOMETRY_KINDS`."""
    return tuple(
        read_bounded_pose(each, f"{where}.{field}[{i}]")
        for _, field, _ in GEOMETRY_KINDS
        for i, each in enumerate(message[field])
    )


def with_object_pose(pose: Pose, shapes: Shapes) -> tuple[Pose, Shapes]:
    """Return the pose of an object and its shapes; a single shape's pose becomes the pose of an object without one."""
    if pose != IDENTITY or len(shapes) != 1:
        return pose, shapes
    ((shape, shape_pose),) = shapes
    return shape_pose, ((shape, IDENTITY),)


def read_bounded_pose(message: Message, where: str) -> Pose:
    """Read a geometry_msgs/Pose within the scene's bounds."""
    pose = read_pose(message, where)
    fault = pose_fault(pose)
    if fault is not None:
        raise invalid(f"{where} {fault}", field=where)
    return pose


def _read_shapes(message: Message, where: str) -> Shapes:
    """Read every shape with its pose; a shape without a pose has its object's pose."""
    found = []
    for field, poses_field, read in GEOMETRY_KINDS:
        geometry, poses = message[field], message[poses_field]
        if len(poses) > len(geometry):
            raise invalid(f"{where}.{poses_field} has {len(poses)} entries, {field} only {len(geometry)}")
        for i, each in enumerate(geometry):
            shape = read(each, f"{where}.{field}[{i}]")
            pose = read_bounded_pose(poses[i], f"{where}.{poses_field}[{i}]") if i < len(poses) else IDENTITY
            found.append((shape, pose))
    return tuple(found)


def _read_subframes(message: Message, where: str) -> dict[str, Pose]:
    names, poses = message["subframe_names"], message["subframe_poses"]
    if len(names) != len(poses):
        raise invalid(f"{where}: subframe_names has {len(names)} entries, subframe_poses {len(poses)}")
    if len(names) > MAX_SUBFRAMES:
        raise invalid(f"{where}.subframe_names has {len(names)} entries, more than {MAX_SUBFRAMES}")
    subframes: dict[str, Pose] = {}
    for i, (name, pose) in enumerate(zip(names, poses, strict=True)):
        if not name or name in subframes:
            raise invalid(f"{where}.subframe_names[{i}] is {name!r}, which is empty or there already")
        subframes[name] = read_bounded_pose(pose, f"{where}.subframe_poses[{i}]")
    return subframes

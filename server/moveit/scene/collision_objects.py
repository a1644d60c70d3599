"""Collision objects and attached ones, as moveit_msgs/CollisionObject describes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

from planners.scene import AttachedObject, Pose, SceneObject, Shape
from planners.scene_checks import pose_fault
from server.errors import RefusedError
from server.moveit.error_codes import invalid
from server.moveit.poses import Message, read_pose, write_pose
from server.moveit.scene import shapes

Shapes = tuple[tuple[Shape, Pose], ...]

# moveit_msgs/CollisionObject.operation
ADD, REMOVE, APPEND, MOVE = 0, 1, 2, 3

IDENTITY = Pose()
NO_STAMP = {"sec": 0, "nanosec": 0}

# An object with a subframe for each of its places, such as a rack, has some dozens.
MAX_SUBFRAMES = 1000

# The three kinds of geometry in MoveIt's order: field of the shapes, field of their poses, reader of one shape.
GEOMETRY_KINDS: tuple[tuple[str, str, Callable[[Message, str], Shape]], ...] = (
    ("primitives", "primitive_poses", shapes.read_primitive),
    ("meshes", "mesh_poses", shapes.read_mesh),
    ("planes", "plane_poses", shapes.read_plane),
)


@dataclass(frozen=True, eq=False)
class CollisionObject:
    """Object with its geometry and pose, kept so that it can be published again as it came.

    Attributes:
        frame: frame of ``pose``: the planning frame, or the link that holds the object.
        type: object_recognition_msgs/ObjectType, passed on unread.
        geometry: the shapes as messages, by field of :data:`GEOMETRY_KINDS`.
        shapes: the same in the order of :data:`GEOMETRY_KINDS`, each with its pose in the object's frame.
    """

    name: str
    frame: str
    pose: Pose
    type: Message
    geometry: Mapping[str, Sequence[Message]]
    shapes: Shapes
    subframes: Mapping[str, Pose]

    @cached_property
    def scene_object(self) -> SceneObject:
        """The object as planners have it."""
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

    def equals(self, other: CollisionObject) -> bool:
        """Compare all that two objects have; ``==`` compares their identities, which is quicker."""
        return (
            (self.name, self.frame, self.pose, self.type) == (other.name, other.frame, other.pose, other.type)
            and self.geometry == other.geometry
            and [pose for _, pose in self.shapes] == [pose for _, pose in other.shapes]
            and self.subframes == other.subframes
        )


@dataclass(frozen=True, eq=False)
class AttachedCollisionObject:
    """Object that a link holds.

    Attributes:
        detach_posture: trajectory_msgs/JointTrajectory, passed on unread.
    """

    collision_object: CollisionObject
    touch_links: tuple[str, ...]
    detach_posture: Message
    weight: float

    @property
    def link(self) -> str:
        """The link that holds it."""
        return self.collision_object.frame

    @cached_property
    def attached_object(self) -> AttachedObject:
        """The object as planners have it."""
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

    def equals(self, other: AttachedCollisionObject) -> bool:
        """Compare all that two attached objects have."""
        return (
            (self.touch_links, self.weight) == (other.touch_links, other.weight)
            and self.detach_posture == other.detach_posture
            and self.collision_object.equals(other.collision_object)
        )


def has_geometry(message: Message) -> bool:
    """Tell if a moveit_msgs/CollisionObject has any shape."""
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

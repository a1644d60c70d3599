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
from server.moveit.poses import read_pose, write_pose
from server.moveit.requests.error_codes import invalid, required
from server.moveit.scene import shapes

Message = Mapping[str, Any]
Shapes = tuple[tuple[Shape, Pose], ...]

# moveit_msgs/CollisionObject.operation
ADD, REMOVE, APPEND, MOVE = 0, 1, 2, 3

IDENTITY = Pose()
NO_STAMP = {"sec": 0, "nanosec": 0}

# A thing that is named place by place, such as a rack, has some dozens.
MAX_SUBFRAMES = 1000

# The three kinds of geometry: field of the shapes, field of their poses, and who reads one; in MoveIt's order.
KINDS: tuple[tuple[str, str, Callable[[Message, str], Shape]], ...] = (
    ("primitives", "primitive_poses", shapes.read_primitive),
    ("meshes", "mesh_poses", shapes.read_mesh),
    ("planes", "plane_poses", shapes.read_plane),
)


@dataclass(frozen=True, eq=False)
class Thing:
    """A thing: its geometry, and where it is.

    Attributes:
        name: its id.
        frame: frame of ``pose``: the planning frame, or the link that holds it.
        pose: of the thing in that frame.
        type: object_recognition_msgs/ObjectType, passed on unseen.
        told: by field of :data:`KINDS`, the shapes as they were told.
        shapes: the same in the order of :data:`KINDS`, each with its pose in the thing's frame.
        subframes: name -> pose in the thing's frame.
    """

    name: str
    frame: str
    pose: Pose
    type: Message
    told: Mapping[str, Sequence[Message]]
    shapes: Shapes
    subframes: Mapping[str, Pose]

    @cached_property
    def object(self) -> SceneObject:
        """The thing as planners have it."""
        return SceneObject(self.name, self.shapes, self.pose)

    @cached_property
    def message(self) -> dict[str, Any]:
        """The moveit_msgs/CollisionObject that adds it."""
        poses = iter([write_pose(pose) for _, pose in self.shapes])
        geometry: dict[str, Any] = {}
        for field, poses_field, _ in KINDS:
            geometry[field] = self.told[field]
            geometry[poses_field] = list(islice(poses, len(self.told[field])))
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

    def is_at(self, pose: Message) -> bool:
        """Whether a geometry_msgs/Pose in the thing's frame is, number by number, the one that it has."""
        place, turn = pose["position"], pose["orientation"]
        return (place["x"], place["y"], place["z"]) == self.pose.position_m and (
            (turn["x"], turn["y"], turn["z"], turn["w"]) == self.pose.orientation
        )

    def told_again_by(self, message: Message) -> bool:
        """Whether a moveit_msgs/CollisionObject in the thing's frame is the one that it gives of itself."""
        return message == {**self.message, "header": message["header"]}

    def same_as(self, other: Thing) -> bool:
        """Whether nothing tells two things apart."""
        return (
            (self.name, self.frame, self.pose, self.type) == (other.name, other.frame, other.pose, other.type)
            and self.told == other.told
            and [at for _, at in self.shapes] == [at for _, at in other.shapes]
            and self.subframes == other.subframes
        )


@dataclass(frozen=True, eq=False)
class HeldThing:
    """A thing that a link holds.

    Attributes:
        thing: its frame is the link.
        touch_links: further links that may touch it.
        detach_posture: trajectory_msgs/JointTrajectory, passed on unseen.
        weight: passed on unseen.
    """

    thing: Thing
    touch_links: tuple[str, ...]
    detach_posture: Message
    weight: float

    @property
    def link(self) -> str:
        """The link that holds it."""
        return self.thing.frame

    @cached_property
    def object(self) -> AttachedObject:
        """The thing as planners have it."""
        return AttachedObject(self.thing.object, self.link, frozenset(self.touch_links))

    @cached_property
    def message(self) -> dict[str, Any]:
        """The moveit_msgs/AttachedCollisionObject that attaches it."""
        return {
            "link_name": self.link,
            "object": self.thing.message,
            "touch_links": list(self.touch_links),
            "detach_posture": self.detach_posture,
            "weight": self.weight,
        }

    def told_again_by(self, message: Message) -> bool:
        """Whether a moveit_msgs/AttachedCollisionObject is the one that it gives of itself."""
        return (
            message["object"]["header"]["frame_id"] == self.link
            and all(value == self.message[field] for field, value in message.items() if field != "object")
            and self.thing.told_again_by(message["object"])
        )

    def same_as(self, other: HeldThing) -> bool:
        """Whether nothing tells two of them apart."""
        return (
            (self.touch_links, self.weight) == (other.touch_links, other.weight)
            and self.detach_posture == other.detach_posture
            and self.thing.same_as(other.thing)
        )


def has_geometry(message: Message) -> bool:
    """Whether a moveit_msgs/CollisionObject brings any shape."""
    return any(message[field] for field, _, _ in KINDS)


def read_thing(message: Message, frame: str, where: str) -> Thing:
    """Read what a moveit_msgs/CollisionObject tells of a thing, its pose in the frame of its header.

    As in MoveIt the pose of a single shape is taken for the thing's pose where that is not given.

    Args:
        message: the object.
        frame: what the header's frame is called.
        where: path of the field, for the refusal.

    Raises:
        RefusedError: it brings no shape, or something of it cannot be used.
    """
    name = message["id"]
    if not has_geometry(message):
        raise invalid(f"{where}: the object {name!r} has no shape", object=name)
    try:
        pose, shapes = swapped(read_pose_within(message["pose"], f"{where}.pose"), _read_shapes(message, where))
        subframes = _read_subframes(message, where)
    except RefusedError as error:
        details = {**error.failure.details, "object": name}
        raise invalid(f"the object {name!r}: {error.failure.message}", **details) from error
    told = {field: message[field] for field, _, _ in KINDS}
    return Thing(name, frame, pose, message["type"], told, shapes, subframes)


def read_shape_poses(message: Message, where: str) -> tuple[Pose, ...]:
    """Read the poses of shapes that a moveit_msgs/CollisionObject gives, in the order of :data:`KINDS`.

    Raises:
        RefusedError: one is none.
    """
    return tuple(
        read_pose_within(each, f"{where}.{field}[{i}]")
        for _, field, _ in KINDS
        for i, each in enumerate(message[field])
    )


def swapped(pose: Pose, shapes: Shapes) -> tuple[Pose, Shapes]:
    """The pose of a thing and its shapes, where a single shape may carry the pose of both."""
    if pose != IDENTITY or len(shapes) != 1:
        return pose, shapes
    ((shape, at),) = shapes
    return at, ((shape, IDENTITY),)


def read_pose_within(message: Message, where: str) -> Pose:
    """Read a geometry_msgs/Pose that is within the scene's bounds.

    Raises:
        RefusedError: it is not.
    """
    pose = required(read_pose(message, where))
    fault = pose_fault(pose)
    if fault is not None:
        raise invalid(f"{where} {fault}", field=where)
    return pose


def _read_shapes(message: Message, where: str) -> Shapes:
    """Every shape with its pose; one that is given none stands where its thing is."""
    found = []
    for field, poses_field, read in KINDS:
        told, poses = message[field], message[poses_field]
        if len(poses) > len(told):
            raise invalid(f"{where}.{poses_field} has {len(poses)} entries, {field} only {len(told)}")
        for i, each in enumerate(told):
            shape = read(each, f"{where}.{field}[{i}]")
            at = read_pose_within(poses[i], f"{where}.{poses_field}[{i}]") if i < len(poses) else IDENTITY
            found.append((shape, at))
    return tuple(found)


def _read_subframes(message: Message, where: str) -> dict[str, Pose]:
    names, poses = message["subframe_names"], message["subframe_poses"]
    if len(names) != len(poses):
        raise invalid(f"{where}: subframe_names has {len(names)} entries, subframe_poses {len(poses)}")
    if len(names) > MAX_SUBFRAMES:
        raise invalid(f"{where}.subframe_names has {len(names)} entries, more than {MAX_SUBFRAMES}")
    subframes: dict[str, Pose] = {}
    for i, (name, told) in enumerate(zip(names, poses, strict=True)):
        if not name or name in subframes:
            raise invalid(f"{where}.subframe_names[{i}] is {name!r}, which is empty or there already")
        subframes[name] = read_pose_within(told, f"{where}.subframe_poses[{i}]")
    return subframes

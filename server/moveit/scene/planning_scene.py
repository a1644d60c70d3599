"""Contents of a planning scene, and the changes that MoveIt's messages make to them.

Messages are applied to a :class:`SceneDraft`, as in MoveIt's ``PlanningScene``: collision objects, attached collision
objects, and moveit_msgs/PlanningScene, which has all of them and the scene's settings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import islice
from typing import Any

from planners.problem import MoveItErrorCode
from planners.scene import Pose, Scene
from planners.scene_checks import MAX_LENGTH_M, MAX_SHAPES
from robot.description.model import RobotModel
from server.errors import RefusedError, invalid, refused
from server.moveit.messages import Message
from server.moveit.scene.allowed_collision_matrix import (
    AllowedCollisionMatrix,
    disabled_collisions,
    read_allowed_collision_matrix,
)
from server.moveit.scene.collision_objects import (
    ADD,
    APPEND,
    GEOMETRY_KINDS,
    MOVE,
    REMOVE,
    AttachedCollisionObject,
    CollisionObject,
    has_geometry,
    read_bounded_pose,
    read_collision_object,
    read_shape_poses,
    with_object_pose,
)
from server.moveit.scene.frames import LinkTransforms, find_frame, in_root, seen_from

# MoveIt's name of a scene without one.
NO_NAME = "(noname)"

OPERATIONS = {ADD: "ADD", REMOVE: "REMOVE", APPEND: "APPEND", MOVE: "MOVE"}

# Colours can be set for objects that do not exist yet, so the limit on shapes does not bound them.
MAX_COLORS = 2000

# Padding and scale of links that no message has named.
NO_PADDING_M = 0.0
NO_SCALE = 1.0

# Fields that a moveit_msgs/PlanningScene made by the server itself may leave out.
EMPTY_DIFF: Message = {
    "name": "",
    "robot_model_name": "",
    "robot_state": {"is_diff": True, "attached_collision_objects": ()},
    "allowed_collision_matrix": {"entry_names": (), "default_entry_names": ()},
    "link_padding": (),
    "link_scale": (),
    "object_colors": (),
    "world": {"collision_objects": (), "octomap": {"octomap": {"data": ()}}},
}


@dataclass
class SceneContents:
    """Contents of a planning scene, which nobody changes but in a draft; objects are compared by identity: quickly."""

    allowed_collisions: AllowedCollisionMatrix
    name: str = NO_NAME
    # Collision objects by name, in the planning frame.
    objects: dict[str, CollisionObject] = field(default_factory=dict)
    attached: dict[str, AttachedCollisionObject] = field(default_factory=dict)
    # Link -> padding [m]; links that are not in it have none.
    padding_m: dict[str, float] = field(default_factory=dict)
    scale: dict[str, float] = field(default_factory=dict)
    colors: dict[str, Message] = field(default_factory=dict)  # link or object -> std_msgs/ColorRGBA

    def looks_same(self, other: SceneContents) -> bool:
        return (
            self.objects == other.objects
            and self.attached == other.attached
            and self.allowed_collisions == other.allowed_collisions
            and self.padding_m == other.padding_m
            and self.scale == other.scale
        )

    def as_scene(self, version: int, robot: RobotModel) -> Scene:
        known = [*robot.links, *self.objects, *self.attached]
        return Scene(
            version,
            tuple(each.scene_object for each in self.objects.values()),
            tuple(each.attached_object for each in self.attached.values()),
            self.allowed_collisions.exceptions(disabled_collisions(robot), known),
            self.padding_m,
            self.scale,
        )


class SceneDraft(SceneContents):
    """Scene contents under change."""

    def __init__(self, contents: SceneContents, links: LinkTransforms) -> None:
        parts = vars(contents).items()
        copied: dict[str, Any] = {name: part.copy() if isinstance(part, dict) else part for name, part in parts}
        super().__init__(**copied)
        # The contents to start from, which stay as they are; an object that is only repeated stays the same one.
        self.before = contents
        self.links = links  # transforms of the links, which do not move meanwhile
        self.root = links.robot.root_link  # the planning frame

    def contents(self) -> SceneContents:
        """Return the changed contents; the draft is changed no more."""
        return SceneContents(**{each.name: getattr(self, each.name) for each in fields(SceneContents)})

    def is_root(self, frame_id: str) -> bool:
        """Return True for the planning frame, by its name alone."""
        return frame_id in ("", self.root)

    def in_planning_frame(self, collision_object: CollisionObject) -> CollisionObject:
        pose = self.object_pose(collision_object.name, collision_object.frame, collision_object.pose)
        if collision_object.frame == self.root:
            return collision_object
        return replace(collision_object, frame=self.root, pose=pose)

    def object_pose(self, name: str, frame_id: str, pose: Pose) -> Pose:
        """Transform the pose of an object from a frame into the planning frame."""
        try:
            return in_root(find_frame(frame_id, self, self.links), pose)
        except RefusedError as error:
            failure = error.failure
            text = f"the object {name!r}, header.frame_id: {failure.message}"
            raise refused(failure.code, text, **failure.details, object=name) from error

    def clear(self, allowed_collisions: AllowedCollisionMatrix) -> None:
        """Remove everything but the attached objects."""
        self.allowed_collisions, self.objects = allowed_collisions, {}
        self.padding_m, self.scale, self.colors = {}, {}, {}

    def forget(self, name: str) -> None:
        self.colors.pop(name, None)
        self.allowed_collisions = self.allowed_collisions.without(name)


def apply_collision_object(draft: SceneDraft, message: Message, where: str) -> None:
    name, operation = message["id"], message["operation"]
    present = draft.objects.get(name)
    if operation == APPEND and present is not None:
        draft.objects[name] = appended(draft, present, message, where)
    elif operation in (ADD, APPEND):
        _add(draft, message, where)
    elif operation == MOVE:
        _move(draft, message, where)
    elif operation == REMOVE:
        if name and name not in draft.objects:
            raise _unknown(draft, name, where)
        for each in [name] if name else list(draft.objects):
            del draft.objects[each]
            draft.forget(each)
    else:
        known = ", ".join(f"{number} ({word})" for number, word in OPERATIONS.items())
        raise invalid(f"{where}.operation of {name!r} must be one of {known}, not {operation}", object=name)


def appended(draft: SceneDraft, present: CollisionObject, message: Message, where: str) -> CollisionObject:
    """Return an object with the shapes and subframes of a moveit_msgs/CollisionObject at another pose appended."""
    more = draft.in_planning_frame(read_collision_object(message, message["header"]["frame_id"], where))
    own_pose = draft.in_planning_frame(present).pose

    def moved(pose: Pose) -> Pose:
        return pose if more.pose == own_pose else seen_from(own_pose, in_root(more.pose, pose))

    geometry, shapes = {}, []
    left, added = iter(present.shapes), iter(more.shapes)
    for kind, _, _ in GEOMETRY_KINDS:
        own, others = present.geometry[kind], more.geometry[kind]
        geometry[kind] = [*own, *others]
        shapes += [*islice(left, len(own)), *((shape, moved(at)) for shape, at in islice(added, len(others)))]
    return replace(
        present,
        type=more.type if any(more.type.values()) else present.type,
        geometry=geometry,
        shapes=tuple(shapes),
        subframes={**present.subframes, **{name: moved(at) for name, at in more.subframes.items()}},
    )


def _add(draft: SceneDraft, message: Message, where: str) -> None:
    """Add an object; an object that equals its state before the change stays the same object."""
    frame_id, known = message["header"]["frame_id"], draft.before.objects.get(message["id"])
    if known is not None and draft.is_root(frame_id) and known.equals_message(message):
        draft.objects[known.name] = known
        return
    added = draft.in_planning_frame(read_collision_object(message, frame_id, where))
    draft.objects[added.name] = known if known is not None and known.message == added.message else added


def _move(draft: SceneDraft, message: Message, where: str) -> None:
    present = draft.objects.get(message["id"])
    if present is None:
        raise _unknown(draft, message["id"], where)
    shape_poses, frame_id = read_shape_poses(message, where), message["header"]["frame_id"]
    if not shape_poses and draft.is_root(frame_id) and present.has_pose(message["pose"]):
        return
    pose, shapes = read_bounded_pose(message["pose"], f"{where}.pose"), present.shapes
    if shape_poses:
        if len(shape_poses) != len(shapes):
            raise invalid(
                f"{where}: MOVE gives the poses of {len(shape_poses)} shapes; {present.name!r} has {len(shapes)}",
                object=present.name,
            )
        pose, shapes = with_object_pose(
            pose, tuple((shape, at) for (shape, _), at in zip(shapes, shape_poses, strict=True))
        )
    pose = draft.object_pose(present.name, frame_id, pose)
    if (pose, shapes) != (present.pose, present.shapes):
        draft.objects[present.name] = replace(present, pose=pose, shapes=shapes)


def _unknown(draft: SceneDraft, name: str, where: str) -> RefusedError:
    held = draft.attached.get(name)
    if held is not None:
        text = f"{where}: the object {name!r} is held by {held.link}; detach it first"
    else:
        text = f"{where}: there is no object {name!r} in the scene"
    return refused(MoveItErrorCode.INVALID_OBJECT_NAME, text, object=name)


def apply_attached_object(draft: SceneDraft, message: Message, where: str) -> None:
    operation, name, link = message["object"]["operation"], message["object"]["id"], message["link_name"]
    # An object can be detached without naming its link.
    if link not in draft.links.robot.links and (link or operation != REMOVE):
        known = ", ".join(draft.links.robot.links)
        text = f"{where}.link_name of the object {name!r}: there is no link {link!r}; the robot has {known}"
        raise refused(MoveItErrorCode.INVALID_LINK_NAME, text, object=name, link=link)
    if operation == REMOVE:
        _detach(draft, name, link, where)
    elif operation in (ADD, APPEND):
        # An object that equals its state before the change stays the same object.
        held = draft.before.attached.get(name)
        if held is None or not held.equals_message(message):
            attached = _read_attached(draft, message, where)
            held = held if held is not None and held.message == attached.message else attached
        draft.objects.pop(name, None)
        draft.attached[name] = held
    else:
        text = f"{where}.object.operation of {name!r} must be 0 (ADD), 1 (REMOVE) or 2 (APPEND), not {operation}"
        raise invalid(text, object=name)


def _read_attached(draft: SceneDraft, message: Message, where: str) -> AttachedCollisionObject:
    added, touch_links = message["object"], message["touch_links"]
    collision_object = _in_link(draft, _object_to_attach(draft, added, f"{where}.object"), message["link_name"])
    present = draft.attached.get(added["id"])
    if present is not None and added["operation"] == APPEND:
        touch_links = [*present.touch_links, *touch_links]
    unique_links = tuple(dict.fromkeys(touch_links))
    return AttachedCollisionObject(collision_object, unique_links, message["detach_posture"], message["weight"])


def _object_to_attach(draft: SceneDraft, message: Message, where: str) -> CollisionObject:
    name = message["id"]
    known = draft.attached[name].collision_object if name in draft.attached else draft.objects.get(name)
    if known is not None and message["operation"] == APPEND:
        return appended(draft, known, message, where)
    if has_geometry(message):
        return read_collision_object(message, message["header"]["frame_id"], where)
    if known is None:
        text = f"{where}: the object {name!r} has no shape, and the scene has no object of this name"
        raise refused(MoveItErrorCode.INVALID_OBJECT_NAME, text, object=name)
    return known


def _in_link(draft: SceneDraft, collision_object: CollisionObject, link: str) -> CollisionObject:
    """Return an object with its pose in the frame of a link; unchanged, without rounding, if that is its frame."""
    if collision_object.frame == link:
        return collision_object
    pose = seen_from(find_frame(link, draft, draft.links), draft.in_planning_frame(collision_object).pose)
    return replace(collision_object, frame=link, pose=pose)


def _detach(draft: SceneDraft, name: str, link: str, where: str) -> None:
    """Detach one object, or all that a link holds; they stay where they are now."""
    if name and name not in draft.attached:
        text = f"{where}.object: no link holds an object {name!r}"
        raise refused(MoveItErrorCode.INVALID_OBJECT_NAME, text, object=name)
    for held in [draft.attached[name]] if name else list(draft.attached.values()):
        if link in ("", held.link):
            detached = draft.in_planning_frame(held.collision_object)
            del draft.attached[detached.name]
            draft.objects[detached.name] = detached
        elif name:
            text = f"{where}.link_name: the object {name!r} is held by {held.link}, not by {link!r}"
            raise refused(MoveItErrorCode.INVALID_LINK_NAME, text, object=name, link=link)


def apply_planning_scene(draft: SceneDraft, message: Message, srdf_matrix: AllowedCollisionMatrix) -> None:
    """Apply a moveit_msgs/PlanningScene, in MoveIt's order: attached objects before objects of the world."""
    scene = {**EMPTY_DIFF, **message}
    if not scene["is_diff"]:
        draft.clear(srdf_matrix)
    if scene["name"]:
        draft.name = scene["name"]
    _apply_attached_objects(draft, scene["robot_state"], whole=not scene["is_diff"])
    matrix = scene["allowed_collision_matrix"]
    # A matrix without names is a field that the client has left out.
    if (matrix["entry_names"] or matrix["default_entry_names"]) and matrix != draft.allowed_collisions.message:
        draft.allowed_collisions = read_allowed_collision_matrix(matrix)
    _apply_link_values(draft, draft.padding_m, scene, "padding", NO_PADDING_M)
    _apply_link_values(draft, draft.scale, scene, "scale", NO_SCALE)
    for i, entry in enumerate(scene["object_colors"]):
        if not all(math.isfinite(value) for value in entry["color"].values()):
            raise invalid(f"object_colors[{i}].color of {entry['id']!r} is not finite: {entry['color']}")
        draft.colors[entry["id"]] = entry["color"]
    if len(draft.colors) > MAX_COLORS:
        raise invalid(f"object_colors would name {len(draft.colors)} objects, more than {MAX_COLORS}")
    apply_world(draft, scene["world"])


def apply_world(draft: SceneDraft, world: Message) -> None:
    if world["octomap"]["octomap"]["data"]:
        text = "world.octomap must be empty: contacts with an octomap are not checked; give boxes or a mesh instead"
        raise refused(MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE, text, field="world.octomap")
    objects = world["collision_objects"]
    _check_shape_count(objects, "world")
    for i, each in enumerate(objects):
        apply_collision_object(draft, each, f"world.collision_objects[{i}]")


def _apply_attached_objects(draft: SceneDraft, robot_state: Message, *, whole: bool) -> None:
    """Apply the attached objects of a moveit_msgs/RobotState; a state that is no diff detaches all others.

    A state that is no diff, without joints and objects, is a field that the client has left out: it changes nothing.
    """
    attached = robot_state["attached_collision_objects"]
    # A state without joint_state is made in the server, for the attached objects alone.
    is_given = whole or attached or "joint_state" not in robot_state or robot_state["joint_state"]["name"]
    if is_given and not robot_state["is_diff"]:
        listed = {each["object"]["id"] for each in attached}
        draft.attached = {name: held for name, held in draft.attached.items() if name in listed}
    _check_shape_count([each["object"] for each in attached], "robot_state")
    for i, each in enumerate(attached):
        apply_attached_object(draft, each, f"robot_state.attached_collision_objects[{i}]")


def _check_shape_count(objects: Sequence[Message], where: str) -> None:
    """Reject more shapes than a scene holds before any is read: reading a mesh takes time and memory."""
    count = sum(len(each[field]) for each in objects for field, _, _ in GEOMETRY_KINDS)
    if count > MAX_SHAPES:
        raise invalid(f"{where} brings {count} shapes; a scene holds {MAX_SHAPES}", shapes=count, limit=MAX_SHAPES)


def _apply_link_values(draft: SceneDraft, values: dict[str, float], scene: Message, kind: str, default: float) -> None:
    """Set padding or scale of links; default values are not kept, so that equal scenes compare equal."""
    field = f"link_{kind}"
    for entry in scene[field]:
        link, value = entry["link_name"], entry[kind]
        if link not in draft.links.robot.links:
            text = f"{field}: there is no link {link!r}; the robot has {', '.join(draft.links.robot.links)}"
            raise refused(MoveItErrorCode.INVALID_LINK_NAME, text, link=link)
        if not (math.isfinite(value) and 0.0 <= value <= MAX_LENGTH_M) or (default == NO_SCALE and value == 0.0):
            lowest = "at least" if default == NO_PADDING_M else "above"
            raise invalid(f"{field} of {link!r} must be {lowest} 0, up to {MAX_LENGTH_M:g}, not {value:g}", link=link)
        values.pop(link, None)
        if value != default:
            values[link] = value

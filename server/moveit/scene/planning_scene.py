"""The contents of a planning scene, and how MoveIt's messages change them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Pose, Scene
from planners.scene_checks import MAX_LENGTH_M, MAX_SHAPES
from robot.model import RobotModel
from server.errors import RefusedError
from server.moveit.requests.error_codes import invalid, refused, required
from server.moveit.scene.allowed_collision_matrix import ContactMatrix, read_matrix, unchecked_pairs
from server.moveit.scene.collision_objects import (
    ADD,
    APPEND,
    KINDS,
    MOVE,
    REMOVE,
    HeldThing,
    Shapes,
    Thing,
    has_geometry,
    read_pose_within,
    read_shape_poses,
    read_thing,
    swapped,
)
from server.moveit.scene.frames import LinkPlaces, find_frame, in_root, seen_from

Message = Mapping[str, Any]

# MoveIt's name of a scene that was given none.
NO_NAME = "(noname)"


@dataclass(frozen=True)
class SceneContents:
    """A planning scene; things are told apart by identity, so that two of them are quickly compared.

    Attributes:
        matrix: who may touch whom.
        name: of the scene.
        objects: what stands around, by name, in the planning frame.
        attached: what links hold, by name.
        padding_m: link -> by how much it is thickened [m]; those not in it are not.
        scale: link -> by which factor it is enlarged; those not in it are not.
        colors: link or thing -> std_msgs/ColorRGBA.
        fixed_frames: further frames, by name, in the root link.
    """

    matrix: ContactMatrix
    name: str = NO_NAME
    objects: Mapping[str, Thing] = field(default_factory=dict)
    attached: Mapping[str, HeldThing] = field(default_factory=dict)
    padding_m: Mapping[str, float] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    colors: Mapping[str, Message] = field(default_factory=dict)
    fixed_frames: Mapping[str, Pose] = field(default_factory=dict)

    def looks_like(self, other: SceneContents) -> bool:
        """Whether planners can see no difference between two."""
        return (
            self.objects == other.objects
            and self.attached == other.attached
            and self.matrix == other.matrix
            and self.padding_m == other.padding_m
            and self.scale == other.scale
        )

    def as_scene(self, version: int, robot: RobotModel) -> Scene:
        """The scene as planners have it.

        Args:
            version: a number that no other scene has.
            robot: whose SRDF says what may touch without being told so.
        """
        known = [*robot.links, *self.objects, *self.attached]
        return Scene(
            version,
            tuple(thing.object for thing in self.objects.values()),
            tuple(held.object for held in self.attached.values()),
            self.matrix.exceptions(unchecked_pairs(robot), known),
            self.padding_m,
            self.scale,
        )


class Draft:
    """A scene's contents while they are being changed.

    Args:
        contents: what there is; it stays as it is.
        links: where the links are meanwhile.

    Attributes:
        before: what there was, of which things are kept that are only said again.
        links: as given.

    The other attributes are those of :class:`SceneContents`.
    """

    def __init__(self, contents: SceneContents, links: LinkPlaces) -> None:
        self.before = contents
        self.links = links
        self.matrix = contents.matrix
        self.name = contents.name
        self.objects: dict[str, Thing] = dict(contents.objects)
        self.attached: dict[str, HeldThing] = dict(contents.attached)
        self.padding_m: dict[str, float] = dict(contents.padding_m)
        self.scale: dict[str, float] = dict(contents.scale)
        self.colors: dict[str, Message] = dict(contents.colors)
        self.fixed_frames: dict[str, Pose] = dict(contents.fixed_frames)

    @property
    def root(self) -> str:
        """The planning frame."""
        return self.links.root_link

    def contents(self) -> SceneContents:
        """What has come of it."""
        return SceneContents(
            self.matrix,
            self.name,
            self.objects,
            self.attached,
            self.padding_m,
            self.scale,
            self.colors,
            self.fixed_frames,
        )

    def is_root(self, frame_id: str) -> bool:
        """Whether a frame is the planning frame by its name alone."""
        return frame_id in ("", self.root)

    def frame(self, frame_id: str) -> Pose:
        """Pose of a frame in the planning frame.

        Raises:
            RefusedError: nobody knows where it is.
        """
        return required(find_frame(frame_id, self, self.links))

    def placed(self, thing: Thing) -> Thing:
        """A thing with its pose in the planning frame.

        Raises:
            RefusedError: nobody knows where its own frame is.
        """
        pose = self.place(thing.name, thing.frame, thing.pose)
        return thing if thing.frame == self.root else replace(thing, frame=self.root, pose=pose)

    def place(self, name: str, frame_id: str, pose: Pose) -> Pose:
        """A thing's pose that is given in a frame, in the planning frame.

        Raises:
            RefusedError: nobody knows where the frame is.
        """
        frame = find_frame(frame_id, self, self.links)
        if isinstance(frame, PlanningFailure):
            text = f"the object {name!r}, header.frame_id: {frame.message}"
            raise refused(frame.code, text, **frame.details, object=name)
        return in_root(frame, pose)

    def clear(self, matrix: ContactMatrix) -> None:
        """Begin anew, except for what is held.

        Args:
            matrix: who may touch whom.
        """
        self.matrix, self.objects = matrix, {}
        self.padding_m, self.scale, self.colors, self.fixed_frames = {}, {}, {}, {}

    def forget(self, name: str) -> None:
        """Forget what was said of a thing that is no more."""
        self.colors.pop(name, None)
        self.matrix = self.matrix.without(name)


OPERATIONS = {ADD: "ADD", REMOVE: "REMOVE", APPEND: "APPEND", MOVE: "MOVE"}


def change_object(draft: Draft, message: Message, where: str) -> None:
    """Do what a moveit_msgs/CollisionObject says.

    Args:
        draft: the scene.
        message: the object.
        where: path of the field, for the refusal.

    Raises:
        RefusedError: it cannot be done.
    """
    name, operation = message["id"], message["operation"]
    present = draft.objects.get(name)
    if operation == APPEND and present is not None:
        draft.objects[name] = appended(draft, present, message, where)
    elif operation in (ADD, APPEND):
        _add(draft, message, where)
    elif operation == MOVE:
        _move(draft, message, where)
    elif operation == REMOVE:
        _remove(draft, name, where)
    else:
        known = ", ".join(f"{number} ({word})" for number, word in OPERATIONS.items())
        raise invalid(f"{where}.operation of {name!r} must be one of {known}, not {operation}", object=name)


def appended(draft: Draft, present: Thing, message: Message, where: str) -> Thing:
    """A thing with the shapes and subframes of an object added to it; they stay where the object has them.

    Args:
        draft: the scene.
        present: the thing, its pose in any frame.
        message: the object; its pose need not be that of the thing.
        where: path of the field, for the refusal.

    Raises:
        RefusedError: the object cannot be used.
    """
    more = draft.placed(read_thing(message, message["header"]["frame_id"], where))
    own_pose = draft.placed(present).pose

    def moved(pose: Pose) -> Pose:
        return pose if more.pose == own_pose else seen_from(own_pose, in_root(more.pose, pose))

    before = _by_kind(present.told, present.shapes)
    added = _by_kind(more.told, tuple((shape, moved(at)) for shape, at in more.shapes))
    return replace(
        present,
        type=more.type if any(more.type.values()) else present.type,
        told={field: [*present.told[field], *more.told[field]] for field in before},
        shapes=tuple(each for field in before for each in (*before[field], *added[field])),
        subframes={**present.subframes, **{name: moved(at) for name, at in more.subframes.items()}},
    )


def _add(draft: Draft, message: Message, where: str) -> None:
    """Add a thing, or keep the one there was where nothing new is said of it."""
    frame_id, known = message["header"]["frame_id"], draft.before.objects.get(message["id"])
    if known is not None and draft.is_root(frame_id) and known.told_again_by(message):
        draft.objects[known.name] = known
        return
    thing = draft.placed(read_thing(message, frame_id, where))
    draft.objects[thing.name] = known if known is not None and known.same_as(thing) else thing


def _move(draft: Draft, message: Message, where: str) -> None:
    present = draft.objects.get(message["id"])
    if present is None:
        raise _unknown(draft, message["id"], where)
    shape_poses, frame_id = read_shape_poses(message, where), message["header"]["frame_id"]
    if not shape_poses and draft.is_root(frame_id) and present.is_at(message["pose"]):
        return
    pose, shapes = read_pose_within(message["pose"], f"{where}.pose"), present.shapes
    if shape_poses:
        if len(shape_poses) != len(shapes):
            raise invalid(
                f"{where}: MOVE gives the poses of {len(shape_poses)} shapes; {present.name!r} has {len(shapes)}",
                object=present.name,
            )
        pose, shapes = swapped(pose, tuple((shape, at) for (shape, _), at in zip(shapes, shape_poses, strict=True)))
    pose = draft.place(present.name, frame_id, pose)
    if (pose, shapes) != (present.pose, present.shapes):
        draft.objects[present.name] = replace(present, pose=pose, shapes=shapes)


def _remove(draft: Draft, name: str, where: str) -> None:
    if name and name not in draft.objects:
        raise _unknown(draft, name, where)
    for each in [name] if name else list(draft.objects):
        del draft.objects[each]
        draft.forget(each)


def _unknown(draft: Draft, name: str, where: str) -> RefusedError:
    held = draft.attached.get(name)
    if held is not None:
        text = f"{where}: the object {name!r} is held by {held.link}; detach it first"
    else:
        text = f"{where}: there is no object {name!r} in the scene"
    return refused(MoveItErrorCode.INVALID_OBJECT_NAME, text, object=name)


def _by_kind(told: Mapping[str, Any], shapes: Shapes) -> dict[str, Shapes]:
    """Shapes with their poses, by field of the message."""
    kinds = {}
    for field, _, _ in KINDS:
        count = len(told[field])
        kinds[field], shapes = shapes[:count], shapes[count:]
    return kinds


def change_held_object(draft: Draft, message: Message, where: str) -> None:
    """Do what a moveit_msgs/AttachedCollisionObject says.

    Args:
        draft: the scene.
        message: the object, and who holds it.
        where: path of the field, for the refusal.

    Raises:
        RefusedError: it cannot be done.
    """
    told, link = message["object"], message["link_name"]
    operation, name = told["operation"], told["id"]
    # Only what is put down may be told without saying who holds it.
    if link not in draft.links.names and (link or operation != REMOVE):
        known = ", ".join(draft.links.names)
        text = f"{where}.link_name of the object {name!r}: there is no link {link!r}; the robot has {known}"
        raise refused(MoveItErrorCode.INVALID_LINK_NAME, text, object=name, link=link)
    if operation == REMOVE:
        _put_down(draft, name, link, where)
    elif operation in (ADD, APPEND):
        _take(draft, message, where)
    else:
        text = f"{where}.object.operation of {name!r} must be 0 (ADD), 1 (REMOVE) or 2 (APPEND), not {operation}"
        raise invalid(text, object=name)


def _take(draft: Draft, message: Message, where: str) -> None:
    """Have a link hold a thing, or keep what it held where nothing new is said of it."""
    name = message["object"]["id"]
    known = draft.before.attached.get(name)
    if known is None or not known.told_again_by(message):
        held = _held(draft, message, where)
        known = known if known is not None and known.same_as(held) else held
    draft.objects.pop(name, None)
    draft.attached[name] = known


def _held(draft: Draft, message: Message, where: str) -> HeldThing:
    told, touch_links = message["object"], message["touch_links"]
    thing = _seen_from_link(draft, _thing_to_take(draft, told, f"{where}.object"), message["link_name"])
    present = draft.attached.get(told["id"])
    if present is not None and told["operation"] == APPEND:
        touch_links = [*present.touch_links, *touch_links]
    # Each once, in their order.
    return HeldThing(thing, tuple(dict.fromkeys(touch_links)), message["detach_posture"], message["weight"])


def _thing_to_take(draft: Draft, told: Message, where: str) -> Thing:
    """The thing that is meant, wherever it is: the one told of, one that is known, or both together."""
    name = told["id"]
    known = draft.attached[name].thing if name in draft.attached else draft.objects.get(name)
    if known is not None and told["operation"] == APPEND:
        return appended(draft, known, told, where)
    if has_geometry(told):
        return read_thing(told, told["header"]["frame_id"], where)
    if known is None:
        text = f"{where}: the object {name!r} has no shape, and there is none of this name in the scene"
        raise refused(MoveItErrorCode.INVALID_OBJECT_NAME, text, object=name)
    return known


def _seen_from_link(draft: Draft, thing: Thing, link: str) -> Thing:
    """The thing with its pose in the link; exactly as told where that is its frame."""
    if thing.frame == link:
        return thing
    return replace(thing, frame=link, pose=seen_from(draft.frame(link), draft.placed(thing).pose))


def _put_down(draft: Draft, name: str, link: str, where: str) -> None:
    """Leave one thing, or all that a link holds, where it is now."""
    if name and name not in draft.attached:
        text = f"{where}.object: no link holds an object {name!r}"
        raise refused(MoveItErrorCode.INVALID_OBJECT_NAME, text, object=name)
    for held in [draft.attached[name]] if name else list(draft.attached.values()):
        if link in ("", held.link):
            down = draft.placed(held.thing)
            del draft.attached[down.name]
            draft.objects[down.name] = down
        elif name:
            text = f"{where}.link_name: the object {name!r} is held by {held.link}, not by {link!r}"
            raise refused(MoveItErrorCode.INVALID_LINK_NAME, text, object=name, link=link)


# Colours and frames may be told of things that do not exist yet.
MAX_COLORS = 2000
MAX_FIXED_FRAMES = 1000

# What links have when nothing is told of them.
NO_PADDING_M = 0.0
NO_SCALE = 1.0

# What a moveit_msgs/PlanningScene says with the fields that its maker, in the server itself, has left out.
NOTHING: Message = {
    "name": "",
    "robot_model_name": "",
    "fixed_frame_transforms": (),
    "robot_state": {"is_diff": True, "attached_collision_objects": ()},
    "allowed_collision_matrix": {"entry_names": (), "default_entry_names": ()},
    "link_padding": (),
    "link_scale": (),
    "object_colors": (),
    "world": {"collision_objects": (), "octomap": {"octomap": {"data": ()}}},
}


def change_scene(draft: Draft, message: Message, of_robot: ContactMatrix) -> None:
    """Do what a moveit_msgs/PlanningScene says, in MoveIt's order: what is held before what stands around.

    Args:
        draft: the scene.
        message: the scene's difference, or the whole scene that is to be there instead; fields may be left out.
        of_robot: the matrix of the SRDF, for a whole scene that brings none.

    Raises:
        RefusedError: it cannot be done.
    """
    told = {**NOTHING, **message}
    if not told["is_diff"]:
        draft.clear(of_robot)
    if told["name"]:
        draft.name = told["name"]
    _change_frames(draft, told["fixed_frame_transforms"])
    _change_held(draft, told["robot_state"], whole=not told["is_diff"])
    _change_matrix(draft, told["allowed_collision_matrix"])
    _change_links(draft, draft.padding_m, [(e["link_name"], e["padding"]) for e in told["link_padding"]], NO_PADDING_M)
    _change_links(draft, draft.scale, [(e["link_name"], e["scale"]) for e in told["link_scale"]], NO_SCALE)
    _change_colors(draft, told["object_colors"])
    change_world(draft, told["world"], "world")


def change_world(draft: Draft, world: Message, where: str) -> None:
    """Do what a moveit_msgs/PlanningSceneWorld says.

    Args:
        draft: the scene.
        world: what stands around.
        where: path of the field, for the refusal.

    Raises:
        RefusedError: it cannot be done.
    """
    if world["octomap"]["octomap"]["data"]:
        text = f"{where}.octomap must be empty: contacts with an octomap are not checked; give boxes or a mesh instead"
        raise refused(MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE, text, field=f"{where}.octomap")
    told = world["collision_objects"]
    _refuse_far_too_many(told, where)
    for i, each in enumerate(told):
        change_object(draft, each, f"{where}.collision_objects[{i}]")


def _change_held(draft: Draft, robot_state: Message, *, whole: bool) -> None:
    """What is held; a state that is no difference leaves held only what it lists, unless it says nothing at all."""
    told = robot_state["attached_collision_objects"]
    # A state without the field is made in the server, of what is held alone.
    says_something = whole or told or "joint_state" not in robot_state or robot_state["joint_state"]["name"]
    if says_something and not robot_state["is_diff"]:
        listed = {each["object"]["id"] for each in told}
        draft.attached = {name: held for name, held in draft.attached.items() if name in listed}
    _refuse_far_too_many([each["object"] for each in told], "robot_state")
    for i, each in enumerate(told):
        change_held_object(draft, each, f"robot_state.attached_collision_objects[{i}]")


def _refuse_far_too_many(objects: Sequence[Message], where: str) -> None:
    """Refuse more than a scene can hold before any of it is read."""
    count = sum(len(each[field]) for each in objects for field, _, _ in KINDS)
    if count > MAX_SHAPES:
        raise invalid(f"{where} brings {count} shapes; a scene holds {MAX_SHAPES}", shapes=count, limit=MAX_SHAPES)


def _change_matrix(draft: Draft, message: Message) -> None:
    """Take a matrix over; one without names says nothing."""
    if (message["entry_names"] or message["default_entry_names"]) and message != draft.matrix.message:
        draft.matrix = read_matrix(message, "allowed_collision_matrix")


def _change_links(draft: Draft, values: dict[str, float], told: Sequence[tuple[str, float]], untold: float) -> None:
    """Padding or scale; what links have untold is not kept, so that equal scenes are equal."""
    field = "link_padding" if untold == NO_PADDING_M else "link_scale"
    for link, value in told:
        if link not in draft.links.names:
            text = f"{field}: there is no link {link!r}; the robot has {', '.join(draft.links.names)}"
            raise refused(MoveItErrorCode.INVALID_LINK_NAME, text, link=link)
        if not (math.isfinite(value) and 0.0 <= value <= MAX_LENGTH_M) or (untold == NO_SCALE and value == 0.0):
            lowest = "at least" if untold == NO_PADDING_M else "above"
            raise invalid(f"{field} of {link!r} must be {lowest} 0, up to {MAX_LENGTH_M:g}, not {value:g}", link=link)
        values.pop(link, None)
        if value != untold:
            values[link] = value


def _change_colors(draft: Draft, messages: Sequence[Message]) -> None:
    for i, entry in enumerate(messages):
        if not all(math.isfinite(value) for value in entry["color"].values()):
            raise invalid(f"object_colors[{i}].color of {entry['id']!r} is not finite: {entry['color']}")
        draft.colors[entry["id"]] = entry["color"]
    if len(draft.colors) > MAX_COLORS:
        raise invalid(f"object_colors would name {len(draft.colors)} things, more than {MAX_COLORS}")


def _change_frames(draft: Draft, messages: Sequence[Message]) -> None:
    """Frames that stand still in the planning frame; that frame itself may be among them and says nothing."""
    for i, entry in enumerate(messages):
        where = f"fixed_frame_transforms[{i}]"
        name, frame_id = entry["child_frame_id"].removeprefix("/"), entry["header"]["frame_id"]
        if draft.is_root(name):
            continue
        if not draft.is_root(frame_id.removeprefix("/")):
            text = f"{where}.header.frame_id must be the planning frame {draft.root!r}, not {frame_id!r}"
            raise refused(MoveItErrorCode.FRAME_TRANSFORM_FAILURE, text, frame=frame_id)
        transform = entry["transform"]
        pose = {"position": transform["translation"], "orientation": transform["rotation"]}
        draft.fixed_frames[name] = read_pose_within(pose, f"{where}.transform")
    if len(draft.fixed_frames) > MAX_FIXED_FRAMES:
        raise invalid(f"there would be {len(draft.fixed_frames)} fixed frames, more than {MAX_FIXED_FRAMES}")

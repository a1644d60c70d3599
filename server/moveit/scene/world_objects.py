"""moveit_msgs/CollisionObject: what it changes of the things that stand around."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from planners.problem import MoveItErrorCode
from planners.scene import Pose
from server.errors import RefusedError
from server.moveit.requests.refusals import invalid, refused
from server.moveit.scene.contents import Draft
from server.moveit.scene.frames import in_root, seen_from
from server.moveit.scene.things import (
    ADD,
    APPEND,
    KINDS,
    MOVE,
    REMOVE,
    Shapes,
    Thing,
    read_pose_within,
    read_shape_poses,
    read_thing,
    swapped,
)

Message = Mapping[str, Any]

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

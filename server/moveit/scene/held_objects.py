"""moveit_msgs/AttachedCollisionObject: what it changes of the things that links hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from planners.problem import MoveItErrorCode
from server.moveit.requests.refusals import invalid, refused
from server.moveit.scene.contents import Draft
from server.moveit.scene.frames import seen_from
from server.moveit.scene.things import (
    ADD,
    APPEND,
    REMOVE,
    HeldThing,
    Thing,
    has_geometry,
    read_thing,
)
from server.moveit.scene.world_objects import appended

Message = Mapping[str, Any]


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

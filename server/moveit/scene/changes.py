"""moveit_msgs/PlanningScene: what it changes of a scene, as a difference or as the whole."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from planners.problem import MoveItErrorCode
from planners.scene_checks import MAX_LENGTH_M, MAX_SHAPES
from server.moveit.requests.refusals import invalid, refused
from server.moveit.scene.contents import Draft
from server.moveit.scene.held_objects import change_held_object
from server.moveit.scene.matrix import ContactMatrix, read_matrix
from server.moveit.scene.things import KINDS, read_pose_within
from server.moveit.scene.world_objects import change_object

Message = Mapping[str, Any]

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

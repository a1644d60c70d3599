"""The planning scene as messages: the whole of it or the parts asked for, and what has changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from planners.scene import Pose
from robot.description.model import RobotModel
from server.moveit.poses import write_pose
from server.moveit.scene.changes import NO_PADDING_M, NO_SCALE
from server.moveit.scene.contents import SceneContents
from server.moveit.scene.things import ADD, IDENTITY, NO_STAMP, REMOVE

Message = Mapping[str, Any]

# moveit_msgs/PlanningSceneComponents
SCENE_SETTINGS = 1
ROBOT_STATE = 2
ROBOT_STATE_ATTACHED_OBJECTS = 4
WORLD_OBJECT_NAMES = 8
WORLD_OBJECT_GEOMETRY = 16
OCTOMAP = 32
TRANSFORMS = 64
ALLOWED_COLLISION_MATRIX = 128
LINK_PADDING_AND_SCALING = 256
OBJECT_COLORS = 512
EVERYTHING = 1023

NO_HEADER = {"stamp": NO_STAMP, "frame_id": ""}
NO_OCTOMAP = {
    "header": NO_HEADER,
    "origin": write_pose(IDENTITY),
    "octomap": {"header": NO_HEADER, "binary": False, "id": "", "resolution": 0.0, "data": []},
}
NO_MATRIX: Message = {
    "entry_names": [],
    "entry_values": [],
    "default_entry_names": [],
    "default_entry_values": [],
}
NO_STATE: Message = {
    "joint_state": {"header": NO_HEADER, "name": [], "position": [], "velocity": [], "effort": []},
    "multi_dof_joint_state": {"header": NO_HEADER, "joint_names": [], "transforms": [], "twist": [], "wrench": []},
    "attached_collision_objects": [],
    "is_diff": False,
}
NO_OBJECT: Message = {
    "header": NO_HEADER,
    "pose": write_pose(IDENTITY),
    "id": "",
    "type": {"key": "", "db": ""},
    "primitives": [],
    "primitive_poses": [],
    "meshes": [],
    "mesh_poses": [],
    "planes": [],
    "plane_poses": [],
    "subframe_names": [],
    "subframe_poses": [],
    "operation": ADD,
}


def scene_message(contents: SceneContents, robot: RobotModel, state: Message, components: int) -> dict[str, Any]:
    """The moveit_msgs/PlanningScene of a scene, with every field, empty where it was not asked for.

    Args:
        contents: the scene.
        robot: the arm.
        state: its moveit_msgs/RobotState without what is held.
        components: sum of what is wanted, as moveit_msgs/PlanningSceneComponents; 0 for everything, as in MoveIt.
    """
    wanted = components or EVERYTHING
    settings, links = wanted & SCENE_SETTINGS, wanted & LINK_PADDING_AND_SCALING
    return {
        "name": contents.name if settings else "",
        "robot_state": _state(contents, state, wanted),
        "robot_model_name": robot.name if settings else "",
        "fixed_frame_transforms": _transforms(contents, robot) if wanted & TRANSFORMS else [],
        "allowed_collision_matrix": contents.matrix.message if wanted & ALLOWED_COLLISION_MATRIX else NO_MATRIX,
        "link_padding": _padding(contents, robot) if links else [],
        "link_scale": _scale(contents, robot) if links else [],
        "object_colors": _colors(contents) if wanted & OBJECT_COLORS else [],
        "world": {"collision_objects": _objects(contents, robot, wanted), "octomap": NO_OCTOMAP},
        "is_diff": False,
    }


def difference(before: SceneContents, after: SceneContents, robot: RobotModel) -> dict[str, Any]:
    """The moveit_msgs/PlanningScene that makes one scene of another; colours and frames that are gone stay in it."""
    links = (before.padding_m, before.scale) != (after.padding_m, after.scale)
    return {
        "name": after.name,
        "robot_state": {**NO_STATE, "attached_collision_objects": _changed_attached(before, after), "is_diff": True},
        "robot_model_name": robot.name,
        "fixed_frame_transforms": _transforms(after, robot) if before.fixed_frames != after.fixed_frames else [],
        "allowed_collision_matrix": after.matrix.message if before.matrix != after.matrix else NO_MATRIX,
        "link_padding": _padding(after, robot) if links else [],
        "link_scale": _scale(after, robot) if links else [],
        "object_colors": _colors(after) if before.colors != after.colors else [],
        "world": {"collision_objects": _changed_objects(before, after), "octomap": NO_OCTOMAP},
        "is_diff": True,
    }


def _state(contents: SceneContents, state: Message, wanted: int) -> Message:
    if wanted & ROBOT_STATE_ATTACHED_OBJECTS:
        return {**state, "attached_collision_objects": [held.message for held in contents.attached.values()]}
    return state if wanted & ROBOT_STATE else NO_STATE


def _objects(contents: SceneContents, robot: RobotModel, wanted: int) -> list[Message]:
    if wanted & WORLD_OBJECT_GEOMETRY:
        return [thing.message for thing in contents.objects.values()]
    if wanted & WORLD_OBJECT_NAMES:
        header = {"stamp": NO_STAMP, "frame_id": robot.root_link}
        return [
            {**NO_OBJECT, "header": header, "id": name, "type": thing.type} for name, thing in contents.objects.items()
        ]
    return []


def _changed_objects(before: SceneContents, after: SceneContents) -> list[Message]:
    # What is held now is taken from the world by being attached.
    gone = [name for name in _known(before) if name not in _known(after)]
    changed = [thing.message for name, thing in after.objects.items() if before.objects.get(name) is not thing]
    return [*({**NO_OBJECT, "id": name, "operation": REMOVE} for name in gone), *changed]


def _changed_attached(before: SceneContents, after: SceneContents) -> list[Message]:
    # Being put down comes first, so that all that is gone stands around when it is removed.
    put_down = [
        {"link_name": held.link, "object": {**NO_OBJECT, "id": name, "operation": REMOVE}}
        for name, held in before.attached.items()
        if name not in after.attached
    ]
    taken = [held.message for name, held in after.attached.items() if before.attached.get(name) is not held]
    return [*put_down, *taken]


def _known(contents: SceneContents) -> dict[str, object]:
    return {**contents.objects, **contents.attached}


def _padding(contents: SceneContents, robot: RobotModel) -> list[Message]:
    return [{"link_name": link, "padding": contents.padding_m.get(link, NO_PADDING_M)} for link in robot.links]


def _scale(contents: SceneContents, robot: RobotModel) -> list[Message]:
    return [{"link_name": link, "scale": contents.scale.get(link, NO_SCALE)} for link in robot.links]


def _colors(contents: SceneContents) -> list[Message]:
    return [{"id": name, "color": color} for name, color in contents.colors.items()]


def _transforms(contents: SceneContents, robot: RobotModel) -> list[Message]:
    """Frames that stand still; as in MoveIt the planning frame is among them."""
    return [
        _transform(robot.root_link, name, pose)
        for name, pose in {robot.root_link: IDENTITY, **contents.fixed_frames}.items()
    ]


def _transform(root: str, name: str, pose: Pose) -> Message:
    written = write_pose(pose)
    return {
        "header": {"stamp": NO_STAMP, "frame_id": root},
        "child_frame_id": name,
        "transform": {"translation": written["position"], "rotation": written["orientation"]},
    }

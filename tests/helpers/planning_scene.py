"""Messages of the planning scene, complete as the server has them, and a scene to apply them to."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planners.problem import PlanningFailure
from protocol.messages import Stamp, complete
from protocol.registry import Registry
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from robot.messages import ArmState, Mode
from server.errors import RefusedError
from server.execution.current_state import CurrentState
from server.moveit.scene.frames import LinkTransforms
from server.moveit.scene.planning_scene import SceneDraft
from server.moveit.scene.scene_state import SceneState

REGISTRY = Registry.load()
ROBOT = model.builtin()
JOINTS = tuple(joint.name for joint in ROBOT.movable_joints)
BENT = dict.fromkeys(JOINTS, 0.2)
FORWARD = ForwardPlacements(ROBOT)
Quaternion = tuple[float, float, float, float]


def message(type_name: str, **fields: Any) -> dict[str, Any]:
    """A complete message of moveit_msgs or, where the name says so, of another package."""
    name = type_name if "/" in type_name else f"moveit_msgs/{type_name}"
    return complete(REGISTRY, name, fields, Stamp(0, 0))


def pose(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, *, turned: Quaternion = (0.0, 0.0, 0.0, 1.0)
) -> dict[str, Any]:
    """A geometry_msgs/Pose."""
    return {"position": {"x": x, "y": y, "z": z}, "orientation": dict(zip("xyzw", turned, strict=True))}


def box(name: str, *, at: dict[str, Any] | None = None, frame: str = "", **fields: Any) -> dict[str, Any]:
    """A moveit_msgs/CollisionObject that adds a cube with edges of 5 cm."""
    cube = {"type": 1, "dimensions": [0.05, 0.05, 0.05]}
    return {"id": name, "primitives": [cube], "pose": at or pose(), "header": {"frame_id": frame}, **fields}


def collision_object(**fields: Any) -> dict[str, Any]:
    """A complete moveit_msgs/CollisionObject."""
    return message("CollisionObject", **fields)


def held(name: str, link: str = "gripper_link", *, touch_links: tuple[str, ...] = (), **fields: Any) -> dict[str, Any]:
    """A complete moveit_msgs/AttachedCollisionObject."""
    told = {"link_name": link, "touch_links": list(touch_links), "object": {"id": name, **fields}}
    return message("AttachedCollisionObject", **told)


def diff(**fields: Any) -> dict[str, Any]:
    """A complete moveit_msgs/PlanningScene that is a difference; so is its robot_state unless it says otherwise."""
    state = {"is_diff": True, **fields.pop("robot_state", {})}
    return message("PlanningScene", is_diff=True, robot_state=state, **fields)


def scene_state(*objects: dict[str, Any]) -> SceneState:
    """A scene in which objects stand around."""
    state = SceneState(ROBOT)
    state.apply_diff(diff(world={"collision_objects": list(objects)}), BENT)
    return state


def draft(*objects: dict[str, Any]) -> SceneDraft:
    """The same scene while it is being changed."""
    return SceneDraft(scene_state(*objects).contents, LinkTransforms(ROBOT, FORWARD, BENT))


def rejection(function: Callable[..., object], *arguments: object) -> PlanningFailure:
    """The failure of a call that must be rejected."""
    with pytest.raises(RefusedError) as raised:
        function(*arguments)
    return raised.value.failure


def current_state(position_rad: float = 0.2) -> CurrentState:
    """An arm whose joints all are at a position."""
    at = np.full(len(JOINTS), position_rad)
    return CurrentState(SimpleNamespace(state=ArmState(0.0, Mode.HOLDING, JOINTS, position_rad=at, goal_rad=at)), ROBOT)

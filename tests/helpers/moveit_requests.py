"""Complete messages of MoveIt's types, and what they are read against: the built-in arm at home."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Pose
from robot.description import model
from server.errors import RefusedError
from server.moveit.parameters import MoveItParameters
from server.moveit.requests.context import RequestContext
from server.moveit.scene.frames import Frames
from server.moveit.scene.scene_state import SceneState
from tests.helpers.planning_scene import ROBOT, message
from tests.helpers.seven_joint_arm import SRDF, URDF

SEVEN = model.parse(URDF, SRDF)
TIP = "gripper_frame_link"
HOME = {joint.name: 0.0 for joint in ROBOT.movable_joints}
FRAMES = Frames(ROBOT, SceneState(ROBOT))
BOX, SPHERE, CYLINDER, CONE = 1, 2, 3, 4


def context(robot=ROBOT, start_rad=None, group="arm", **parameters: Any) -> RequestContext:
    start_rad = {joint.name: 0.0 for joint in robot.movable_joints} | (start_rad or {})
    frames = FRAMES if robot is ROBOT else Frames(robot, SceneState(robot))
    group_model = robot.groups.get(group) or next(iter(robot.groups.values()))
    return RequestContext(robot, group_model, frames, start_rad, MoveItParameters(**parameters))


def point(x: float, y: float, z: float, **orientation: float) -> dict[str, Any]:
    """A geometry_msgs/Pose."""
    return {"position": {"x": x, "y": y, "z": z}, "orientation": orientation}


def region(*primitives: tuple[int, list[float]], poses: list[dict[str, Any]], **fields: Any) -> dict[str, Any]:
    """A moveit_msgs/PositionConstraint."""
    solids = [{"type": kind, "dimensions": dimensions} for kind, dimensions in primitives]
    return {"constraint_region": {"primitives": solids, "primitive_poses": poses}, **fields}


def ball(x: float, y: float, z: float, radius_m: float = 0.005, **fields: Any) -> dict[str, Any]:
    """A moveit_msgs/PositionConstraint of one sphere."""
    return region((SPHERE, [radius_m]), poses=[point(x, y, z)], **fields)


def turned(tolerance: float | tuple[float, float, float], **fields: Any) -> dict[str, Any]:
    """A moveit_msgs/OrientationConstraint."""
    tolerances = tolerance if isinstance(tolerance, tuple) else (tolerance,) * 3
    names = (f"absolute_{axis}_axis_tolerance" for axis in "xyz")
    return {**dict(zip(names, tolerances, strict=True)), **fields}


def joint(name: str, position: float, above: float = 0.0, below: float = 0.0, **fields: Any) -> dict[str, Any]:
    """A moveit_msgs/JointConstraint."""
    return {"joint_name": name, "position": position, "tolerance_above": above, "tolerance_below": below, **fields}


def constraints(**fields: Any) -> dict[str, Any]:
    return message("Constraints", **fields)


def outcome(function: Callable[..., Any], *arguments: Any) -> Any:
    """The value of a call, or the failure that rejects it."""
    try:
        return function(*arguments)
    except RefusedError as error:
        return error.failure


def assert_refused(answer: object, code: MoveItErrorCode, *words: str) -> PlanningFailure:
    assert isinstance(answer, PlanningFailure), answer
    assert answer.code is code, answer
    for word in words:
        assert word in answer.message
    return answer


def near(pose: Pose, position_m: tuple[float, float, float], tolerance_m: float = 1e-9) -> bool:
    return all(abs(a - b) <= tolerance_m for a, b in zip(pose.position_m, position_m, strict=True))

"""Conversions between messages and the planners' types: poses, positions of joints, and error codes."""

import math
from collections.abc import Collection, Mapping
from typing import Any, TypeAlias

import numpy as np

from planners.problem import MoveItErrorCode
from planners.scene import Pose
from robot.trajectory import Vector
from server.errors import invalid, refused

Message: TypeAlias = Mapping[str, Any]

# A quaternion shorter than this says nothing about an orientation; ROS 1 clients leave it all zero for "none".
MIN_NORM = 1e-6


def check_finite(values: Mapping[str, float], where: str) -> None:
    """Reject the first number that is not finite; ``where`` is the path of the message with these fields."""
    for field, value in values.items():
        if not math.isfinite(value):
            raise invalid(f"{where}.{field} must be a finite number, not {value}", field=f"{where}.{field}")


def read_point(message: Message, where: str) -> tuple[float, float, float]:
    """Read a geometry_msgs/Point or Vector3."""
    check_finite(message, where)
    return float(message["x"]), float(message["y"]), float(message["z"])


def read_pose(message: Message, where: str) -> Pose:
    """Read a geometry_msgs/Pose; its quaternion is normalised, one of only zeros is no rotation."""
    position_m, quaternion = read_point(message["position"], f"{where}.position"), message["orientation"]
    check_finite(quaternion, f"{where}.orientation")
    x, y, z, w = (quaternion[axis] for axis in "xyzw")
    norm = math.hypot(x, y, z, w)
    return Pose(position_m, (x / norm, y / norm, z / norm, w / norm) if norm > MIN_NORM else (0.0, 0.0, 0.0, 1.0))


def write_pose(pose: Pose) -> dict[str, Any]:
    return {
        "position": dict(zip("xyz", pose.position_m, strict=True)),
        "orientation": dict(zip("xyzw", pose.orientation, strict=True)),
    }


def write_transform(pose: Pose) -> dict[str, Any]:
    written = write_pose(pose)
    return {"translation": written["position"], "rotation": written["orientation"]}


def matrix_of(pose: Pose) -> Vector:
    """Return the transform from the pose's frame to the one it is given in, shape (4, 4) [m]."""
    x, y, z, w = pose.orientation
    transform = np.eye(4)
    transform[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    transform[:3, 3] = pose.position_m
    return transform


def pose_of(transform: Vector) -> Pose:
    """Return the pose of a transform, shape (4, 4); the quaternion by Shepperd's method, its w not negative."""
    (a, b, c, px), (d, e, f, py), (g, h, i, pz), _ = transform.tolist()
    # Four times the quaternion, each time multiplied by another of its components: the greatest loses no precision.
    scaled = (
        (1 + a - e - i, b + d, c + g, h - f),
        (b + d, 1 - a + e - i, f + h, c - g),
        (c + g, f + h, 1 - a - e + i, d - b),
        (h - f, c - g, d - b, 1 + a + e + i),
    )
    quaternion = max(enumerate(scaled), key=lambda row: row[1][row[0]])[1]
    length = math.copysign(math.hypot(*quaternion), quaternion[3])
    x, y, z, w = (component / length for component in quaternion)
    return Pose((px, py, pz), (x, y, z, w))


def composed(outer: Pose, inner: Pose) -> Pose:
    """Return the pose ``inner``, given in the frame ``outer``, in the frame in which ``outer`` is given."""
    return pose_of(matrix_of(outer) @ matrix_of(inner))


def inverse(pose: Pose) -> Pose:
    """Return the pose of the reference frame in the frame of a pose."""
    transform = matrix_of(pose)
    back = np.eye(4)
    back[:3, :3] = transform[:3, :3].T
    back[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return pose_of(back)


def read_joint_positions(joint_state: Message, known: Collection[str], where: str) -> dict[str, float]:
    """Read the positions of some of the known joints in a sensor_msgs/JointState, by joint [rad]."""
    names, positions = joint_state["name"], joint_state["position"]
    if len(names) != len(positions):
        text = f"{where}: name has {len(names)} entries and position {len(positions)}; they must be as many"
        raise refused(MoveItErrorCode.INVALID_ROBOT_STATE, text)
    for name, position in zip(names, positions, strict=True):
        text = ""
        if name not in known:
            text = f"{where}.name: there is no joint {name!r}; the robot has {', '.join(sorted(known))}"
        elif not math.isfinite(position):
            text = f"{where}.position of joint {name!r} must be a finite number, not {position}"
        if text:
            raise refused(MoveItErrorCode.INVALID_ROBOT_STATE, text, joint=name)
    return dict(zip(names, map(float, positions), strict=True))


def error_code(code: MoveItErrorCode, message: str = "") -> dict[str, Any]:
    """Write a moveit_msgs/MoveItErrorCodes, as source the name where MoveIt puts its pipeline's stage."""
    return {"val": int(code), "message": message, "source": "armbridge"}


def success(*notes: str) -> dict[str, Any]:
    """Write the code of a success; notes that are not empty become its message."""
    return error_code(MoveItErrorCode.SUCCESS, "; ".join(filter(None, notes)))

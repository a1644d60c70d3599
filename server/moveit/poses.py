"""Conversions of poses: geometry_msgs/Pose, the planners' Pose and 4 x 4 matrices."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Pose
from robot.trajectory import Vector
from server.errors import RefusedError

Message: TypeAlias = Mapping[str, Any]

# A quaternion shorter than this says nothing about an orientation; ROS 1 clients leave it all zero for "none".
MIN_NORM = 1e-6


def read_pose(message: Message, where: str) -> Pose:
    """Read a geometry_msgs/Pose; its quaternion is normalised, one of only zeros is no rotation."""
    point, quaternion = message["position"], message["orientation"]
    if not all(map(math.isfinite, (*point.values(), *quaternion.values()))):
        raise _not_finite(message, where)
    x, y, z, w = (quaternion[axis] for axis in "xyzw")
    norm = math.hypot(x, y, z, w)
    turned = (x / norm, y / norm, z / norm, w / norm) if norm > MIN_NORM else (0.0, 0.0, 0.0, 1.0)
    return Pose((float(point["x"]), float(point["y"]), float(point["z"])), turned)


def write_pose(pose: Pose) -> dict[str, Any]:
    """Return the geometry_msgs/Pose of a pose."""
    return {
        "position": dict(zip("xyz", pose.position_m, strict=True)),
        "orientation": dict(zip("xyzw", pose.orientation, strict=True)),
    }


def write_transform(pose: Pose) -> dict[str, Any]:
    """Return the geometry_msgs/Transform of a pose."""
    return {
        "translation": dict(zip("xyz", pose.position_m, strict=True)),
        "rotation": dict(zip("xyzw", pose.orientation, strict=True)),
    }


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


def _not_finite(message: Message, where: str) -> RefusedError:
    """Return the error that names the first number of a pose that is not finite."""
    field, axis, value = next(
        (field, axis, value)
        for field in ("position", "orientation")
        for axis, value in message[field].items()
        if not math.isfinite(value)
    )
    return RefusedError(
        PlanningFailure(
            MoveItErrorCode.INVALID_GOAL_CONSTRAINTS,
            f"{where}.{field}.{axis} must be a finite number, not {value}",
            {"field": f"{where}.{field}.{axis}"},
        )
    )

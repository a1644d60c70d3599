"""Frames of a URDF: axes, origins and rotations; and joints that are held, fixed where they stay."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np

from robot.trajectory import Vector

# Elements of a joint that a fixed one has no use for.
OF_MOVING_JOINTS = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")


def rotation_about(axis: Vector, angle_rad: float) -> Vector:
    """Compute a rotation matrix about a unit vector by Rodrigues' formula, shape (3, 3)."""
    x, y, z = axis.tolist()
    sin, cos = math.sin(angle_rad), math.cos(angle_rad)
    rest = 1.0 - cos
    return np.array(
        [
            [cos + x * x * rest, x * y * rest - z * sin, x * z * rest + y * sin],
            [x * y * rest + z * sin, cos + y * y * rest, y * z * rest - x * sin],
            [x * z * rest - y * sin, y * z * rest + x * sin, cos + z * z * rest],
        ]
    )


def unit_axis(element: ET.Element) -> Vector:
    """Return the axis of a URDF <joint>: a unit vector, shape (3,), along x where the joint has none."""
    axis = element.find("axis")
    values = np.array([float(v) for v in axis.get("xyz", "1 0 0").split()]) if axis is not None else np.eye(3)[0]
    length = float(np.linalg.norm(values))
    return values / length if length > 0.0 else np.eye(3)[0]


def origin_transform(element: ET.Element) -> Vector:
    """Return the URDF <origin> of an element, shape (4, 4) [m]: a translation, then fixed-axis roll, pitch and yaw."""
    transform = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        roll, pitch, yaw = (float(v) for v in origin.get("rpy", "0 0 0").split())
        x_axis, y_axis, z_axis = np.eye(3)
        transform[:3, :3] = rotation_about(z_axis, yaw) @ rotation_about(y_axis, pitch) @ rotation_about(x_axis, roll)
        transform[:3, 3] = [float(v) for v in origin.get("xyz", "0 0 0").split()]
    return transform


def roll_pitch_yaw(rotation: Vector) -> tuple[float, float, float]:
    """Return the fixed-axis angles of a rotation matrix, shape (3, 3), as URDF has them [rad].

    Where the pitch is a quarter turn, the roll is 0.
    """
    level = math.hypot(rotation[0, 0], rotation[1, 0])
    pitch = math.atan2(-rotation[2, 0], level)
    if level < 1e-9:
        return 0.0, pitch, math.atan2(-rotation[0, 1], rotation[1, 1])
    return math.atan2(rotation[2, 1], rotation[2, 2]), pitch, math.atan2(rotation[1, 0], rotation[0, 0])


def joint_motion(element: ET.Element, position: float) -> Vector:
    """Return the motion of a URDF <joint> at a position [rad, or m of a prismatic joint], shape (4, 4) [m]."""
    transform, axis = np.eye(4), unit_axis(element)
    if element.get("type") == "prismatic":
        transform[:3, 3] = position * axis
    else:
        transform[:3, :3] = rotation_about(axis, position)
    return transform


def shift_origin(element: ET.Element, position: float) -> None:
    """Move the origin of a URDF <joint> by a position [rad, or m of a prismatic joint], which becomes its zero."""
    transform = origin_transform(element) @ joint_motion(element, position)
    origin = element.find("origin")
    if origin is None:
        origin = ET.SubElement(element, "origin")
    origin.set("xyz", " ".join(map(repr, transform[:3, 3].tolist())))
    origin.set("rpy", " ".join(map(repr, roll_pitch_yaw(transform[:3, :3]))))


def with_fixed_joints(urdf: str, positions: Mapping[str, float]) -> str:
    """Return a URDF in which some joints are fixed at their positions [rad, or m of a prismatic joint]."""
    root = ET.fromstring(urdf)  # noqa: S314 - the user's own file, already parsed as a description
    for element in root.findall("joint"):
        name = element.get("name", "")
        if name in positions:
            _fix(element, positions[name])
    return ET.tostring(root, encoding="unicode")


def _fix(element: ET.Element, position: float) -> None:
    shift_origin(element, position)
    for child in [*element]:
        if child.tag in OF_MOVING_JOINTS:
            element.remove(child)
    element.set("type", "fixed")

"""URDF of a robot as the planning libraries take it, made plain: what moves, and no more than they understand."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from robot.description.forward_kinematics import origin_transform, rotation_about, unit_axis
from robot.description.model import Joint, RobotModel

# Libraries want an effort limit, which nothing here reads.
_EFFORT = "1"


def plain_urdf(robot: RobotModel) -> str:
    """URDF text without visuals and with plain joints, position limits as the model has them.

    Continuous joints become revolute ones, which :mod:`robot.description.urdf` limits: pinocchio would otherwise
    describe each by two numbers. Joints that mimic become plain ones, with their offset in their origin: so that their
    position is a multiple of the other's. Floating and planar joints are fixed.
    """
    root = ET.fromstring(robot.urdf)  # noqa: S314 - the user's own file, already parsed by robot.description.urdf
    for link in root.iterfind("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for element in root.iterfind("joint"):
        joint = robot.joints[element.get("name", "")]
        if joint.mimic is not None:
            _turn_by_offset(element, joint.mimic.offset)
        for mimic in element.findall("mimic"):
            element.remove(mimic)
        if joint.moves:
            _set_limits(element, joint, robot)
        elif joint.type != "fixed":
            element.set("type", "fixed")
    return ET.tostring(root, encoding="unicode")


def kinematic_urdf(robot: RobotModel) -> str:
    """As :func:`plain_urdf`, with links and joints only.

    Meshes are left out because placo loads them whatever its flags say (seconds and half a gigabyte).
    """
    root = ET.fromstring(plain_urdf(robot))  # noqa: S314 - made above
    for link in root.iterfind("link"):
        for shape in link.findall("collision"):
            link.remove(shape)
    return ET.tostring(root, encoding="unicode")


def _set_limits(element: ET.Element, joint: Joint, robot: RobotModel) -> None:
    lower, upper = joint.lower, joint.upper
    if joint.mimic is not None:
        leader = robot.joints[joint.mimic.joint]
        lower, upper = sorted((joint.mimic.multiplier * leader.lower, joint.mimic.multiplier * leader.upper))
    limit = element.find("limit")
    if limit is None:
        limit = ET.SubElement(element, "limit", effort=_EFFORT, velocity="1")
    limit.set("lower", repr(lower))
    limit.set("upper", repr(upper))
    if joint.type == "continuous":
        element.set("type", "revolute")


def _turn_by_offset(element: ET.Element, offset: float) -> None:
    """Move a joint's origin to where its position is the offset [rad, or m of a prismatic one]."""
    if offset == 0.0:
        return
    transform, moved = origin_transform(element), np.eye(4)
    if element.get("type") == "prismatic":
        moved[:3, 3] = offset * unit_axis(element)
    else:
        moved[:3, :3] = rotation_about(unit_axis(element), offset)
    transform = transform @ moved
    origin = element.find("origin")
    if origin is None:
        origin = ET.SubElement(element, "origin")
    origin.set("xyz", " ".join(map(repr, transform[:3, 3].tolist())))
    origin.set("rpy", " ".join(map(repr, _roll_pitch_yaw(transform[:3, :3].tolist()))))


def _roll_pitch_yaw(rotation: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """Return the fixed-axis angles of a rotation matrix, shape (3, 3) [rad]."""
    (xx, _, _), (yx, _, _), (zx, zy, zz) = rotation
    return math.atan2(zy, zz), math.atan2(-zx, math.hypot(xx, yx)), math.atan2(yx, xx)

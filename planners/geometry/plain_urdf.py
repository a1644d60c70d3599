"""URDF of a robot as the planning libraries take it, made plain: what moves, and no more than they understand."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from robot.description.model import Joint, RobotModel
from robot.description.urdf import shift_origin

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
        if joint.mimic is not None and joint.mimic.offset != 0.0:
            shift_origin(element, joint.mimic.offset)
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

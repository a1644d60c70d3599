"""The robot's kinematics without its shapes, in the form that the planning libraries load quickly."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from robot.description.model import RobotModel


def kinematic_urdf(robot: RobotModel) -> str:
    """URDF text with links and joints only, position limits as the model has them.

    Meshes are left out because placo loads them whatever its flags say (seconds and half a gigabyte).
    Continuous joints become revolute ones, which :mod:`robot.description.model` limits: pinocchio would
    otherwise describe each by two numbers.
    """
    root = ET.fromstring(robot.urdf)  # noqa: S314 - the user's own file, already parsed by robot.description.model
    for link in root.iterfind("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for joint in root.iterfind("joint"):
        known, limit = robot.joints[joint.get("name", "")], joint.find("limit")
        if known.movable and limit is not None:
            limit.set("lower", repr(known.lower))
            limit.set("upper", repr(known.upper))
        if known.type == "continuous":
            joint.set("type", "revolute")
    return ET.tostring(root, encoding="unicode")

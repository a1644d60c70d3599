"""The robot's kinematics without its shapes, in the form that the planning libraries load quickly."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

from robot.model import RobotModel


def kinematic_urdf(robot: RobotModel) -> str:
    """URDF text with links and joints only.

    Meshes are left out because placo loads them whatever its flags say (seconds and half a gigabyte).
    Continuous joints become revolute ones of one turn either way, as :mod:`robot.model` limits them: pinocchio
    would otherwise describe each by two numbers.
    """
    root = ET.fromstring(robot.urdf)  # noqa: S314 - the user's own file, already parsed by robot.model
    for link in root.iterfind("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for joint in root.iterfind("joint[@type='continuous']"):
        joint.set("type", "revolute")
        limit = joint.find("limit")
        if limit is not None:
            limit.set("lower", repr(-math.pi))
            limit.set("upper", repr(math.pi))
    return ET.tostring(root, encoding="unicode")

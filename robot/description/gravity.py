"""Weight of a robot's links on its joints, from the masses in the URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np

from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.trajectory import Vector

GRAVITY_M_S2 = 9.81


class LinkWeights:
    """Weight of the links of one robot, whose root's z axis points up."""

    def __init__(self, robot: RobotModel) -> None:
        self._forward = ForwardPlacements(robot)
        elements = ET.fromstring(robot.urdf)  # noqa: S314 - the user's own file, already parsed as a description
        self._masses = {
            name: _mass(element)
            for element in elements.iterfind("link")
            if (name := element.get("name", "")) and element.find("inertial/mass") is not None
        }
        by_child = {joint.child: joint for joint in robot.joints.values()}
        self._axes = {
            joint.name: (joint.child, joint.type != "prismatic", self._forward.axis(joint.child))
            for joint in robot.movable_joints
        }
        # Links that hang on each movable joint.
        self._carried: dict[str, list[str]] = {name: [] for name in self._axes}
        for link in self._masses:
            above = link
            while above in by_child:
                joint = by_child[above]
                if joint.name in self._carried:
                    self._carried[joint.name].append(link)
                above = joint.parent

    def holding_torques(self, position_rad: Mapping[str, float]) -> dict[str, float]:
        """Compute the torque of each movable joint that balances the links' weight, the gradient of their energy.

        Positions are of every movable joint [rad or m]; torques are by joint [Nm, or N of a prismatic one].
        """
        transforms = self._forward.transforms(position_rad)
        weighed = {link: (mass, transforms[link] @ centre) for link, (mass, centre) in self._masses.items()}
        torques = {}
        for name, (child, turns, axis) in self._axes.items():
            transform = transforms[child]
            x, y, z = (transform[:3, :3] @ axis).tolist()
            px, py, _ = transform[:3, 3].tolist()
            torque = 0.0
            for link in self._carried[name]:
                mass, centre = weighed[link]
                # The height that a centre of mass gains for each radian, or metre: z of axis x (centre - origin).
                gain = x * (centre[1] - py) - y * (centre[0] - px) if turns else z
                torque += mass * GRAVITY_M_S2 * float(gain)
            torques[name] = torque
        return torques


def _mass(link: ET.Element) -> tuple[float, Vector]:
    """Return a link's mass [kg] and its centre in the link's frame, shape (4,), homogeneous [m]."""
    mass, origin = link.find("inertial/mass"), link.find("inertial/origin")
    xyz = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
    value = 0.0 if mass is None else float(mass.get("value", "0"))
    return value, np.array([*(float(number) for number in xyz.split()), 1.0])

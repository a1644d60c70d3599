"""Where the links are in a configuration, by pinocchio."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.skeleton import kinematic_urdf
from robot.description.model import RobotModel

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Placements:
    """Where a link is in many configurations.

    Attributes:
        rotations: shape (m, 3, 3).
        positions_m: shape (m, 3) [m].
    """

    rotations: Vector
    positions_m: Vector


class ForwardKinematics:
    """Places the links of one robot.

    Args:
        robot: the arm.
        joint_names: joints of a configuration ``q``, shape (n,) [rad].
    """

    def __init__(self, robot: RobotModel, joint_names: Sequence[str]) -> None:
        self._model = pin.buildModelFromXML(kinematic_urdf(robot))
        self._data = self._model.createData()
        self._order = np.array([joint_names.index(name) for name in list(self._model.names)[1:]])
        self._frames = {link: self._model.getFrameId(link) for link in robot.links}

    def place(self, q: Vector) -> None:
        """Move the joints; :meth:`placement` then tells where links are."""
        pin.forwardKinematics(self._model, self._data, q[self._order])

    def placement(self, link: str) -> pin.SE3:
        """Where a link is in the root link's frame, until joints are moved again."""
        return pin.updateFramePlacement(self._model, self._data, self._frames[link])

    def jacobian(self, q: Vector, link: str) -> Vector:
        """How a link moves with the joints: linear and angular rows along the root link's axes, shape (6, n).

        The joints are moved to ``q`` as by :meth:`place`.
        """
        pin.computeJointJacobians(self._model, self._data, q[self._order])
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        columns = np.empty((6, len(self._order)))
        columns[:, self._order] = pin.getFrameJacobian(self._model, self._data, self._frames[link], axes)
        return columns

    def placements(self, configurations: Vector, link: str) -> Placements:
        """Where a link is in each configuration."""
        rotations, positions_m = np.empty((len(configurations), 3, 3)), np.empty((len(configurations), 3))
        for i, q in enumerate(configurations):
            self.place(q)
            placement = self.placement(link)
            rotations[i], positions_m[i] = placement.rotation, placement.translation
        return Placements(rotations, positions_m)

"""Distance between two shapes, and its gradient by the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from robot.trajectory import Vector


@dataclass(frozen=True)
class Nearest:
    """Points at which two shapes are nearest to each other, or overlap deepest."""

    distance_m: float  # below 0 the depth of the overlap [m]
    point_m: Vector  # a point of the first one there, shape (3,) [m]
    normal: Vector  # unit vector from the first to the second, shape (3,)

    @property
    def middle_m(self) -> Vector:
        """Point half-way between the two, shape (3,) [m]."""
        middle_m: Vector = self.point_m + 0.5 * self.distance_m * self.normal
        return middle_m

    def transformed(self, place: pin.SE3) -> Nearest:
        """Return the same points in the frame in which ``place`` is the present frame."""
        return Nearest(self.distance_m, place.rotation @ self.point_m + place.translation, place.rotation @ self.normal)


@dataclass(frozen=True)
class NearPair:
    """Two links, or a link and an object, that are near each other."""

    first: str
    second: str
    by_object: bool  # whether an object is among the two
    distance_m: float  # distance beyond their required clearance [m]
    distance_gradient: Vector  # gradient of the distance by each joint, shape (n,) [m/rad]


def distance_gradient(model: pin.Model, data: pin.Data, nearest: Nearest, first: int, second: int) -> Vector:
    """Return the gradient of the distance between two shapes by joint, shape (n,) [m/rad].

    ``data`` has the Jacobians at the present configuration; ``first`` and ``second`` are the joints that carry the
    shapes, 0 for the root link and the world.
    """
    gradient = np.zeros(model.nv)
    second_m = nearest.point_m + nearest.distance_m * nearest.normal
    for joint, point_m, sign in ((first, nearest.point_m, -1.0), (second, second_m, 1.0)):
        if joint:
            rows = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            arm_m = point_m - data.oMi[joint].translation
            gradient += sign * (nearest.normal @ rows[:3] + np.cross(arm_m, nearest.normal) @ rows[3:])
    return gradient


class BoundingSpheres:
    """A sphere around each shape, to leave out distant pairs, shape (pairs, 2), quickly."""

    def __init__(self, shapes: Sequence[pin.GeometryObject], pairs: NDArray[np.int64]) -> None:
        for shape in shapes:
            shape.geometry.computeLocalAABB()
        self._pairs = pairs
        self._carriers = np.array([shape.parentJoint for shape in shapes], dtype=np.intp)
        self._middles_m = np.array([shape.placement.act(shape.geometry.aabb_center) for shape in shapes]).reshape(-1, 3)
        radii_m = np.array([shape.geometry.aabb_radius for shape in shapes])
        self._reach_m = radii_m[pairs].sum(axis=1)

    def within(self, data: pin.Data, margin_m: Vector) -> NDArray[np.intp]:
        """Indices of the pairs whose spheres are nearer than a margin for each, shape (pairs,) [m]."""
        middles_m = self._middles_m.copy()
        for joint in np.unique(self._carriers):
            carried, place = self._carriers == joint, data.oMi[int(joint)]
            middles_m[carried] = self._middles_m[carried] @ place.rotation.T + place.translation
        apart_m = np.linalg.norm(middles_m[self._pairs[:, 0]] - middles_m[self._pairs[:, 1]], axis=1)
        return np.flatnonzero(apart_m < self._reach_m + margin_m)

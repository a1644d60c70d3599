"""The quick answer to "does anything touch?": all checked pairs at once, by pinocchio and coal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.nearness import Nearest, Spheres, slope_m_per_rad

Vector = NDArray[np.float64]

# With coal's default of 1e-6 one pair in 80 000 that overlaps, by up to 48 mm, is called free: the search for a common
# point gives up too early on shapes of a few centimetres. With this none of 1.6 million was, at no cost.
GJK_TOLERANCE = 1e-9

# With a margin of exactly 0 coal calls one in a thousand pairs free that overlap by centimetres and whose faces are
# parallel, as those of an arm in its zero position and of boxes are; with any other margin none of 27 000.
CONTACT_M = 1e-6


class Broadphase:
    """Shapes and the pairs of them that must not touch.

    A configuration ``q`` is the position of every movable joint, shape (n,) [rad].

    Args:
        model: the robot's joints.
        shapes: what there is.
        pairs: indices of shapes, shape (pairs, 2), the smaller first.
        apart_m: how far the shapes of each pair must stay apart, shape (pairs,) [m].
    """

    def __init__(
        self, model: pin.Model, shapes: list[pin.GeometryObject], pairs: NDArray[np.int64], apart_m: Vector
    ) -> None:
        self._model, self._data = model, model.createData()
        self._geometry = pin.GeometryModel()
        for shape in shapes:
            self._geometry.addGeometryObject(shape)
        checked = np.zeros((len(shapes), len(shapes)), dtype=bool)
        checked[pairs[:, 0], pairs[:, 1]] = True
        # They come out in the order of ``pairs``: row by row.
        self._geometry.setCollisionPairs(checked, True)
        self._pairs, self._apart_m = pairs, apart_m
        self._carriers = [shape.parentJoint for shape in shapes]
        self._shapes = shapes
        # Made when they are first asked for: a large scene that nobody is steered in needs none.
        self._spheres: Spheres | None = None
        self._margins_m = np.zeros((len(shapes), len(shapes)))
        # The tree keeps references to the models, and halves the time of a check even for seven shapes. It takes
        # margins over when told to only, so there is one for contacts and one for what is near.
        self._contact, self._near = self._geometry.createData(), self._geometry.createData()
        # Shapes that never were anywhere have boxes of garbage, which the trees refuse.
        self.place(pin.neutral(model))
        pin.updateGeometryPlacements(model, self._data, self._geometry, self._near)
        self._contact_tree, self._near_tree = self._tree(self._contact), self._tree(self._near)
        self._near_results = list(self._near.collisionResults)
        # Pairs that are asked about one by one have their margins to themselves.
        self._single = self._geometry.createData()
        self._single_requests = list(self._single.collisionRequests)
        for request in self._single_requests:
            request.gjk_tolerance = GJK_TOLERANCE
        self._least_m = (CONTACT_M + apart_m).tolist()

    def touches(self, q: Vector) -> bool:
        """Whether shapes of any pair touch, or are nearer than they may be."""
        return pin.computeCollisions(self._model, self._data, self._contact_tree, q, True)

    def near(self, q: Vector, margin_m: Vector) -> list[int]:
        """Indices of the pairs whose shapes are nearer than they may be and a margin, shape (pairs,) [m]."""
        self._set_margins(self._near, self._near_tree, margin_m)
        if not pin.computeCollisions(self._model, self._data, self._near_tree, q, False):
            return []
        found = [pair for pair, result in enumerate(self._near_results) if result.isCollision()]
        # The tree leaves the results of pairs whose boxes are apart as they were.
        for pair in found:
            self._near_results[pair].clear()
        return found

    def near_among(self, q: Vector, pairs: Iterable[int], margin_m: Sequence[float] | Vector) -> list[int]:
        """As :meth:`near`, of some pairs only: a tenth of the time for a few; ``margin_m`` is by all pairs' indices."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._single, q)
        geometry, data, found = self._geometry, self._single, []
        for pair in pairs:
            self._single_requests[pair].security_margin = self._least_m[pair] + margin_m[pair]
            if pin.computeCollision(geometry, data, pair):
                found.append(pair)
        return found

    def place(self, q: Vector) -> None:
        """Put the shapes where they are at a configuration: the methods below are about there."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._contact, q)

    def touching(self) -> list[int]:
        """Indices of the pairs that touch."""
        return self.touching_among(range(len(self._pairs)))

    def touching_among(self, pairs: Iterable[int]) -> list[int]:
        """Those of some pairs that touch."""
        return [pair for pair in pairs if pin.computeCollision(self._geometry, self._contact, pair)]

    def distance_m(self, pair: int) -> float:
        """How far the shapes of a pair are apart beyond what they must be, below 0 how deep they overlap [m]."""
        return float(self._distance(pair).min_distance) - float(self._apart_m[pair])

    def within(self, margin_m: float) -> NDArray[np.intp]:
        """Indices of the pairs that may be nearer than a margin beyond what they must be apart [m]."""
        if self._spheres is None:
            self._spheres = Spheres(self._shapes, self._pairs)
        return self._spheres.within(self._data, self._apart_m + margin_m)

    def nearest(self, pair: int) -> Nearest:
        """Where the shapes of a pair are nearest, in the root link's frame."""
        found = self._distance(pair)
        return Nearest(float(found.min_distance), np.array(found.getNearestPoint1()), np.array(found.normal))

    def slope_m_per_rad(self, pair: int, nearest: Nearest) -> Vector:
        """How the distance of a pair grows with each joint where :meth:`turn` was told, shape (n,) [m/rad]."""
        first, second = (self._carriers[i] for i in self._pairs[pair])
        return slope_m_per_rad(self._model, self._data, nearest, first, second)

    def turn(self, q: Vector) -> None:
        """As :meth:`place`, and make ready for :meth:`slope_m_per_rad`."""
        self.place(q)
        pin.computeJointJacobians(self._model, self._data, q)

    def contact(self, pair: int) -> tuple[Vector, Vector]:
        """Where the shapes of a pair touch and which way the second one would have to give, each shape (3,) [m].

        Both are those of the last :meth:`distance_m` of the pair.
        """
        found = self._contact.distanceResults[pair]
        middle_m: Vector = 0.5 * (found.getNearestPoint1() + found.getNearestPoint2())
        return middle_m, np.array(found.normal)

    def placement(self, joint: int) -> pin.SE3:
        """Where a joint is in the root link's frame."""
        return self._data.oMi[joint]

    def _distance(self, pair: int) -> coal.DistanceResult:
        self._contact.distanceRequests[pair].gjk_tolerance = GJK_TOLERANCE
        return pin.computeDistance(self._geometry, self._contact, pair)

    def _tree(self, data: pin.GeometryData) -> pin.BroadPhaseManager_DynamicAABBTreeCollisionManager:
        for request in data.collisionRequests:
            request.gjk_tolerance = GJK_TOLERANCE
        tree = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(self._model, self._geometry, data)
        self._set_margins(data, tree, np.zeros(len(self._pairs)))
        return tree

    def _set_margins(
        self, data: pin.GeometryData, tree: pin.BroadPhaseManager_DynamicAABBTreeCollisionManager, margin_m: Vector
    ) -> None:
        self._margins_m[self._pairs[:, 0], self._pairs[:, 1]] = CONTACT_M + self._apart_m + margin_m
        data.setSecurityMargins(self._geometry, self._margins_m, True, True)
        tree.update(True)

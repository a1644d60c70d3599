"""The quick answer to "does anything touch?": all checked pairs at once, by pinocchio and coal."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

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
        self._margins_m = np.zeros((len(shapes), len(shapes)))
        # The tree keeps references to the models, and halves the time of a check even for seven shapes. It takes
        # margins over when told to only, so there is one for contacts and one for what is near.
        self._contact, self._near = self._geometry.createData(), self._geometry.createData()
        # Shapes that never were anywhere have boxes of garbage, which the trees refuse.
        self.place(pin.neutral(model))
        self._contact_tree, self._near_tree = self._tree(self._contact), self._tree(self._near)

    def touches(self, q: Vector) -> bool:
        """Whether shapes of any pair touch, or are nearer than they may be."""
        return pin.computeCollisions(self._model, self._data, self._contact_tree, q, True)

    def watch(self, margin_m: Vector) -> None:
        """Set how near is near: shape (pairs,), beyond what pairs must stay apart anyway [m]."""
        self._set_margins(self._near, self._near_tree, margin_m)

    def near(self, q: Vector) -> bool:
        """Whether shapes of any pair are nearer than :meth:`watch` was told."""
        return pin.computeCollisions(self._model, self._data, self._near_tree, q, True)

    def place(self, q: Vector) -> None:
        """Put the shapes where they are at a configuration: the methods below are about there."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._contact, q)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._near)

    def touching(self) -> list[int]:
        """Indices of the pairs that touch."""
        return self._hits(self._contact)

    def close(self) -> list[int]:
        """Indices of the pairs that are nearer than :meth:`watch` was told."""
        return self._hits(self._near)

    def distance_m(self, pair: int) -> float:
        """How far the shapes of a pair are apart beyond what they must be, below 0 how deep they overlap [m]."""
        self._contact.distanceRequests[pair].gjk_tolerance = GJK_TOLERANCE
        found = pin.computeDistance(self._geometry, self._contact, pair)
        return float(found.min_distance) - float(self._apart_m[pair])

    def placement(self, joint: int) -> pin.SE3:
        """Where a joint is in the root link's frame."""
        return self._data.oMi[joint]

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

    def _hits(self, data: pin.GeometryData) -> list[int]:
        return [k for k in range(len(self._pairs)) if pin.computeCollision(self._geometry, data, k)]

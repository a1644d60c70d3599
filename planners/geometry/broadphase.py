"""Contacts and distances of all checked pairs of shapes at once: quick, and conservative where the shapes are hulls."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress, count
from typing import TypeAlias

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.kinematics import JointMap
from planners.geometry.shapes import without_triangles
from robot.trajectory import Vector

# With coal's default of 1e-6 one pair in 80 000 that overlaps, by up to 48 mm, is called free: the search for a common
# point gives up too early on shapes of a few centimetres. With this tolerance it errs on 0 of 1.6 million, at no cost.
GJK_TOLERANCE = 1e-9

# With a margin of exactly 0 coal calls one in a thousand pairs free that overlap by centimetres and whose faces are
# parallel, as on an arm in its zero position beside boxes; with any other margin 0 of 27 000.
CONTACT_M = 1e-6

NO_PAIRS: frozenset[int] = frozenset()
UNKNOWN_M = 1e-9  # clearance of bodies that do not touch, where no more is known of it [m]

# Finds the pairs whose boxes overlap. With each box compared to each other a check of 12 to 92 shapes takes 0.5 to 0.8
# times as long as with a tree of boxes, of 107 to 167 shapes 0.5 to 0.9, of 310 shapes 0.7 on Panda and 2.2 on SO-101.
Manager: TypeAlias = pin.BroadPhaseManager_NaiveCollisionManager | pin.BroadPhaseManager_DynamicAABBTreeCollisionManager
Detector: TypeAlias = tuple[Manager, pin.CollisionCallBackDefault]
Half: TypeAlias = tuple[Manager, pin.GeometryModel, pin.GeometryData]
BOXES_ONE_BY_ONE = pin.BroadPhaseManager_NaiveCollisionManager
TREE_OF_BOXES = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager
FEW_SHAPES = 170

# From this many resting shapes on, a check of all pairs updates and compares the boxes of moving shapes only: with 20
# boxes around an SO-101 it takes 0.85 of the time, with 100 a third, with 1000 an eighth; with 8 it would take 1.1.
MANY_RESTING = 16

FAR_M = 1e6  # where shapes are that only keep the indices of others


@dataclass(frozen=True)
class Nearest:
    """Points at which two shapes are nearest to each other, or overlap deepest."""

    distance_m: float  # below 0 the depth of the overlap [m]
    point_m: Vector  # a point of the first one there, shape (3,) [m]
    normal: Vector  # unit vector from the first to the second, shape (3,)

    @property
    def middle_m(self) -> Vector:
        """Point half-way between the two, shape (3,) [m]."""
        return np.asarray(self.point_m + 0.5 * self.distance_m * self.normal)


@dataclass(frozen=True)
class NearPair:
    """Two links, or a link and an object, that are near each other."""

    first: str
    second: str
    by_object: bool  # whether an object is among the two
    distance_m: float  # distance beyond their required clearance [m]
    distance_gradient: Vector  # gradient of the distance by each joint, shape (n,) [m/rad]
    by_another_arm: bool = False  # whether one of the two is moved by joints that move without the present ones


class Broadphase:
    """Shapes, and pairs of shapes that must not touch, which are indices (pairs, 2), the smaller first.

    A configuration ``q`` is the position of every movable joint, shape (n,) [rad]. The shapes of each pair must stay
    ``apart_m`` apart, shape (pairs,) [m].
    """

    def __init__(
        self,
        model: pin.Model,
        shapes: list[pin.GeometryObject],
        pairs: NDArray[np.int64],
        apart_m: Vector,
        joints: JointMap,
    ) -> None:
        self._model, self._data = model, model.createData()
        self._joints = joints
        self._geometry = pin.GeometryModel()
        for shape in shapes:
            self._geometry.addGeometryObject(shape)
        checked = np.zeros((len(shapes), len(shapes)), dtype=bool)
        checked[pairs[:, 0], pairs[:, 1]] = True
        # They come out in the order of `pairs`: row by row.
        self._geometry.setCollisionPairs(checked, True)
        self._pairs, self._apart_m = pairs, apart_m
        moved = np.zeros((model.njoints, model.nv))
        for joint, above in enumerate(model.supports):
            moved[joint, [model.joints[other].idx_v for other in above if other]] = 1.0
        first, second = (moved[[shape.parentJoint for shape in shapes]][pairs[:, side]] for side in (0, 1))
        # By pair and joint: 1 for a joint that moves the second shape only, -1 for the first only.
        self._sides = second - first
        self._shapes = shapes
        self._margins_m = np.zeros((len(shapes), len(shapes)), order="F")  # which pinocchio reads in half the time
        # Managers and callbacks keep references to the models. Margins change for near pairs only. A check that ends
        # with the first contact leaves a result behind, so it has data of its own as well.
        self._any, self._near = self._geometry.createData(), self._geometry.createData()
        pin.forwardKinematics(model, self._data, pin.neutral(model))
        self._any_contact = self._detector(self._any, stop_at_first=True)
        moving = 1 + max((index for index, shape in enumerate(shapes) if shape.parentJoint), default=-1)
        self._moving = self._halves(moving) if len(shapes) - moving >= MANY_RESTING else None
        self._left_out = NO_PAIRS
        self._vicinity = self._detector(self._near)
        self._near_results = list(self._near.collisionResults)
        # Pairs that are checked one by one have margins of their own.
        self._single = self._geometry.createData()
        self._single_requests = list(self._single.collisionRequests)
        self._single_results = list(self._single.collisionResults)
        triangles = np.array([isinstance(shape.geometry, coal.BVHModelBase) for shape in shapes], dtype=bool)
        self._triangles = frozenset(np.flatnonzero(triangles[pairs].any(axis=1)).tolist())
        self._hulls: dict[int, coal.CollisionGeometry] = {}
        for request in self._single_requests:
            request.gjk_tolerance = GJK_TOLERANCE
        self._least_m = (CONTACT_M + apart_m).tolist()

    def touches(self, q: Vector, left_out: frozenset[int] = NO_PAIRS) -> bool:
        """Return true if the shapes of any pair touch, or are nearer than they may be, but some that are left out."""
        if left_out != self._left_out:
            for pair in self._left_out:
                self._any.activateCollisionPair(pair)
            for pair in left_out:
                self._any.deactivateCollisionPair(pair)
            self._left_out = left_out
        if self._moving is None:
            return self._collide(q, self._any, self._any_contact)
        (moving, geometry, data), (resting, *_), callback = *self._moving, self._any_contact[1]
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._any, self._joints.positions(q))
        pin.updateGeometryPlacements(self._model, self._data, geometry, data)
        moving.update(False)
        return moving.collide(callback) or resting.collide(moving, callback)

    def touching_among(self, q: Vector, pairs: Iterable[int]) -> Iterator[int]:
        """Yield the pairs that touch, out of some; place the shapes as :meth:`place` does."""
        self.place(q)
        return (pair for pair in pairs if self._touches_alone(pair, 0.0))

    def near(self, q: Vector, margin_m: Vector) -> list[tuple[int, float]]:
        """Return the pairs nearer than they may be and a margin, shape (pairs,) [m], with their clearances [m].

        The clearance is the distance beyond the required one. Touching pairs have 0 or less. Triangles have the
        clearance of the hulls around them or, where hulls touch and triangles do not, :data:`UNKNOWN_M`.
        """
        found = [(pair, beyond_m + float(margin_m[pair])) for pair, beyond_m in self._within(q, margin_m)]
        return [(pair, self._of_triangles_m(pair, 0.0) if pair in self._triangles else bound) for pair, bound in found]

    def near_among(
        self, q: Vector, pairs: Iterable[int], margin_m: Sequence[float] | Vector
    ) -> list[tuple[int, float]]:
        """As :meth:`near`, of some pairs only, with a margin each: a tenth of the time for a few."""
        self.place(q)
        clearances_m = [(pair, self._clearance_m(pair, each)) for pair, each in zip(pairs, margin_m, strict=True)]
        return [found for found, each in zip(clearances_m, margin_m, strict=True) if found[1] < each]

    def clearance_m(self, q: Vector, pair: int, margin_m: float) -> float:
        """Return the clearance of a pair, or the margin where it is wider; see :meth:`near` [m]."""
        self.place(q)
        return self._clearance_m(pair, margin_m)

    def place(self, q: Vector) -> None:
        """Place the shapes at a configuration, to which the methods below refer."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._single, self._joints.positions(q))

    def touching(self, q: Vector) -> list[int]:
        """Return the indices of the pairs that touch; place the shapes as :meth:`place` does."""
        return [pair for pair, _ in self._within(q, np.zeros(len(self._pairs)))]

    def distance_m(self, pair: int) -> float:
        """Return a pair's clearance beyond the required one, its depth of overlap if negative [m]."""
        return float(self._distance(pair).min_distance) - float(self._apart_m[pair])

    def nearest(self, pair: int) -> Nearest:
        """Return the nearest points of a pair's shapes, in the root link's frame."""
        found = self._distance(pair)
        return Nearest(float(found.min_distance), np.array(found.getNearestPoint1()), np.array(found.normal))

    def distance_gradients(self, pairs: Mapping[int, Nearest]) -> Vector:
        """Return the gradients of pairs' distances by joint at the last :meth:`turn`, shape (pairs, n) [m/rad].

        The points of a pair lie on the line of its normal, so a joint moves both along it at one rate: the joint's
        twist times the line's Plücker coordinates.
        """
        normals = np.array([each.normal for each in pairs.values()]).reshape(-1, 3)
        points_m = np.array([each.point_m for each in pairs.values()]).reshape(-1, 3)
        lines = np.hstack((normals, np.cross(points_m, normals)))
        return self._joints.by_joint(lines @ self._data.J * self._sides[list(pairs)])

    def turn(self, q: Vector) -> None:
        """As :meth:`place`, and make ready for :meth:`distance_gradients`."""
        self.place(q)
        pin.computeJointJacobians(self._model, self._data, self._joints.positions(q))

    def placement(self, joint: int) -> pin.SE3:
        """Return the pose of a joint in the root link's frame."""
        return self._data.oMi[joint]

    def _clearance_m(self, pair: int, margin_m: float) -> float:
        if pair in self._triangles:
            return min(margin_m, self._of_triangles_m(pair, margin_m))
        if not self._touches_alone(pair, margin_m):
            return margin_m
        return self._single_results[pair].distance_lower_bound + margin_m

    def _touches_alone(self, pair: int, margin_m: float) -> bool:
        self._single_requests[pair].security_margin = self._least_m[pair] + margin_m
        return bool(pin.computeCollision(self._geometry, self._single, pair))

    def _of_triangles_m(self, pair: int, margin_m: float) -> float:
        """Return a lower bound of a pair's clearance, or a margin that it keeps; see :meth:`near` [m]."""
        # A distance of two hulls takes 6 us; of 100,000 triangles 2 ms, and a check of these 0.4 ms.
        placed = []
        for index in self._pairs[pair].tolist():
            if index not in self._hulls:
                self._hulls[index] = without_triangles(self._shapes[index]).geometry
            place = self._single.oMg[index]
            placed.append((self._hulls[index], coal.Transform3s(place.rotation, place.translation)))
        (first, at_first), (second, at_second) = placed
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        request.gjk_tolerance = GJK_TOLERANCE
        around_m = coal.distance(first, at_first, second, at_second, request, result) - float(self._least_m[pair])
        if around_m > 0.0:
            return around_m
        if margin_m > 0.0 and not self._touches_alone(pair, margin_m):
            return margin_m
        # The first triangle within a margin ends a check: others may be nearer.
        return 0.0 if self._touches_alone(pair, 0.0) else UNKNOWN_M

    def _distance(self, pair: int) -> coal.DistanceResult:
        self._single.distanceRequests[pair].gjk_tolerance = GJK_TOLERANCE
        return pin.computeDistance(self._geometry, self._single, pair)

    def _halves(self, moving: int) -> tuple[Half, Half]:
        """Return the first shapes, which move, and the others, all with the indices that callbacks know them by."""
        away = pin.SE3(np.eye(3), np.full(3, FAR_M))
        first, others = pin.GeometryModel(), self._geometry.copy()
        others.removeAllCollisionPairs()
        for index, shape in enumerate(self._shapes[:moving]):
            first.addGeometryObject(shape)
            others.geometryObjects[index].parentJoint, others.geometryObjects[index].placement = 0, away
        first.addGeometryObject(pin.GeometryObject("away", 0, 0, away.inverse(), coal.Sphere(1.0)))
        # A manager widens both boxes of a pair by half of its margin, here one of them by all of it.
        first.setCollisionPairs(np.arange(moving + 1) == np.full((moving + 1, 1), moving), True)
        halves = (first, first.createData()), (others, others.createData())
        for request in halves[0][1].collisionRequests:
            request.security_margin = 2.0 * (CONTACT_M + self._apart_m.max(initial=0.0))
        of_first, of_others = ((self._boxes(*half), *half) for half in halves)
        return of_first, of_others

    def _boxes(self, geometry: pin.GeometryModel, data: pin.GeometryData) -> Manager:
        # Shapes that never were anywhere have boxes of garbage, which trees refuse.
        pin.updateGeometryPlacements(self._model, self._data, geometry, data)
        manager = (BOXES_ONE_BY_ONE if len(self._shapes) <= FEW_SHAPES else TREE_OF_BOXES)(self._model, geometry, data)
        manager.update(False)
        return manager

    def _detector(self, data: pin.GeometryData, *, stop_at_first: bool = False) -> Detector:
        for request in data.collisionRequests:
            request.gjk_tolerance = GJK_TOLERANCE
        self._set_margins(data, np.zeros(len(self._pairs)))
        return self._boxes(self._geometry, data), pin.CollisionCallBackDefault(self._geometry, data, stop_at_first)

    def _collide(self, q: Vector, data: pin.GeometryData, detector: Detector) -> bool:
        # One call does the same, but tries a dozen overloads first: that takes 0.7 us more with boxes one by one, 2.9
        # with a tree of boxes.
        manager, callback = detector
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, data, self._joints.positions(q))
        manager.update(False)
        return manager.collide(callback)

    def _within(self, q: Vector, margin_m: Vector) -> list[tuple[int, float]]:
        """Return the pairs nearer than they may be and a margin, with the distance beyond it, and place the shapes."""
        self._set_margins(self._near, margin_m)
        found = _taken(self._near_results) if self._collide(q, self._near, self._vicinity) else []
        self.place(q)
        return found

    def _set_margins(self, data: pin.GeometryData, margin_m: Vector) -> None:
        self._margins_m[self._pairs[:, 0], self._pairs[:, 1]] = CONTACT_M + self._apart_m + margin_m
        data.setSecurityMargins(self._geometry, self._margins_m, True, True)


def _taken(results: Sequence[coal.CollisionResult]) -> list[tuple[int, float]]:
    """Return the pairs nearer than their margins, with the distance beyond these [m], and clear their results.

    A pair whose boxes are apart keeps the result it has.
    """
    touching = compress(count(), map(coal.CollisionResult.numContacts, results))  # of 141 pairs in 8 us, not 18
    found = [(pair, results[pair].distance_lower_bound) for pair in touching]
    for pair, _ in found:
        results[pair].clear()
    return found

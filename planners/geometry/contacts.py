"""Contact checks in two fidelities: all checked pairs of hulls at once, and pairs of links or objects by their parts.

The check of hulls is quick and conservative, because hulls contain their links. Parts are convex shapes closer to a
link than its hull: they decide where hulls touch. A body that touches no part may still be inside the link; the link's
surface decides that.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.errors import ShapeError
from planners.geometry import boxes, surfaces
from planners.geometry.boxes import Boxes
from planners.geometry.kinematics import JointMap
from planners.geometry.nearness import BoundingSpheres, Nearest, distance_gradient
from planners.geometry.shapes import convex, corners, link_name, on_link, outline, urdf_shapes
from planners.geometry.surfaces import TriangleSurface
from robot.description.model import RobotModel
from robot.trajectory import Vector

# With coal's default of 1e-6 one pair in 80 000 that overlaps, by up to 48 mm, is called free: the search for a common
# point gives up too early on shapes of a few centimetres. With this tolerance it errs on 0 of 1.6 million, at no cost.
GJK_TOLERANCE = 1e-9

# With a margin of exactly 0 coal calls one in a thousand pairs free that overlap by centimetres and whose faces are
# parallel, as on an arm in its zero position beside boxes; with any other margin 0 of 27 000.
CONTACT_M = 1e-6

# Finds the pairs whose boxes overlap. With each box compared to each other a check of 7 to 14 shapes takes 0.45 to 0.5
# times as long as with a tree of boxes, of 37 shapes 0.53, of 107 shapes 0.8, of 307 shapes 2.7.
Manager: TypeAlias = pin.BroadPhaseManager_NaiveCollisionManager | pin.BroadPhaseManager_DynamicAABBTreeCollisionManager
BOXES_ONE_BY_ONE = pin.BroadPhaseManager_NaiveCollisionManager
TREE_OF_BOXES = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager
FEW_SHAPES = 100


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
        self._carriers = [shape.parentJoint for shape in shapes]
        self._shapes = shapes
        # Made at the first use: only servoing needs them, and a large scene has many.
        self._bounding_spheres: BoundingSpheres | None = None
        self._margins_m = np.zeros((len(shapes), len(shapes)))
        # Managers keep references to the models. They take margins over on update only, so there is one for near
        # pairs. A check that ends with the first contact leaves a result behind, so it has one of its own as well.
        self._any, self._contact, self._near = (self._geometry.createData() for _ in range(3))
        pin.forwardKinematics(model, self._data, pin.neutral(model))
        self._any_contact, self._contacts, self._vicinity = map(self._manager, (self._any, self._contact, self._near))
        self._contact_results = list(self._contact.collisionResults)
        self._near_results = list(self._near.collisionResults)
        # Pairs that are checked one by one have margins of their own.
        self._single = self._geometry.createData()
        self._single_requests = list(self._single.collisionRequests)
        for request in self._single_requests:
            request.gjk_tolerance = GJK_TOLERANCE
        self._least_m = (CONTACT_M + apart_m).tolist()

    def touches(self, q: Vector) -> bool:
        """Return true if shapes of any pair touch, or are nearer than they may be."""
        return pin.computeCollisions(self._model, self._data, self._any_contact, self._positions(q), True)

    def near(self, q: Vector, margin_m: Vector) -> list[int]:
        """Indices of the pairs whose shapes are nearer than they may be and a margin, shape (pairs,) [m]."""
        self._set_margins(self._near, self._vicinity, margin_m)
        if not pin.computeCollisions(self._model, self._data, self._vicinity, self._positions(q), False):
            return []
        return _taken(self._near_results)

    def near_among(self, q: Vector, pairs: Iterable[int], margin_m: Sequence[float] | Vector) -> list[int]:
        """As :meth:`near`, of some pairs only: a tenth of the time for a few; ``margin_m`` is by all pairs' indices."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._single, self._positions(q))
        geometry, data, found = self._geometry, self._single, []
        for pair in pairs:
            self._single_requests[pair].security_margin = self._least_m[pair] + margin_m[pair]
            if pin.computeCollision(geometry, data, pair):
                found.append(pair)
        return found

    def place(self, q: Vector) -> None:
        """Place the shapes at a configuration, to which the methods below refer."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._contact, self._positions(q))

    def touching(self, q: Vector) -> list[int]:
        """Place the shapes as :meth:`place` does; return the indices of the pairs that touch."""
        if not pin.computeCollisions(self._model, self._data, self._contacts, self._positions(q), False):
            return []
        return _taken(self._contact_results)

    def touching_among(self, pairs: Iterable[int]) -> list[int]:
        """Return the pairs among some that touch."""
        found = [pair for pair in pairs if pin.computeCollision(self._geometry, self._contact, pair)]
        for pair in found:
            self._contact_results[pair].clear()
        return found

    def distance_m(self, pair: int) -> float:
        """Return a pair's clearance beyond the required one, its depth of overlap if negative [m]."""
        return float(self._distance(pair).min_distance) - float(self._apart_m[pair])

    def within(self, margin_m: float) -> NDArray[np.intp]:
        """Indices of the pairs that may be nearer than a margin beyond what they must be apart [m]."""
        if self._bounding_spheres is None:
            self._bounding_spheres = BoundingSpheres(self._shapes, self._pairs)
        return self._bounding_spheres.within(self._data, self._apart_m + margin_m)

    def nearest(self, pair: int) -> Nearest:
        """Return the nearest points of a pair's shapes, in the root link's frame."""
        found = self._distance(pair)
        return Nearest(float(found.min_distance), np.array(found.getNearestPoint1()), np.array(found.normal))

    def distance_gradient(self, pair: int, nearest: Nearest) -> Vector:
        """Return the gradient of a pair's distance by joint at the last :meth:`turn`, shape (n,) [m/rad]."""
        first, second = (self._carriers[i] for i in self._pairs[pair])
        return self._joints.by_joint(distance_gradient(self._model, self._data, nearest, first, second))

    def turn(self, q: Vector) -> None:
        """As :meth:`place`, and make ready for :meth:`distance_gradient`."""
        self.place(q)
        pin.computeJointJacobians(self._model, self._data, self._positions(q))

    def placement(self, joint: int) -> pin.SE3:
        """Return the pose of a joint in the root link's frame."""
        return self._data.oMi[joint]

    def _positions(self, q: Vector) -> Vector:
        return self._joints.positions(q)

    def _distance(self, pair: int) -> coal.DistanceResult:
        self._contact.distanceRequests[pair].gjk_tolerance = GJK_TOLERANCE
        return pin.computeDistance(self._geometry, self._contact, pair)

    def _manager(self, data: pin.GeometryData) -> Manager:
        for request in data.collisionRequests:
            request.gjk_tolerance = GJK_TOLERANCE
        # Shapes that never were anywhere have boxes of garbage, which trees refuse.
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, data)
        make = BOXES_ONE_BY_ONE if len(self._shapes) <= FEW_SHAPES else TREE_OF_BOXES
        manager = make(self._model, self._geometry, data)
        self._set_margins(data, manager, np.zeros(len(self._pairs)))
        return manager

    def _set_margins(self, data: pin.GeometryData, manager: Manager, margin_m: Vector) -> None:
        self._margins_m[self._pairs[:, 0], self._pairs[:, 1]] = CONTACT_M + self._apart_m + margin_m
        data.setSecurityMargins(self._geometry, self._margins_m, True, True)
        manager.update(True)


def _taken(results: Sequence[coal.CollisionResult]) -> list[int]:
    """Return the pairs in contact, whose results are cleared: a pair whose boxes are apart keeps the one it has."""
    found = [pair for pair, result in enumerate(results) if result.isCollision()]
    for pair in found:
        results[pair].clear()
    return found


@dataclass(frozen=True)
class Parts:
    """Shapes that are carried together, each within a box along the axes of the joint that carries them."""

    shapes: Sequence[coal.CollisionGeometry]
    boxes: Boxes
    # Where shapes are in the joint's frame, each place once: shapes of a link mostly share one.
    places: Sequence[pin.SE3]
    place_of: Sequence[int]  # index of each shape's place
    # Surface of the whole, or its meshes, where these are known beside the shapes.
    enclosed_by: TriangleSurface | Parts | None = None

    def outline(self) -> Vector:
        """Points whose hull encloses the shapes, shape (n, 3) [m], in the joint's frame."""
        return np.vstack([corners(shape) @ place.rotation.T + place.translation for shape, place in self._placed()])

    @property
    def surface(self) -> TriangleSurface | None:
        """Surface in the joint's frame that encloses the inside; None for solid shapes, which touch all inside them."""
        around = self.enclosed_by
        return around.surface if isinstance(around, Parts) else around or self._mesh_surface

    @cached_property
    def points_m(self) -> Vector:
        """One point of each connected body, shape (n, 3) [m], in the joint's frame."""
        # The convex parts of a link cover its few bodies: a point of each of the parts would be checked in vain.
        if self.enclosed_by is not None:
            return self.enclosed_by.points_m
        solid = (pair for pair in self._placed() if not isinstance(pair[0], coal.BVHModelBase))
        middles_m = [place.act(corners(shape).mean(axis=0)) for shape, place in solid]
        return np.vstack([*middles_m, *([] if self._mesh_surface is None else [self._mesh_surface.points_m])])

    @cached_property
    def _mesh_surface(self) -> TriangleSurface | None:
        meshes = [(shape, place) for shape, place in self._placed() if isinstance(shape, coal.BVHModelBase)]
        return surfaces.of_meshes(meshes) if meshes else None

    def encloses(self, other: Parts, between: pin.SE3) -> bool:
        """Return true if a body of other parts, the pose of whose joint is ``between``, is inside the surface."""
        if self.surface is None:
            return False
        return self.surface.encloses(other.points_m @ between.rotation.T + between.translation)

    def _placed(self) -> Iterator[tuple[coal.CollisionGeometry, pin.SE3]]:
        return zip(self.shapes, (self.places[place] for place in self.place_of), strict=True)


def parts_of(shapes: Sequence[pin.GeometryObject], enclosed_by: TriangleSurface | Parts | None = None) -> Parts:
    """Return shapes of one joint with the boxes around them."""
    points_m = [outline(shape) for shape in shapes]
    lower_m = np.array([points.min(axis=0) for points in points_m]).reshape(-1, 3)
    upper_m = np.array([points.max(axis=0) for points in points_m]).reshape(-1, 3)
    places = {shape.placement.homogeneous.tobytes(): shape.placement for shape in shapes}
    order = list(places)
    place_of = [order.index(shape.placement.homogeneous.tobytes()) for shape in shapes]
    geometries = [shape.geometry for shape in shapes]
    return Parts(geometries, Boxes.between(lower_m, upper_m), list(places.values()), place_of, enclosed_by)


class RobotParts:
    """Parts of a robot's links: convex ones where these are known, or else the shapes of the URDF with their meshes.

    They are ``available`` where they are closer than the hulls, and ``convex`` where the depth of their overlap is
    known. All are loaded at once: their 0.1 s, with meshes of the URDF a second, would come in the middle of a plan
    otherwise. ``urdf`` are the shapes of the URDF where these are loaded already.
    """

    def __init__(self, robot: RobotModel, model: pin.Model, urdf: Sequence[pin.GeometryObject] | None = None) -> None:
        self.convex = bool(robot.parts)
        has_meshes = "<mesh" in robot.urdf
        self.available = self.convex or (not robot.hulls and has_meshes)
        self._links: dict[str, Parts] = {}
        if not self.available:
            return
        if urdf is None and has_meshes:
            # Hulls and parts do without the meshes that they were made of.
            with contextlib.suppress(*([ShapeError] if robot.parts else [])):
                urdf = urdf_shapes(robot, model)
        by_link: dict[str, list[pin.GeometryObject]] = {}
        for shape in urdf or ():
            by_link.setdefault(link_name(model, shape), []).append(shape)
        meshes = {link: parts_of(shapes) for link, shapes in by_link.items()}
        enclosed_by: dict[str, TriangleSurface | Parts] = {**meshes, **dict(surfaces.load(robot.surfaces, model))}
        self._links = (
            meshes
            if not self.convex
            else {
                link: parts_of([on_link(model, link, convex(each)) for each in parts], enclosed_by.get(link))
                for link, parts in robot.parts.items()
            }
        )

    def of_link(self, link: str) -> Parts:
        """The parts of a link."""
        return self._links[link]


class PartPair:
    """Parts of two bodies, each with the pose of the joint that carries it."""

    def __init__(self, first: Parts, at_first: pin.SE3, second: Parts, at_second: pin.SE3) -> None:
        self._first, self._second, self._at_first = first, second, at_first
        # All that follows is in the frame of the first joint.
        self._between = between = at_first.actInv(at_second)
        self._first_places = [_transform(place) for place in first.places]
        self._second_places = [_transform(between * place) for place in second.places]

    def nearer_than(self, margin_m: float) -> bool:
        """Return true if parts come nearer to each other than a margin [m]; at a margin of 0, if they touch."""
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        request.gjk_tolerance = GJK_TOLERANCE
        request.security_margin = CONTACT_M + margin_m
        for i, j in self._near_pairs(request.security_margin):
            result.clear()
            if coal.collide(*self._placed(i, j), request, result):
                return True
        return False

    def deeper_than(self, depth_m: float) -> bool:
        """Return true if convex parts overlap deeper than a depth [m]; below 0, if they are less than that apart."""
        if depth_m < 0.0:
            return self.nearer_than(-depth_m)
        request, result = _distance_request()
        for i, j in self._near_pairs(-depth_m):
            result.clear()
            if -coal.distance(*self._placed(i, j), request, result) > depth_m:
                return True
        return False

    def nearest(self) -> Nearest:
        """Return the nearest or deepest points of convex parts, in the root link's frame."""
        request, result = _distance_request()
        bounds_m = boxes.least_distance_m(self._first.boxes, self._second.boxes, self._between).ravel()
        found = Nearest(np.inf, np.zeros(3), np.zeros(3))
        for index in np.argsort(bounds_m):
            if bounds_m[index] >= found.distance_m:
                break
            result.clear()
            placed = self._placed(*divmod(int(index), len(self._second.shapes)))
            distance_m = coal.distance(*placed, request, result)
            if distance_m < found.distance_m:
                # Copied: the result's own arrays change with the next pair.
                found = Nearest(distance_m, np.array(result.getNearestPoint1()), np.array(result.normal))
        return found.transformed(self._at_first)

    def first_encloses_second(self) -> bool:
        """Return true if a body of the second is inside the surface of the first, where the two do not touch."""
        return self._first.encloses(self._second, self._between)

    def second_encloses_first(self) -> bool:
        """As :meth:`first_encloses_second`, the other way round."""
        return self._second.encloses(self._first, self._between.inverse())

    def _near_pairs(self, margin_m: float) -> list[list[int]]:
        pairs: list[list[int]] = boxes.near_pairs(
            self._first.boxes, self._second.boxes, self._between, margin_m
        ).tolist()
        return pairs

    def _placed(
        self, i: int, j: int
    ) -> tuple[coal.CollisionGeometry, coal.Transform3s, coal.CollisionGeometry, coal.Transform3s]:
        first, second = self._first, self._second
        at_first, at_second = self._first_places[first.place_of[i]], self._second_places[second.place_of[j]]
        return first.shapes[i], at_first, second.shapes[j], at_second


def _distance_request() -> tuple[coal.DistanceRequest, coal.DistanceResult]:
    request = coal.DistanceRequest()
    request.gjk_tolerance = GJK_TOLERANCE
    return request, coal.DistanceResult()


def _transform(place: pin.SE3) -> coal.Transform3s:
    return coal.Transform3s(place.rotation, place.translation)

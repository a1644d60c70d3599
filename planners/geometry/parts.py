"""Parts of links and objects: convex shapes closer to a link than its hull, which decide where hulls touch.

Parts of two bodies are compared by boxes around them first. numpy is slow with a last axis of three, so the first axis
of boxes is x, y, z. A body that touches no part may still be inside the link; the link's surface decides that.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.errors import ShapeError
from planners.geometry.broadphase import CONTACT_M, GJK_TOLERANCE, Nearest
from planners.geometry.shapes import convex, corners, link_name, on_link, outline, urdf_shapes
from planners.geometry.surfaces import TriangleSurface, load_surfaces, of_meshes
from robot.description.model import RobotModel
from robot.trajectory import Vector

# Cross products with the unit vectors along x, y and z from the left, as matrices.
_ACROSS = np.zeros((3, 3, 3))
for _x, _y, _z in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _ACROSS[_x, _y, _z], _ACROSS[_x, _z, _y] = -1.0, 1.0

FEW_PAIRS = 4  # pairs of parts that are all checked


@dataclass(frozen=True)
class Boxes:
    """Boxes along the axes of one joint."""

    middles_m: Vector  # shape (3, n), in the joint's frame [m]
    halves_m: Vector  # shape (3, n), half the edges [m]

    @classmethod
    def between(cls, lower_m: Vector, upper_m: Vector) -> Boxes:
        """Return the boxes between corners, shape (n, 3) each [m]."""
        return cls(np.ascontiguousarray(0.5 * (lower_m + upper_m).T), np.ascontiguousarray(0.5 * (upper_m - lower_m).T))

    @cached_property
    def around(self) -> Boxes:
        """One box around all of them."""
        lower_m, upper_m = (self.middles_m - self.halves_m).min(axis=1), (self.middles_m + self.halves_m).max(axis=1)
        return Boxes.between(lower_m[np.newaxis], upper_m[np.newaxis])

    def chosen(self, indices: NDArray[np.intp]) -> Boxes:
        """Return some of them."""
        return Boxes(self.middles_m[:, indices], self.halves_m[:, indices])


def overlap_m(first: Boxes, second: Boxes, between: pin.SE3) -> Vector:
    """Return how far boxes of two joints overlap along the axis of least overlap, shape (first, second) [m].

    Shapes in the boxes cannot overlap deeper; below 0 they are at least that far apart. ``between`` is the pose of the
    second joint in the first one's frame.
    """
    # Along the axes of one joint the boxes of the other are wider than they are: by the whole link, for a table.
    by_first_m = _along_axes_m(first, second, between).min(axis=0)
    by_second_m = _along_axes_m(second, first, between.inverse()).min(axis=0)
    return np.asarray(np.minimum(by_first_m, by_second_m.T))


def least_distance_m(first: Boxes, second: Boxes, between: pin.SE3) -> Vector:
    """Return lower bounds of the distances of shapes in boxes, of their overlap if negative; see :func:`overlap_m`."""
    by_first_m = _along_axes_m(first, second, between)
    by_second_m = _along_axes_m(second, first, between.inverse()).swapaxes(1, 2)
    overlaps_m = np.minimum(by_first_m.min(axis=0), by_second_m.min(axis=0))
    apart_m2 = ((np.minimum(each_m, 0.0) ** 2).sum(axis=0) for each_m in (by_first_m, by_second_m))
    return np.asarray(np.where(overlaps_m > 0.0, -overlaps_m, np.sqrt(np.maximum(*apart_m2))))


def near_pairs(first: Boxes, second: Boxes, between: pin.SE3, margin_m: float) -> NDArray[np.intp]:
    """Return the pairs of boxes that no plane separates by more than a margin, shape (pairs, 2), most overlap first.

    The planes are across the axes of both joints and the products of two axes: Gottschalk et al., "OBBTree", 1996.
    Arguments as for :func:`overlap_m`.
    """
    # Of two links' thousand boxes a few come near the one around all of the other's.
    i = np.flatnonzero(_along_axes_m(second.around, first, between.inverse()).min(axis=0)[0] >= -margin_m)
    j = np.flatnonzero(_along_axes_m(first.around, second, between).min(axis=0)[0] >= -margin_m) if len(i) else i
    if not len(j):
        return np.empty((0, 2), dtype=np.intp)
    overlaps_m = overlap_m(first.chosen(i), second.chosen(j), between).ravel()
    near = np.flatnonzero(overlaps_m >= -margin_m)
    near = near[np.argsort(-overlaps_m[near], kind="stable")]
    i, j = i[near // len(j)], j[near % len(j)]
    pairs: NDArray[np.intp] = np.stack((i, j), axis=1)
    return pairs[_meet_across_edges(first.chosen(i), second.chosen(j), between, margin_m)]


def _along_axes_m(first: Boxes, second: Boxes, between: pin.SE3) -> Vector:
    """Return how far boxes overlap along each axis of the first one's joint, shape (3, first, second) [m]."""
    middles_m = between.rotation @ second.middles_m + between.translation[:, np.newaxis]
    halves_m = np.abs(between.rotation) @ second.halves_m
    offset_m = first.middles_m[:, :, np.newaxis] - middles_m[:, np.newaxis]
    return np.asarray(first.halves_m[:, :, np.newaxis] + halves_m[:, np.newaxis] - np.abs(offset_m))


def _meet_across_edges(first: Boxes, second: Boxes, between: pin.SE3, margin_m: float) -> NDArray[np.bool_]:
    """Return the pairs (i-th with i-th box) that no plane along an edge of both separates by more than a margin."""
    rotation = between.rotation
    axes = (_ACROSS @ rotation).swapaxes(1, 2).reshape(9, 3)
    offset_m = rotation @ second.middles_m + between.translation[:, np.newaxis] - first.middles_m
    reach_m = np.abs(axes) @ first.halves_m + np.abs(axes @ rotation) @ second.halves_m
    reach_m += margin_m * np.sqrt((axes**2).sum(axis=1))[:, np.newaxis]
    return np.asarray((np.abs(axes @ offset_m) <= reach_m).all(axis=0))


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
        """Six points of each connected body, shape (n, 6, 3) [m], in the joint's frame."""
        # The convex parts of a link cover its few bodies: a point of each of the parts would be checked in vain.
        if self.enclosed_by is not None:
            return self.enclosed_by.points_m
        solid = (pair for pair in self._placed() if not isinstance(pair[0], coal.BVHModelBase))
        middles_m = [np.tile(place.act(corners(shape).mean(axis=0)), (1, 6, 1)) for shape, place in solid]
        return np.concatenate([*middles_m, *([] if self._mesh_surface is None else [self._mesh_surface.points_m])])

    @cached_property
    def _mesh_surface(self) -> TriangleSurface | None:
        meshes = [(shape, place) for shape, place in self._placed() if isinstance(shape, coal.BVHModelBase)]
        return of_meshes(meshes) if meshes else None

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


@lru_cache(1000)
def _part(corners_m: bytes) -> coal.Convex:
    """A convex part; models of the same arm share it."""
    return convex(np.frombuffer(corners_m).reshape(-1, 3))


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
        enclosed_by: dict[str, TriangleSurface | Parts] = {**meshes, **dict(load_surfaces(robot.surfaces, model))}
        self._links = {
            link: parts_of([on_link(model, link, _part(each.tobytes())) for each in parts], enclosed_by.get(link))
            for link, parts in robot.parts.items()
        } or meshes

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
        """Return the nearest points of parts, the deepest where convex ones overlap, in the root link's frame."""
        request, result = _distance_request()
        bounds_m = least_distance_m(self._first.boxes, self._second.boxes, self._between).ravel()
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
        turn = self._at_first.rotation
        return Nearest(found.distance_m, turn @ found.point_m + self._at_first.translation, turn @ found.normal)

    def encloses(self, by_first: bool, by_second: bool) -> bool:
        """Return true if a body of one is inside the surface of the other, as far as asked, where they do not touch."""
        return (by_first and self._first.encloses(self._second, self._between)) or (
            by_second and self._second.encloses(self._first, self._between.inverse())
        )

    def _near_pairs(self, margin_m: float) -> Iterable[Sequence[int]]:
        first, second = self._first, self._second
        # Comparing boxes takes as long as ten checks.
        if len(first.shapes) * len(second.shapes) <= FEW_PAIRS:
            return product(range(len(first.shapes)), range(len(second.shapes)))
        pairs: list[list[int]] = near_pairs(first.boxes, second.boxes, self._between, margin_m).tolist()
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

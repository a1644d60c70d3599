"""The last word on contacts of links: shapes that are closer to the links than one hull each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.broadphase import CONTACT_M, GJK_TOLERANCE
from planners.geometry.hulls import convex
from planners.geometry.nearness import Nearest
from planners.geometry.shapes import link_name, on_link, outline, urdf_shapes
from robot.description.model import RobotModel

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Parts:
    """Shapes that are carried together, each within a box along the axes of the joint that carries them.

    Attributes:
        shapes: the shapes.
        middles_m: shape (3, n), middles of the boxes in the joint's frame [m].
        halves_m: shape (3, n), half the edges of the boxes [m].
        places: where shapes are in the joint's frame, each place once: those of a link mostly share one.
        place_of: index of each shape's place.
    """

    shapes: Sequence[pin.GeometryObject]
    middles_m: Vector
    halves_m: Vector
    places: Sequence[pin.SE3]
    place_of: Sequence[int]


def parts_of(shapes: Sequence[pin.GeometryObject]) -> Parts:
    """Shapes of one joint with the boxes around them."""
    points_m = [outline(shape) for shape in shapes]
    lower_m = np.array([points.min(axis=0) for points in points_m]).reshape(-1, 3)
    upper_m = np.array([points.max(axis=0) for points in points_m]).reshape(-1, 3)
    # Axes first: numpy reduces a last axis of three ten times more slowly.
    middles_m, halves_m = (np.ascontiguousarray(0.5 * each.T) for each in (lower_m + upper_m, upper_m - lower_m))
    places = {shape.placement.homogeneous.tobytes(): shape.placement for shape in shapes}
    order = list(places)
    place_of = [order.index(shape.placement.homogeneous.tobytes()) for shape in shapes]
    return Parts(shapes, middles_m, halves_m, list(places.values()), place_of)


class ExactShapes:
    """A robot's links closer than their hulls: in convex parts where these are known, else the URDF's own meshes.

    Parts are made at once: their 0.1 s would come in the middle of a plan otherwise. Meshes are loaded when they are
    first asked for: those of the SO-101 take 1.4 s and 300 MB. Meshes are surfaces: what is wholly inside one does not
    touch it.

    Args:
        robot: its parts are used, or else the meshes that its URDF names.
        model: its joints.

    Attributes:
        available: whether there are any.
        solid: whether they are parts: of these it is known how deep they overlap.
    """

    def __init__(self, robot: RobotModel, model: pin.Model) -> None:
        self._robot, self._model = robot, model
        self.solid = bool(robot.parts)
        self.available = self.solid or (not robot.hulls and "<mesh" in robot.urdf)
        self._links = self._load() if self.solid else {}

    def of_link(self, link: str) -> Parts:
        """The shapes of a link."""
        if not self._links:
            self._links = self._load()
        return self._links[link]

    def _load(self) -> dict[str, Parts]:
        links: dict[str, list[pin.GeometryObject]] = {}
        for link, parts in self._robot.parts.items():
            links[link] = [on_link(self._model, link, convex(vertices)) for vertices in parts]
        for shape in urdf_shapes(self._robot, self._model) if not self.solid else ():
            links.setdefault(link_name(self._model, shape), []).append(shape)
        return {name: parts_of(shapes) for name, shapes in links.items()}


def nearer_than(first: Parts, at_first: pin.SE3, second: Parts, at_second: pin.SE3, margin_m: float) -> bool:
    """Whether parts come nearer to each other than a margin; at a margin of 0, whether they touch.

    Args:
        first: some parts.
        at_first: where the joint that carries them is.
        second: other parts.
        at_second: where the joint that carries those is.
        margin_m: greatest distance that counts [m].
    """
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.gjk_tolerance = GJK_TOLERANCE
    request.security_margin = CONTACT_M + margin_m
    boxes = _Boxes(first, second, at_first.actInv(at_second))
    for pair in np.argwhere(boxes.apart_m <= request.security_margin).tolist():
        result.clear()
        if coal.collide(*boxes.placed(*pair), request, result):
            return True
    return False


def deeper_than(first: Parts, at_first: pin.SE3, second: Parts, at_second: pin.SE3, depth_m: float) -> bool:
    """Whether solid parts overlap deeper than so much, below 0 whether they are less than that apart [m]."""
    if depth_m < 0.0:
        return nearer_than(first, at_first, second, at_second, -depth_m)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.gjk_tolerance = GJK_TOLERANCE
    boxes = _Boxes(first, second, at_first.actInv(at_second))
    for pair in np.argwhere(boxes.overlap_m > depth_m).tolist():
        result.clear()
        if -coal.distance(*boxes.placed(*pair), request, result) > depth_m:
            return True
    return False


def overlap_m(first: Parts, at_first: pin.SE3, second: Parts, at_second: pin.SE3) -> float:
    """How deep solid parts overlap, below 0 how far they are apart [m]; arguments as for :func:`nearer_than`."""
    return -nearest(first, at_first, second, at_second).distance_m


def nearest(first: Parts, at_first: pin.SE3, second: Parts, at_second: pin.SE3) -> Nearest:
    """Where solid parts are nearest or overlap deepest, in the root link's frame; as for :func:`nearer_than`."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.gjk_tolerance = GJK_TOLERANCE
    boxes = _Boxes(first, second, at_first.actInv(at_second))
    bounds_m = np.where(boxes.overlap_m > 0.0, boxes.overlap_m, -boxes.apart_m).ravel()
    found = Nearest(np.inf, np.zeros(3), np.zeros(3))
    for index in np.argsort(-bounds_m):
        if bounds_m[index] <= -found.distance_m:
            break
        result.clear()
        distance_m = coal.distance(*boxes.placed(*divmod(index, len(second.shapes))), request, result)
        if distance_m < found.distance_m:
            # What the result shows of itself changes with the next pair.
            found = Nearest(distance_m, np.array(result.getNearestPoint1()), np.array(result.normal))
    return found.seen_from(at_first)


class _Boxes:
    """The boxes around two sets of parts, seen from the first one's joint.

    Args:
        first: parts there.
        second: other parts.
        between: where the second one's joint is.

    Attributes:
        overlap_m: how far each two boxes overlap along the axis of least overlap, shape (first, second); shapes in
            them cannot overlap deeper. Below 0 they are at least that far apart [m].
        apart_m: how far each two boxes are apart at least, shape (first, second) [m].
    """

    def __init__(self, first: Parts, second: Parts, between: pin.SE3) -> None:
        self._first, self._second = first, second
        self._first_places = [_transform(place) for place in first.places]
        self._second_places = [_transform(between * place) for place in second.places]
        middles_m = between.rotation @ second.middles_m + between.translation[:, np.newaxis]
        halves_m = np.abs(between.rotation) @ second.halves_m
        offset_m = first.middles_m[:, :, np.newaxis] - middles_m[:, np.newaxis]
        overlap_m = first.halves_m[:, :, np.newaxis] + halves_m[:, np.newaxis] - np.abs(offset_m)
        self.overlap_m: Vector = overlap_m.min(axis=0)
        self.apart_m: Vector = np.sqrt((np.minimum(overlap_m, 0.0) ** 2).sum(axis=0))

    def placed(
        self, i: int, j: int
    ) -> tuple[coal.CollisionGeometry, coal.Transform3s, coal.CollisionGeometry, coal.Transform3s]:
        """One part of each, as coal takes them."""
        first, second = self._first, self._second
        at_first, at_second = self._first_places[first.place_of[i]], self._second_places[second.place_of[j]]
        return first.shapes[i].geometry, at_first, second.shapes[j].geometry, at_second


def _transform(place: pin.SE3) -> coal.Transform3s:
    return coal.Transform3s(place.rotation, place.translation)

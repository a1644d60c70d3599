"""The last word on contacts of links: shapes that are closer to the links than one hull each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.broadphase import CONTACT_M, GJK_TOLERANCE
from planners.geometry.hulls import convex
from planners.geometry.shapes import link_name, on_link, urdf_shapes
from robot.model import RobotModel

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Parts:
    """Shapes that are carried together.

    Attributes:
        shapes: the shapes, all carried by one joint.
        middles_m: shape (n, 3), middle of a sphere around each, in the joint's frame [m].
        radii_m: shape (n,), its radius [m].
    """

    shapes: Sequence[pin.GeometryObject]
    middles_m: Vector
    radii_m: Vector


def parts_of(shapes: Sequence[pin.GeometryObject]) -> Parts:
    """Shapes of one joint with the spheres around them."""
    for shape in shapes:
        shape.geometry.computeLocalAABB()
    middles_m = [shape.placement.act(shape.geometry.aabb_center) for shape in shapes]
    return Parts(shapes, np.array(middles_m).reshape(-1, 3), np.array([s.geometry.aabb_radius for s in shapes]))


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
    request = coal.CollisionRequest()
    request.gjk_tolerance = GJK_TOLERANCE
    request.security_margin = CONTACT_M + margin_m
    return any(
        coal.collide(*both, request, coal.CollisionResult())
        for both in _within_reach(first, at_first, second, at_second, margin_m)
    )


def overlap_m(first: Parts, at_first: pin.SE3, second: Parts, at_second: pin.SE3) -> float:
    """How deep solid parts overlap at most, 0 or less where they do not [m]; arguments as for :func:`nearer_than`."""
    request = coal.DistanceRequest()
    request.gjk_tolerance = GJK_TOLERANCE
    near = _within_reach(first, at_first, second, at_second, 0.0)
    return max((-coal.distance(*both, request, coal.DistanceResult()) for both in near), default=0.0)


def _within_reach(
    first: Parts, at_first: pin.SE3, second: Parts, at_second: pin.SE3, margin_m: float
) -> Iterator[tuple[coal.CollisionGeometry, coal.Transform3s, coal.CollisionGeometry, coal.Transform3s]]:
    """Pairs of parts whose spheres come nearer than a margin, each with its place in the first joint's frame."""
    between = at_first.actInv(at_second)
    middles_m = second.middles_m @ between.rotation.T + between.translation
    apart_m = np.linalg.norm(first.middles_m[:, np.newaxis] - middles_m, axis=2)
    reach_m = first.radii_m[:, np.newaxis] + second.radii_m + margin_m
    for i, j in np.argwhere(apart_m <= reach_m):
        one, other = first.shapes[i], second.shapes[j]
        yield one.geometry, _transform(one.placement), other.geometry, _transform(between * other.placement)


def _transform(place: pin.SE3) -> coal.Transform3s:
    return coal.Transform3s(place.rotation, place.translation)

"""Triangle surfaces of links, which decide if a body is inside a link: in its material it may touch no part.

The measure is the winding number: Jacobson, Kavan and Sorkine-Hornung, "Robust inside-outside segmentation using
generalized winding numbers", 2013. Neighbouring triangles lie in pieces, so that far ones count together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.errors import ShapeError
from planners.geometry.shapes import frame_of_link
from robot.description.meshes import surface_file
from robot.description.model import LinkSurface
from robot.errors import DescriptionError
from robot.trajectory import Vector

UNIT_M = 1e-5  # coordinates in files are multiples of this [m]

TRIANGLES_A_PIECE = 128

ORDER_BITS = 10  # bits by which each coordinate of a triangle's middle counts in the order of triangles

# Seen from this many half diagonals of its box away, a piece counts as one dipole (Barill et al., "Fast winding numbers
# for soups and clouds", 2018). On the SO-101 winding numbers are then off by 0.04 at most.
FAR = 1.5

NO_AREA_M2 = 1e-18  # weight of a triangle without area in the middle of its piece [m2]
INSIDE = 0.5  # a surface encloses points with a greater winding number: 1 inside of a closed one, 0 outside

Triangles = NDArray[np.int32]

PlacedMesh = tuple[coal.BVHModelBase, pin.SE3]  # a mesh and its place in the frame of a link or joint


class TriangleSurface:
    """Surface of bodies in a joint's frame: vertices, (n, 3) [m], and triangles, (m, 3), mostly next to neighbours."""

    def __init__(self, vertices_m: Vector, triangles: Triangles) -> None:
        self._vertices_m, self._triangles = vertices_m, triangles
        starts = np.arange(0, len(triangles), TRIANGLES_A_PIECE)
        # Corner by corner: numpy is slow along an axis of three.
        a, b, c = (vertices_m[corners] for corners in triangles.T)
        # Corners of the boxes around the pieces.
        self._lower_m: Vector = np.minimum.reduceat(np.minimum(np.minimum(a, b), c), starts)
        self._upper_m: Vector = np.maximum.reduceat(np.maximum(np.maximum(a, b), c), starts)

    @cached_property
    def points_m(self) -> Vector:
        """Outermost vertices of each connected body, shape (bodies, 6, 3) [m]."""
        body = np.arange(len(self._vertices_m))
        first, second = np.concatenate((self._triangles[:, :2], self._triangles[:, 1:])).T
        while len(first):
            ends = body[first], body[second]
            for each in ends:
                np.minimum.at(body, each, np.minimum(*ends))
            while not np.array_equal(body, further := body[body]):
                body = further
            apart = body[first] != body[second]
            first, second = first[apart], second[apart]
        # A mesh of loose triangles has as many bodies: all are looked at together.
        bodies, ordered = np.unique(body[self._triangles[:, 0]]), np.sort(body)
        sides = np.searchsorted(ordered, bodies), np.searchsorted(ordered, bodies, "right") - 1
        along = [np.lexsort((coordinate, body)) for coordinate in self._vertices_m.T]
        outermost: Vector = self._vertices_m[np.stack([each[side] for side in sides for each in along], axis=1)]
        return outermost

    @cached_property
    def box_m(self) -> tuple[Vector, Vector]:
        """Lower and upper corner of the box around it, shape (3,) each [m]."""
        return self._lower_m.min(axis=0), self._upper_m.max(axis=0)

    def encloses(self, points_m: Vector) -> bool:
        """Return true if any of some bodies is inside, by points of each, shape (bodies, k, 3) [m].

        Bodies do not touch the surface: one with any point outside is outside. A mirrored mesh counts as any other.
        """
        lower_m, upper_m = self.box_m
        within = ((points_m > lower_m) & (points_m < upper_m)).reshape(len(points_m), -1).all(axis=1)
        return any(abs(self.winding_number(each[0])) > INSIDE for each in points_m[within])

    def winding_number(self, point_m: Vector) -> float:
        """Return how often the surface winds around a point, shape (3,) [m]."""
        half_m = 0.5 * (self._upper_m - self._lower_m)
        far = np.linalg.norm(self._lower_m + half_m - point_m, axis=1) > FAR * np.linalg.norm(half_m, axis=1)
        middles_m, areas_m2 = self._dipoles
        away_m = middles_m[far] - point_m
        of_far = (areas_m2[far] * away_m).sum(axis=1) / np.linalg.norm(away_m, axis=1) ** 3
        near = np.repeat(~far, TRIANGLES_A_PIECE)[: len(self._triangles)]
        of_near = solid_angles(self._vertices_m[self._triangles[near]] - point_m)
        return float(of_far.sum() + of_near.sum()) / (4.0 * np.pi)

    @cached_property
    def _dipoles(self) -> tuple[Vector, Vector]:
        """Middle [m] and area vector [m2] of each piece, shape (pieces, 3) each."""
        a, b, c = np.moveaxis(self._vertices_m[self._triangles], 1, 0)
        areas_m2 = 0.5 * np.cross(b - a, c - a)
        weights = np.linalg.norm(areas_m2, axis=1, keepdims=True) + NO_AREA_M2
        starts = np.arange(0, len(self._triangles), TRIANGLES_A_PIECE)
        middles_m = np.add.reduceat(weights * (a + b + c) / 3.0, starts) / np.add.reduceat(weights, starts)
        return middles_m, np.add.reduceat(areas_m2, starts)


def load_surfaces(surfaces: Mapping[str, LinkSurface], model: pin.Model) -> Iterator[tuple[str, TriangleSurface]]:
    """Yield each link with its surface, in the frame of the joint that carries it; ShapeError: the file is unfit."""
    for link, surface in surfaces.items():
        try:
            with surface_file(surface.path) as arrays:
                vertices, triangles = arrays[f"{surface.link}.vertices"], arrays[f"{surface.link}.triangles"]
        except DescriptionError as error:
            raise ShapeError(link, f"the surface {error}") from error
        if not all(each.dtype.kind == "i" and each.shape[1:] == (3,) and each.size for each in (vertices, triangles)):
            raise ShapeError(link, f"{surface.path} must have vertices and triangles: integers of shape (n, 3)")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise ShapeError(link, f"{surface.path} has triangles without vertices")
        place = model.frames[frame_of_link(model, link)].placement
        yield link, TriangleSurface(UNIT_M * vertices @ place.rotation.T + place.translation, triangles)


def of_meshes(meshes: Sequence[PlacedMesh]) -> TriangleSurface:
    """Return the surface of meshes."""
    vertices_m, triangles = joined(meshes)
    # STL files repeat a vertex for each triangle, which would make each a body.
    once_m, same = np.unique(vertices_m, axis=0, return_inverse=True)
    return of_triangles(once_m, same.ravel()[triangles])


def of_triangles(vertices_m: Vector, triangles: NDArray[np.int64]) -> TriangleSurface:
    """Return the surface of triangles in any order."""
    order = np.argsort(_along_a_curve(vertices_m[triangles].mean(axis=1)), kind="stable")
    return TriangleSurface(vertices_m, triangles[order].astype(np.int32))


def joined(meshes: Sequence[PlacedMesh]) -> tuple[Vector, NDArray[np.int64]]:
    """Return the vertices of meshes, shape (n, 3) [m], and their triangles as indices into these, shape (m, 3)."""
    vertices_m, triangles, count = [], [], 0
    for mesh, place in meshes:
        vertices_m.append(np.asarray(mesh.vertices()) @ place.rotation.T + place.translation)
        numbers = (mesh.tri_indices(i) for i in range(mesh.num_tris))
        triangles.append(np.array([(each[0], each[1], each[2]) for each in numbers]).reshape(-1, 3) + count)
        count += len(vertices_m[-1])
    return np.vstack(vertices_m), np.vstack(triangles)


def solid_angles(corners_m: Vector) -> Vector:
    """Return the solid angles of triangles, shape (..., 3, 3) [m], seen from the origin, positive from behind [sr].

    Formula of van Oosterom and Strackee, "The solid angle of a plane triangle", 1983.
    """
    # numpy is slow with a last axis of three.
    a, b, c = np.ascontiguousarray(np.moveaxis(corners_m, (-2, -1), (0, 1)))
    a_m, b_m, c_m = (np.sqrt((corner**2).sum(axis=0)) for corner in (a, b, c))
    volume = (
        a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    beside = a_m * b_m * c_m + (a * b).sum(axis=0) * c_m + (b * c).sum(axis=0) * a_m + (c * a).sum(axis=0) * b_m
    return np.asarray(2.0 * np.arctan2(volume, beside))


def packed(vertices_m: Vector, triangles: NDArray[np.int64]) -> tuple[NDArray[np.int16], Triangles]:
    """Return a surface within 0.32 m as files have it: in :data:`UNIT_M`, each triangle once, next to neighbours."""
    vertices, numbers = np.unique(np.rint(vertices_m / UNIT_M).astype(np.int16), axis=0, return_inverse=True)
    found = numbers.ravel()[triangles].astype(np.int32)
    a, b, c = found.T
    found = found[(a != b) & (b != c) & (c != a)]
    found = found[np.unique(np.sort(found, axis=1), axis=0, return_index=True)[1]]
    found = found[np.argsort(_along_a_curve(vertices[found].mean(axis=1)), kind="stable")]
    # Vertices in the order of their use make a smaller file.
    used, first = np.unique(found, return_index=True)
    order = used[np.argsort(first)]
    position = np.empty(len(vertices), dtype=np.int32)
    position[order] = np.arange(len(order), dtype=np.int32)
    return vertices[order], position[found]


def _along_a_curve(points: Vector) -> NDArray[np.uint64]:
    """Numbers of points along a curve on which neighbours in space are mostly near, by turns a bit of each axis."""
    lower, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
    cells = ((points - lower) / max(size, 1e-12) * ((1 << ORDER_BITS) - 1)).astype(np.uint64)
    numbers = np.zeros(len(points), dtype=np.uint64)
    for bit in range(ORDER_BITS):
        for axis in range(3):
            numbers |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return numbers

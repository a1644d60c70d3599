"""Surfaces of links to the last triangle, from a file.

A search tree over all triangles of an SO-101 takes 150 MB and a second, where a contact concerns a few centimetres of
them. So triangles lie in pieces, neighbours together, of which the boxes are known: the tree of a piece is made when
something first comes into its box, and kept while it is of use.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.errors import ShapeError
from planners.geometry.shapes import frame_of_link, triangle_tree
from robot.description.model import LinkSurface
from robot.trajectory import Vector

# Coordinates in files are multiples of this [m].
UNIT_M = 1e-5

# A surface is where the file has it within half the diagonal of that grid's cells [m].
ACCURACY_M = 0.5 * math.sqrt(3.0) * UNIT_M

# A tree of so many takes 0.2 ms to make and 65 kB; of the boxes around larger pieces too much is empty.
TRIANGLES_A_PIECE = 128

# So many trees of a link are kept: of what is near a few obstacles.
TREES_KEPT = 128

# Bits by which each coordinate of a triangle's middle counts in the order of triangles.
ORDER_BITS = 10

Triangles = NDArray[np.int32]


class Pieces(Sequence[coal.CollisionGeometry]):
    """The trees of the pieces of a surface, in the frame of a joint.

    Args:
        vertices_m: shape (n, 3) [m].
        triangles: shape (m, 3), indices into ``vertices_m``, neighbours mostly next to each other.

    Attributes:
        lower_m: shape (pieces, 3), lower corners of the boxes around the pieces [m].
        upper_m: shape (pieces, 3), upper corners [m].
    """

    def __init__(self, vertices_m: Vector, triangles: Triangles) -> None:
        self._vertices_m, self._triangles = vertices_m, triangles
        starts = np.arange(0, len(triangles), TRIANGLES_A_PIECE)
        corners_m = vertices_m[triangles]
        self.lower_m: Vector = np.minimum.reduceat(corners_m.min(axis=1), starts)
        self.upper_m: Vector = np.maximum.reduceat(corners_m.max(axis=1), starts)
        self._tree = lru_cache(TREES_KEPT)(self._make)

    def __len__(self) -> int:
        return len(self.lower_m)

    def __getitem__(self, index: int) -> coal.CollisionGeometry:  # type: ignore[override]
        if not 0 <= index < len(self):
            raise IndexError(f"there are {len(self)} pieces, there is no piece {index}")
        return self._tree(index)

    def _make(self, index: int) -> coal.BVHModelOBBRSS:
        first = TRIANGLES_A_PIECE * index
        used, again = np.unique(self._triangles[first : first + TRIANGLES_A_PIECE], return_inverse=True)
        return triangle_tree(self._vertices_m[used], again.reshape(-1, 3))


def load(surfaces: Mapping[str, LinkSurface], model: pin.Model) -> Iterator[tuple[str, Pieces]]:
    """Yield each link with its surface, in the frame of the joint that carries the link.

    Args:
        surfaces: where the surface of each link is.
        model: the robot's joints.

    Raises:
        ShapeError: a file cannot be read, or is not one of surfaces.
    """
    for link, surface in surfaces.items():
        try:
            with np.load(surface.path, allow_pickle=False) as file:
                vertices, triangles = file[f"{surface.link}.vertices"], file[f"{surface.link}.triangles"]
        except (OSError, ValueError, KeyError) as error:
            raise ShapeError(link, f"the surface cannot be read from {surface.path}: {error}") from error
        if vertices.shape[1:] != (3,) or triangles.shape[1:] != (3,) or not len(triangles):
            raise ShapeError(link, f"{surface.path} must have vertices and triangles of shape (n, 3)")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise ShapeError(link, f"{surface.path} has triangles without vertices")
        frame = model.frames[frame_of_link(model, link)]
        vertices_m = UNIT_M * vertices @ frame.placement.rotation.T + frame.placement.translation
        yield link, Pieces(vertices_m, triangles)


def packed(vertices_m: Vector, triangles: Triangles) -> tuple[NDArray[np.int16], Triangles]:
    """Return a surface as files have it: on the grid, each triangle once, neighbours next to each other.

    Args:
        vertices_m: shape (n, 3), each coordinate within 0.32 m [m].
        triangles: shape (m, 3), indices into ``vertices_m``.

    Returns:
        Vertices in units of :data:`UNIT_M`, and triangles.
    """
    vertices, numbers = np.unique(np.rint(vertices_m / UNIT_M).astype(np.int16), axis=0, return_inverse=True)
    found = numbers.ravel()[triangles].astype(np.int32)
    a, b, c = found.T
    found = found[(a != b) & (b != c) & (c != a)]
    _, once = np.unique(np.sort(found, axis=1), axis=0, return_index=True)
    found = found[once]
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

"""Convex shapes for coal: of given points, and with few corners around many points."""

from __future__ import annotations

import coal
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

# A check's time grows with the corners: hulls of the SO-101's meshes have thousands and take five times as long.
MAX_CORNERS = 250

# A hull around faces in 126 directions has at most 248 corners and is 1 to 2 mm wider than links of 10 cm.
DIRECTIONS = 126

# Points whose least extent is below this share of their greatest are flat.
FLAT = 1e-6

# Half the thickness of a plate around flat points: nothing to an arm, and enough for coal [m].
PLATE_M = 1e-4

# Faces closer together than this share of the hull's size are one: corners between them are not to be had.
SAME_CORNER = 1e-7


def convex(points: Vector) -> coal.Convex:
    """The hull of points; of flat ones, a plate that encloses them.

    Args:
        points: shape (n, 3), n >= 1, finite [m].
    """
    # Asked for the hull of flat points, coal ends the process.
    if _thickness(points) < FLAT:
        points = (points[:, np.newaxis] + PLATE_M * np.vstack((np.eye(3), -np.eye(3)))).reshape(-1, 3)
    vertices = coal.StdVec_Vec3s()
    vertices.extend(list(points))
    return coal.Convex.convexHull(vertices, True, "Qt")


def enclosing(points: Vector) -> coal.Convex:
    """A hull that encloses points and has few corners: their own where those are few.

    Args:
        points: shape (n, 3), n >= 1, finite [m].
    """
    try:
        hull = convex(points)
    except RuntimeError:
        # One corner has more neighbours than coal counts, as the tip of a fine cone.
        corners = points
    else:
        corners = np.asarray(hull.points())
        if len(corners) <= MAX_CORNERS:
            return hull
    # Evenly spread directions suit a body as long as it is wide, so it is seen in its own proportions. Corners of the
    # solid {x : d . x <= h} are, from a point in it, the faces of the hull of d / h.
    middle, size = corners.mean(axis=0), np.ptp(corners, axis=0)
    directions = _directions(DIRECTIONS)
    heights = ((corners - middle) / size @ directions.T).max(axis=0)
    dual = convex(directions / heights[:, np.newaxis])
    triangles = np.asarray(dual.points())[_triangles(dual)]
    regular = np.abs(np.linalg.det(triangles * heights.mean())) > SAME_CORNER
    solid = np.linalg.solve(triangles[regular], np.ones((regular.sum(), 3, 1)))[:, :, 0]
    return convex(solid * size + middle)


def _thickness(points: Vector) -> float:
    """Least extent of points as a share of their greatest, along their principal axes."""
    centred = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    extents = np.ptp(centred @ axes, axis=0)
    return float(extents.min() / extents.max()) if extents.max() > 0.0 else 0.0


def _triangles(hull: coal.Convex) -> NDArray[np.int64]:
    polygons = (hull.polygons(i) for i in range(hull.num_polygons))
    return np.array([(polygon[0], polygon[1], polygon[2]) for polygon in polygons])


def _directions(count: int) -> Vector:
    """Unit vectors spread evenly, the six along the axes first; those of a Fibonacci lattice otherwise."""
    i = np.arange(count - 6) + 0.5
    z = 1.0 - 2.0 * i / (count - 6)
    angle = np.pi * (1.0 + np.sqrt(5.0)) * i
    ring = np.sqrt(1.0 - z**2)
    lattice = np.stack((ring * np.cos(angle), ring * np.sin(angle), z), axis=1)
    return np.vstack((np.eye(3), -np.eye(3), lattice))

"""Triangle surfaces and convex parts of links, and how far parts are from the surface that they stand for.

The deviation is measured by samples in both directions: points of the surface that no part covers, and points of the
parts that stand out of the surface. A point is inside a surface where its winding number is above one half, which small
holes in a mesh hardly change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError, cKDTree

from planners.geometry.surfaces import INSIDE, of_triangles
from robot.trajectory import Vector

# Vertices of STL files nearer than this share of the mesh's size are one: the format repeats a vertex a triangle.
SAME_VERTEX = 1e-6

# Points whose least extent is below this are flat: qhull takes them with a plate of this thickness around them [m].
PLATE_M = 1e-4

TOUCH_M = 1e-4  # points nearer than this to another part are not on the outside of the union [m]

# Points on a surface of 200 cm2 are then 0.3 mm apart, which makes a distance of 3 mm at most 0.02 mm too long.
REFERENCE_POINTS = 200_000

TEST_POINTS = 4_000  # points on the parts and on the surface at which the deviation is measured


@dataclass(frozen=True)
class Surface:
    """Triangles of a mesh."""

    vertices_m: Vector  # shape (n, 3) [m]
    triangles: NDArray[np.int64]  # shape (m, 3), indices into `vertices_m`

    @property
    def corners_m(self) -> Vector:
        """Return the corners of each triangle, shape (m, 3, 3) [m]."""
        return self.vertices_m[self.triangles]

    @property
    def area_m2(self) -> float:
        """Area of all triangles [m2]."""
        corners_m = self.corners_m
        across = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
        return float(0.5 * np.linalg.norm(across, axis=1).sum())


@dataclass(frozen=True)
class Deviation:
    """Greatest distances between a surface and the union of its parts."""

    outside_m: float = 0.0  # how far the parts stand out of the surface [m]
    uncovered_m: float = 0.0  # how far points of the surface are outside of every part [m]

    @property
    def greatest_m(self) -> float:
        """The larger of the two."""
        return max(self.outside_m, self.uncovered_m)


class ConvexPart:
    """Hull of points, shape (n, 3), n >= 1 [m]; of flat points, a thin plate around them.

    It has the corners ``vertices_m``, shape (k, 3) [m], and the ``planes`` of its faces, shape (f, 4): unit normal
    outwards and offset; a point p is inside where normal . p + offset <= 0.
    """

    def __init__(self, points_m: Vector) -> None:
        try:
            hull = ConvexHull(points_m)
        except (QhullError, ValueError):
            around = np.vstack((np.eye(3), -np.eye(3))) * PLATE_M
            hull = ConvexHull((points_m[:, np.newaxis] + around).reshape(-1, 3))
        index = np.full(len(hull.points), -1)
        index[hull.vertices] = np.arange(len(hull.vertices))
        self.vertices_m: Vector = hull.points[hull.vertices]
        self.planes: Vector = np.unique(hull.equations, axis=0)
        self.surface = Surface(self.vertices_m, index[hull.simplices])

    def depth_m(self, points_m: Vector) -> Vector:
        """Return the greatest signed distance to a face's plane, shape (n,), negative inside [m]."""
        return np.asarray(np.max(points_m @ self.planes[:, :3].T + self.planes[:, 3], axis=1))

    def within(self, directions: Vector) -> ConvexPart:
        """Return the part between planes across unit vectors, shape (d, 3): larger, with fewer corners."""
        middle = self.vertices_m.mean(axis=0)
        size = np.maximum(np.ptp(self.vertices_m, axis=0), PLATE_M)
        # Evenly spread directions suit a body as wide as long, so the body is seen in its own proportions.
        seen = (self.vertices_m - middle) / size
        heights = (seen @ directions.T).max(axis=0)
        solid = HalfspaceIntersection(np.column_stack((directions, -heights)), np.zeros(3))
        return ConvexPart(solid.intersections * size + middle)


def merged(vertices_m: Vector, triangles: NDArray[np.int64]) -> Surface:
    """Return a surface whose triangles share their vertices, without triangles that have no area."""
    size_m = float(np.ptp(vertices_m, axis=0).max())
    cells = np.round((vertices_m - vertices_m.min(axis=0)) / max(size_m * SAME_VERTEX, 1e-12)).astype(np.int64)
    _, first, inverse = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    joined = inverse.reshape(-1)[triangles]
    kept = (joined[:, 0] != joined[:, 1]) & (joined[:, 1] != joined[:, 2]) & (joined[:, 2] != joined[:, 0])
    return Surface(vertices_m[first], joined[kept])


def components(surface: Surface) -> list[Surface]:
    """Return the connected pieces of a surface, those with most triangles first."""
    a, b, c = surface.triangles.T
    count = len(surface.vertices_m)
    links = coo_array((np.ones(2 * len(a)), (np.concatenate((a, b)), np.concatenate((b, c)))), shape=(count, count))
    pieces, label = connected_components(links, directed=False)
    of_triangle = label[a]
    found = []
    for piece in np.argsort(-np.bincount(of_triangle, minlength=pieces), kind="stable"):
        triangles = surface.triangles[of_triangle == piece]
        if len(triangles):
            used, indices = np.unique(triangles, return_inverse=True)
            found.append(Surface(surface.vertices_m[used], indices.reshape(-1, 3)))
    return found


def sample(surface: Surface, count: int, random: np.random.Generator) -> Vector:
    """Return points drawn uniformly from a surface, shape (count, 3) [m]."""
    return sample_with_normals(surface, count, random)[0]


def sample_with_normals(surface: Surface, count: int, random: np.random.Generator) -> tuple[Vector, Vector]:
    """Return points drawn uniformly from a surface [m] and the unit normals there, shape (count, 3) each."""
    corners_m = surface.corners_m
    across = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    areas = np.linalg.norm(across, axis=1)
    total = areas.sum()
    drawn = random.choice(len(areas), count, p=areas / total if total > 0.0 else None)
    chosen = corners_m[drawn]
    # Uniform in a triangle: Osada et al. 2002, Shape distributions, eq. 1.
    root, along = np.sqrt(random.random((count, 1))), random.random((count, 1))
    points: Vector = (1.0 - root) * chosen[:, 0] + root * (1.0 - along) * chosen[:, 1] + root * along * chosen[:, 2]
    return points, across[drawn] / np.maximum(areas[drawn], 1e-30)[:, np.newaxis]


def measure(surface: Surface, parts: Sequence[ConvexPart], random: np.random.Generator) -> Deviation:
    """Measure how far parts are from :data:`TEST_POINTS` samples of a surface: rather too far than too near."""
    on_surface = sample(surface, TEST_POINTS, random)
    uncovered_m = np.min([part.depth_m(on_surface) for part in parts], axis=0).max()
    outer_m = _outer_points(parts, random)
    outside_m = 0.0
    if len(outer_m):
        distances_m, _ = cKDTree(sample(surface, REFERENCE_POINTS, random)).query(outer_m)
        winding_number = of_triangles(surface.vertices_m, surface.triangles).winding_number
        farthest = (i for i in np.argsort(-distances_m) if abs(winding_number(outer_m[i])) < INSIDE)
        outside_m = next((float(distances_m[i]) for i in farthest), 0.0)
    return Deviation(outside_m, max(0.0, float(uncovered_m)))


def _outer_points(parts: Sequence[ConvexPart], random: np.random.Generator) -> Vector:
    """Return points of the parts' surfaces that no other part contains or touches, shape (n, 3) [m]."""
    areas = np.array([np.linalg.norm(np.ptp(part.vertices_m, axis=0)) ** 2 for part in parts])
    counts = np.maximum(8, TEST_POINTS * areas / areas.sum()).astype(int)
    points_m = np.vstack([sample(part.surface, count, random) for part, count in zip(parts, counts, strict=True)])
    owner = np.repeat(np.arange(len(parts)), counts)
    outer = np.ones(len(points_m), dtype=bool)
    for index, part in enumerate(parts):
        outer &= (owner == index) | (part.depth_m(points_m) > TOUCH_M)
    return np.asarray(points_m[outer])

"""The part of coal 3 that is used."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

class Triangle:
    def __init__(self, a: int, b: int, c: int) -> None: ...

class StdVec_Vec3s:
    def __init__(self) -> None: ...
    def append(self, point: ArrayLike) -> None: ...

class StdVec_Triangle:
    def __init__(self) -> None: ...
    def append(self, triangle: Triangle) -> None: ...

class AABB:
    min_: NDArray[np.float64]
    max_: NDArray[np.float64]

class CollisionGeometry:
    aabb_local: AABB
    def computeLocalAABB(self) -> None: ...

class Convex(CollisionGeometry):
    def __init__(self, points: StdVec_Vec3s, triangles: StdVec_Triangle) -> None: ...
    def points(self) -> NDArray[np.float64]: ...

class BVHModelBase(CollisionGeometry):
    convex: Convex
    def buildConvexHull(self, keep_triangles: bool, qhull_command: str) -> None: ...

class CollisionRequest:
    gjk_tolerance: float

class DistanceResult:
    min_distance: float

"""The part of coal 3 that is used."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Vector = NDArray[np.float64]

class Triangle:
    def __init__(self, a: int, b: int, c: int) -> None: ...
    def __getitem__(self, corner: int) -> int: ...

class StdVec_Vec3s:
    def __init__(self) -> None: ...
    def append(self, point: ArrayLike) -> None: ...
    def extend(self, points: Iterable[ArrayLike]) -> None: ...

class AABB:
    min_: _Vector
    max_: _Vector

class CollisionGeometry:
    aabb_local: AABB
    aabb_center: _Vector
    aabb_radius: float
    def computeLocalAABB(self) -> None: ...

class Box(CollisionGeometry):
    def __init__(self, x: float, y: float, z: float) -> None: ...

class Sphere(CollisionGeometry):
    def __init__(self, radius: float) -> None: ...

class Cylinder(CollisionGeometry):
    def __init__(self, radius: float, height: float) -> None: ...

class Cone(CollisionGeometry):
    def __init__(self, radius: float, height: float) -> None: ...

class Convex(CollisionGeometry):
    num_polygons: int
    @staticmethod
    def convexHull(points: StdVec_Vec3s, keep_triangles: bool, qhull_command: str) -> Convex: ...
    def points(self) -> _Vector: ...
    def polygons(self, index: int) -> Triangle: ...
    def computeVolume(self) -> float: ...

class BVHModelBase(CollisionGeometry):
    def beginModel(self, triangles: int, vertices: int) -> int: ...
    def addVertices(self, vertices: _Vector) -> int: ...
    def addTriangles(self, triangles: NDArray[np.int64]) -> int: ...
    def endModel(self) -> int: ...
    def vertices(self) -> _Vector: ...

class BVHModelOBBRSS(BVHModelBase):
    def __init__(self) -> None: ...

class Transform3s:
    def __init__(self, rotation: _Vector, translation: _Vector) -> None: ...

class QueryRequest:
    gjk_tolerance: float

class CollisionRequest(QueryRequest):
    security_margin: float
    def __init__(self) -> None: ...

class CollisionResult:
    def __init__(self) -> None: ...

class DistanceRequest(QueryRequest):
    def __init__(self) -> None: ...

class DistanceResult:
    min_distance: float
    def __init__(self) -> None: ...

def collide(
    first: CollisionGeometry,
    at_first: Transform3s,
    second: CollisionGeometry,
    at_second: Transform3s,
    request: CollisionRequest,
    result: CollisionResult,
) -> int: ...
def distance(
    first: CollisionGeometry,
    at_first: Transform3s,
    second: CollisionGeometry,
    at_second: Transform3s,
    request: DistanceRequest,
    result: DistanceResult,
) -> float: ...

import numpy as np
from numpy.typing import NDArray

class QhullError(RuntimeError): ...

class ConvexHull:
    points: NDArray[np.float64]
    vertices: NDArray[np.int32]
    simplices: NDArray[np.int32]
    equations: NDArray[np.float64]
    volume: float
    def __init__(self, points: NDArray[np.float64]) -> None: ...

class HalfspaceIntersection:
    intersections: NDArray[np.float64]
    def __init__(self, halfspaces: NDArray[np.float64], interior_point: NDArray[np.float64]) -> None: ...

class cKDTree:
    def __init__(self, data: NDArray[np.float64]) -> None: ...
    def query(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]: ...

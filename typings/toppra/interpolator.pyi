"""The part of toppra.interpolator 0.6 that is used."""

import numpy as np
from numpy.typing import NDArray

class AbstractGeometricPath:
    def __call__(self, path_positions: float | NDArray[np.float64], order: int = 0) -> NDArray[np.float64]: ...
    @property
    def dof(self) -> int: ...
    @property
    def path_interval(self) -> NDArray[np.float64]: ...

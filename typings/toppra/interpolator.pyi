"""The part of toppra.interpolator 0.6 that is used."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

# A class to inherit from in the library, which asks no more of its paths than these.
class AbstractGeometricPath(Protocol):
    def __call__(self, path_positions: NDArray[np.float64], order: int = 0) -> NDArray[np.float64]: ...
    @property
    def dof(self) -> int: ...
    @property
    def path_interval(self) -> NDArray[np.float64]: ...

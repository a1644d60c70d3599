from typing import Literal

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

class CubicSpline:
    def __init__(self, x: Vector, y: Vector, *, bc_type: Literal["natural"]) -> None: ...
    def __call__(self, x: Vector, nu: int = 0) -> Vector: ...

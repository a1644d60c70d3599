"""The part of toppra.algorithm 0.6 that is used."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from toppra.constraint import LinearConstraint
from toppra.interpolator import AbstractGeometricPath

_Vector = NDArray[np.float64]

class TOPPRA:
    def __init__(
        self,
        constraint_list: Sequence[LinearConstraint],
        path: AbstractGeometricPath,
        *,
        gridpoints: _Vector,
        solver_wrapper: str,
    ) -> None: ...
    def compute_parameterization(
        self, sd_start: float, sd_end: float
    ) -> tuple[_Vector | None, _Vector | None, _Vector | None]: ...

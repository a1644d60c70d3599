"""The part of toppra.constraint 0.6 that is used."""

from collections.abc import Callable
from enum import Enum

import numpy as np
from numpy.typing import NDArray

class DiscretizationType(Enum):
    Collocation = 0
    Interpolation = 1

class LinearConstraint: ...

class JointVelocityConstraintVarying(LinearConstraint):
    def __init__(self, vlim_func: Callable[[float], NDArray[np.float64]]) -> None: ...

class JointAccelerationConstraint(LinearConstraint):
    def __init__(self, alim: NDArray[np.float64], discretization_scheme: DiscretizationType) -> None: ...

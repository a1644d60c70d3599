"""How fast joints may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class RateLimits:
    """The most that each joint may do, shape (n,) each.

    Attributes:
        velocity_rad_s: above 0 [rad/s].
        acceleration_rad_s2: above 0 [rad/s^2].
        jerk_rad_s3: above 0, infinite for joints without such a limit; None when no joint has one [rad/s^3].
    """

    velocity_rad_s: Vector
    acceleration_rad_s2: Vector
    jerk_rad_s3: Vector | None = None

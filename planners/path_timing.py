"""Timing of a given smooth path by TOPP-RA: least time within velocity and acceleration limits.

Pham & Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis", 2018.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint

from planners.blending import BlendedPath
from planners.profile import Profile, RateLimits

Vector = NDArray[np.float64]

# TOPP-RA's time grows with the grid, and the limits between its points are kept better: 100 points take 2 ms.
GRID_STEPS_PER_BLEND = 10
GRID_STEPS_ON_LINES = 60


def toppra_profile(path: BlendedPath, limits: RateLimits) -> Profile | None:
    """The fastest progress along a path from rest to rest, or None when TOPP-RA finds none."""
    velocity, acceleration = limits.velocity_rad_s, limits.acceleration_rad_s2
    constraints = [
        JointVelocityConstraint(np.column_stack((-velocity, velocity))),
        # The default scheme exceeds the limit up to 2.4 times between grid points.
        JointAccelerationConstraint(
            np.column_stack((-acceleration, acceleration)),
            discretization_scheme=DiscretizationType.Interpolation,
        ),
    ]
    grid = _grid(path)
    solver = TOPPRA(constraints, path, gridpoints=grid, solver_wrapper="seidel")
    _, rate, _ = solver.compute_parameterization(0.0, 0.0)
    if rate is None or not np.all(np.isfinite(rate)) or np.any(rate[1:-1] <= 0.0):
        return None
    return Profile(grid, np.concatenate(([0.0], rate[1:-1], [0.0])))


def _grid(path: BlendedPath) -> Vector:
    step = (path.knots[-1] - path.knots[0]) / GRID_STEPS_ON_LINES
    pieces = [path.knots[:1]]
    for start, end, blend in zip(path.knots[:-1], path.knots[1:], path.in_blend, strict=True):
        # A line has at least two steps, so that the arm may speed up and slow down on it.
        count = GRID_STEPS_PER_BLEND if blend else max(2, int(np.ceil((end - start) / step)))
        pieces.append(np.linspace(start, end, count + 1)[1:])
    return np.concatenate(pieces)

"""A smooth curve through given points: the natural cubic spline.

scipy is imported by the first spline: it takes half a second and 50 MB, which only paths of the tip need and which a
worker may not take at its start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

# On a curve of few points the progress still has to rise and fall within this many steps.
LEAST_GRID_STEPS = 20

# The limits between grid points are kept to a few per mille with this many between two points of the curve.
GRID_STEPS_PER_SPAN = 2


class SplinePath:
    """The natural cubic spline through points.

    Args:
        knots: shape (m,), m >= 2, strictly increasing parameters.
        points: shape (m, n), finite, where the curve is there [rad].
    """

    def __init__(self, knots: Vector, points: Vector) -> None:
        from scipy.interpolate import CubicSpline

        self.knots = knots
        self.points = points
        self._curve = CubicSpline(knots, points, bc_type="natural")

    @property
    def grid(self) -> Vector:
        """Parameters for timing: the second derivative is linear between them."""
        spans = len(self.knots) - 1
        steps = max(GRID_STEPS_PER_SPAN, -(-LEAST_GRID_STEPS // spans))
        at = np.arange(spans * steps + 1) / steps
        return np.interp(at, np.arange(spans + 1), self.knots)

    def __call__(self, path_positions: Vector, order: int = 0) -> Vector:
        """Position, first or second derivative at parameters, shape (k, n)."""
        return self._curve(path_positions, order)

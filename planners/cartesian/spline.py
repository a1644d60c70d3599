"""A smooth curve through given points: the natural cubic spline."""

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
        points: shape (m, n), where the curve is there [rad].
    """

    def __init__(self, knots: Vector, points: Vector) -> None:
        self.knots = knots
        self._points = points
        self._bends = _second_derivatives(knots, points)

    @property
    def grid(self) -> Vector:
        """Parameters for timing: the second derivative is linear between them."""
        spans = len(self.knots) - 1
        steps = max(GRID_STEPS_PER_SPAN, -(-LEAST_GRID_STEPS // spans))
        at = np.arange(spans * steps + 1) / steps
        return np.interp(at, np.arange(spans + 1), self.knots)

    def __call__(self, path_positions: Vector, order: int = 0) -> Vector:
        """Position, first or second derivative at parameters, shape (k, n)."""
        i = np.clip(np.searchsorted(self.knots, path_positions, side="right") - 1, 0, len(self.knots) - 2)
        span = (self.knots[i + 1] - self.knots[i])[:, np.newaxis]
        u = (path_positions - self.knots[i])[:, np.newaxis] / span
        p0, p1, m0, m1 = self._points[i], self._points[i + 1], self._bends[i], self._bends[i + 1]
        if order == 0:
            bend = ((1.0 - u) ** 3 - (1.0 - u)) * m0 + (u**3 - u) * m1
            return np.asarray((1.0 - u) * p0 + u * p1 + span**2 / 6.0 * bend)
        if order == 1:
            bend = (1.0 - 3.0 * (1.0 - u) ** 2) * m0 + (3.0 * u**2 - 1.0) * m1
            return np.asarray((p1 - p0) / span + span / 6.0 * bend)
        return np.asarray((1.0 - u) * m0 + u * m1)


def _second_derivatives(knots: Vector, points: Vector) -> Vector:
    """At each knot, shape (m, n): those for which the first derivative is continuous, 0 at both ends."""
    spans = np.diff(knots)
    slopes = np.diff(points, axis=0) / spans[:, np.newaxis]
    right = 6.0 * np.diff(slopes, axis=0)
    diagonal = 2.0 * (spans[:-1] + spans[1:])
    bends = np.zeros_like(points)
    # Gauss elimination of a matrix with three diagonals: its work is proportional to the points.
    for i in range(1, len(right)):
        share = spans[i] / diagonal[i - 1]
        diagonal[i] -= share * spans[i]
        right[i] -= share * right[i - 1]
    for i in range(len(right) - 1, -1, -1):
        bends[i + 1] = (right[i] - spans[i + 1] * bends[i + 2]) / diagonal[i]
    return bends

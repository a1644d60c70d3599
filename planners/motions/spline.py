"""Natural cubic spline: a curve through points with a continuous second derivative, which is 0 at its ends.

scipy has one, whose import takes half a second in every planner process.
"""

from __future__ import annotations

import numpy as np

from robot.trajectory import Vector


class NaturalSpline:
    """Natural cubic spline through points.

    Args:
        knots: shape (m,), m >= 2, strictly increasing parameters.
        points: shape (m, n), places of the curve there.

    Raises:
        ValueError: numbers that are not finite.
    """

    def __init__(self, knots: Vector, points: Vector) -> None:
        if not (np.all(np.isfinite(knots)) and np.all(np.isfinite(points))):
            raise ValueError("a spline needs finite numbers")
        self._knots, spans = knots, np.diff(knots)[:, np.newaxis]
        slopes = np.diff(points, axis=0) / spans
        bends = np.zeros_like(points, dtype=np.float64)
        if len(knots) > 2:
            # De Boor, A Practical Guide to Splines, chapter IV: second derivatives from the continuity of the first.
            lower, upper = spans[:-1, 0].copy(), spans[1:, 0].copy()
            middle = 2.0 * (lower + upper)
            lower[0] = upper[-1] = 0.0
            bends[1:-1] = solve_tridiagonal(lower, middle, upper, 6.0 * np.diff(slopes, axis=0))
        # Of each span, from its start: position, and first to third derivative over 1, 1, 2 and 6.
        self._position, self._bend = points[:-1], 0.5 * bends[:-1]
        self._slope = slopes - spans * (2.0 * bends[:-1] + bends[1:]) / 6.0
        self._twist = np.diff(bends, axis=0) / (6.0 * spans)

    def __call__(self, parameters: Vector, order: int = 0) -> Vector:
        """Return position, first or second derivative at parameters, shape (k, n); beyond the ends, of the end span."""
        parameters = np.asarray(parameters, dtype=np.float64)
        span = np.clip(np.searchsorted(self._knots, parameters, side="right") - 1, 0, len(self._knots) - 2)
        along = (parameters - self._knots[span])[..., np.newaxis]
        bend, twist = self._bend[span], self._twist[span]
        result: Vector
        if order == 2:
            result = 2.0 * bend + 6.0 * along * twist
        elif order == 1:
            result = self._slope[span] + along * (2.0 * bend + 3.0 * along * twist)
        else:
            result = self._position[span] + along * (self._slope[span] + along * (bend + along * twist))
        return result


def solve_tridiagonal(lower: Vector, middle: Vector, upper: Vector, right: Vector) -> Vector:
    """Solve a tridiagonal system with a dominant diagonal by parallel cyclic reduction, all rows at once.

    Hockney & Jesshope, Parallel Computers, 1981: each step doubles the distance of the unknowns that a row has.

    Args:
        lower: shape (m,), left of the diagonal; the first is 0.
        middle: shape (m,), the diagonal.
        upper: shape (m,), right of the diagonal; the last is 0.
        right: shape (m, n), right-hand sides.

    Returns:
        Shape (m, n).
    """
    apart, count = 1, len(middle)
    while apart < count:
        before, after = np.zeros(count), np.zeros(count)
        before[apart:] = -lower[apart:] / middle[:-apart]
        after[:-apart] = -upper[:-apart] / middle[apart:]
        further_middle, further_right = middle.copy(), right.copy()
        further_lower, further_upper = np.zeros(count), np.zeros(count)
        further_middle[apart:] += before[apart:] * upper[:-apart]
        further_middle[:-apart] += after[:-apart] * lower[apart:]
        further_right[apart:] += before[apart:, np.newaxis] * right[:-apart]
        further_right[:-apart] += after[:-apart, np.newaxis] * right[apart:]
        further_lower[apart:] = before[apart:] * lower[:-apart]
        further_upper[:-apart] = after[:-apart] * upper[apart:]
        lower, middle, upper, right = further_lower, further_middle, further_upper, further_right
        apart *= 2
    solution: Vector = right / middle[:, np.newaxis]
    return solution

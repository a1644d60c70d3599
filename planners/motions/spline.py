"""Natural cubic spline through points; scipy's would take half a second to import in every planner process."""

from __future__ import annotations

import numpy as np

from robot.trajectory import Vector

HALVINGS = 44  # they leave 6e-14 of the first error: about rounding

# On a curve of few points the progress along it still has to rise and fall within this many steps.
LEAST_GRID_STEPS = 20

# Limits are kept to a few per mille between the points of a grid with this many between two points of the curve.
GRID_STEPS_PER_SPAN = 2


class NaturalSpline:
    """Natural cubic spline through finite ``points``, (m, n), m >= 2, at increasing ``knots``, (m,)."""

    def __init__(self, knots: Vector, points: Vector) -> None:
        if not (np.all(np.isfinite(knots)) and np.all(np.isfinite(points))):
            raise ValueError("a spline needs finite numbers")
        self.knots, self.points, spans = knots, points, np.diff(knots)[:, np.newaxis]
        slopes = np.diff(points, axis=0) / spans
        bends = np.zeros_like(points, dtype=np.float64)
        # De Boor, A Practical Guide to Splines, chapter IV: second derivatives from the continuity of the first, by
        # Jacobi's iteration. It halves the error each time, since the diagonal is twice the sum of the rest of its row.
        double = 2.0 * (spans[:-1] + spans[1:])
        before, after, right = spans[:-1] / double, spans[1:] / double, 6.0 * np.diff(slopes, axis=0) / double
        for _ in range(HALVINGS):
            bends[1:-1] = right - before * bends[:-2] - after * bends[2:]
        # Of each span, from its start: position, and first to third derivative over 1, 1, 2 and 6.
        self._position, self._bend = points[:-1], 0.5 * bends[:-1]
        self._slope = slopes - spans * (2.0 * bends[:-1] + bends[1:]) / 6.0
        self._twist = np.diff(bends, axis=0) / (6.0 * spans)

    @property
    def grid(self) -> Vector:
        """Parameters for timing: the second derivative is linear between them."""
        spans = len(self.knots) - 1
        steps = max(GRID_STEPS_PER_SPAN, -(-LEAST_GRID_STEPS // spans))
        return np.interp(np.arange(spans * steps + 1) / steps, np.arange(spans + 1), self.knots)

    def __call__(self, parameters: Vector, order: int = 0) -> Vector:
        """Return position, first or second derivative at parameters, shape (k, n); beyond the ends, of the end span."""
        parameters = np.asarray(parameters, dtype=np.float64)
        span = np.clip(np.searchsorted(self.knots, parameters, side="right") - 1, 0, len(self.knots) - 2)
        along = (parameters - self.knots[span])[..., np.newaxis]
        bend, twist = self._bend[span], self._twist[span]
        result: Vector
        if order == 2:
            result = 2.0 * bend + 6.0 * along * twist
        elif order == 1:
            result = self._slope[span] + along * (2.0 * bend + 3.0 * along * twist)
        else:
            result = self._position[span] + along * (self._slope[span] + along * (bend + along * twist))
        return result

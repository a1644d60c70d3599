"""Smooth curve through the points of a followed path, a natural cubic spline, and the tip's deviation between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.cartesian.following import CHORD_M, FollowedPath, TipTracker
from planners.cartesian.tip_path import TipPath, apart_rad
from planners.problem import Deviation
from robot.trajectory import Vector

# On a curve of few points the progress still has to rise and fall within this many steps.
LEAST_GRID_STEPS = 20

# The limits between grid points are kept to a few per mille with this many between two points of the curve.
GRID_STEPS_PER_SPAN = 2

# The tip is measured at so many places of each span between two points: half-way, where a curve is furthest off.
MEASURED_PER_SPAN = 2

# Joint limits are checked at so many places of each span: a shorter excursion is negligible.
LIMIT_CHECKS_PER_SPAN = 16

# Beside a corner the curve runs ahead of the path or behind it, by no more than so many measured places.
MEASURED_AROUND = 2

# Each round of new points halves the spans where the curve is off, and what it is off by more than that.
REFINEMENTS = 5


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


@dataclass(frozen=True)
class TipCurve:
    """A curve of the joints for a path of the tip.

    Attributes:
        followed: the points it goes through, more where they are needed.
        curve: the spline through them, by the length of the path.
        deviation: greatest deviation of the tip from the path on it.
    """

    followed: FollowedPath
    curve: SplinePath
    deviation: Deviation


def tip_curve(followed: FollowedPath, path: TipPath, tracker: TipTracker) -> TipCurve:
    """The curve through at least two followed points, with more of them where it would leave the path or the limits."""
    for _ in range(REFINEMENTS):
        measured = _measured(followed, path, tracker)
        off = np.flatnonzero(measured.off_m.reshape(-1, MEASURED_PER_SPAN).max(axis=1) > CHORD_M)
        places = measured.curve(_along_m(followed, LIMIT_CHECKS_PER_SPAN))
        outside = np.flatnonzero(tracker.outside(places).any(axis=1).reshape(-1, LIMIT_CHECKS_PER_SPAN).any(axis=1))
        spans = np.union1d(off, outside)
        if not len(spans):
            break
        followed = _halved(followed, spans, path, tracker)
    else:
        measured = _measured(followed, path, tracker)
    return TipCurve(followed, measured.curve, Deviation(float(measured.off_m.max()), measured.turned_rad))


@dataclass(frozen=True)
class _Measured:
    """A curve, the tip's distances from the path on it, shape (m,), and its greatest angle from the path's."""

    curve: SplinePath
    off_m: Vector
    turned_rad: float


def _measured(followed: FollowedPath, path: TipPath, tracker: TipTracker) -> _Measured:
    curve = SplinePath(followed.along_m, followed.points)
    along_m = _along_m(followed, MEASURED_PER_SPAN)
    desired = [path.at(length_m) for length_m in along_m]
    poses = [tracker.pose(point) for point in curve(along_m)]
    turned_rad = max(apart_rad(*pair) for pair in zip(desired, poses, strict=True))
    places_m, line_m = (np.array([pose.translation for pose in part]) for part in (poses, desired))
    return _Measured(curve, _distances_m(places_m, line_m), turned_rad)


def _along_m(followed: FollowedPath, per_span: int) -> Vector:
    """Lengths evenly within each span, its end included, shape (spans * per_span,) [m]."""
    spans = len(followed.points) - 1
    at = (np.arange(per_span * spans) + 1.0) / per_span
    return np.interp(at, np.arange(spans + 1), followed.along_m)


def _distances_m(places_m: Vector, line_m: Vector) -> Vector:
    """Distance of places from the pieces of a polyline around the points of their index, shape (m, 3) each."""
    nearest_m = np.linalg.norm(places_m - line_m, axis=1)
    last = len(line_m) - 1
    for shift in range(-MEASURED_AROUND, MEASURED_AROUND):
        i = np.clip(np.arange(last + 1) + shift, 0, last - 1)
        edge = line_m[i + 1] - line_m[i]
        square = np.maximum(np.sum(edge**2, axis=1), np.finfo(float).tiny)
        share = np.clip(np.sum((places_m - line_m[i]) * edge, axis=1) / square, 0.0, 1.0)
        away_m = np.linalg.norm(places_m - line_m[i] - share[:, np.newaxis] * edge, axis=1)
        nearest_m = np.minimum(nearest_m, away_m)
    return np.asarray(nearest_m)


def _halved(followed: FollowedPath, spans: NDArray[np.int64], path: TipPath, tracker: TipTracker) -> FollowedPath:
    """With a point more in the middle of some spans: half-way between their ends, brought back to the path."""
    middle_m = 0.5 * (followed.along_m[spans] + followed.along_m[spans + 1])
    guesses = zip(middle_m, 0.5 * (followed.points[spans] + followed.points[spans + 1]), strict=True)
    points = np.array([tracker.follow(guess, path.at(length_m), 0.0) for length_m, guess in guesses])
    return FollowedPath(
        np.insert(followed.along_m, spans + 1, middle_m),
        np.insert(followed.points, spans + 1, points, axis=0),
        followed.ended,
    )

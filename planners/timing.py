"""When is the arm where along a path: least time within velocity and acceleration limits, from rest to rest.

Straight lines have a closed form; polylines with rounded corners are timed by :mod:`planners.path_timing`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planners.blending import BlendedPath
from planners.path_timing import toppra_profile
from planners.profile import SHORTEST_INTERVAL_S, Profile, RateLimits, sampled, within_limits
from robot.trajectory import Trajectory

Vector = NDArray[np.float64]

# Points nearer than this are one point: directions between them are rounding errors.
SAME_POINT_RAD = 1e-9


def time_path(points: Vector, joint_names: tuple[str, ...], limits: RateLimits, blend_rad: float) -> Trajectory | None:
    """Time a polyline, rounding its corners.

    Args:
        points: shape (m, n), m >= 1 [rad].
        joint_names: the joints of the columns.
        limits: kept at the samples and by the cubic interpolation between them.
        blend_rad: how far from a corner the curve may leave the polyline [rad]; with 0 it stops in each corner.

    Returns:
        The motion, from rest to rest, exactly from the first point to the last. Samples are about
        10 ms apart; more are set where accelerations jump. None when TOPP-RA finds no timing.
        Points within 1e-9 rad of each other count as one.
    """
    points = _distinct(points)
    if len(points) == 1:
        rest = np.zeros_like(points)
        return Trajectory(joint_names, np.zeros(1), points, rest, rest)
    path = BlendedPath(points, blend_rad)
    stops = len(points) == 2 or blend_rad == 0.0
    profile = _stopping_profile(path, limits) if stops else toppra_profile(path, limits)
    if profile is None:
        return None
    return within_limits(sampled(path, profile, joint_names, points), limits)


def _distinct(points: Vector) -> Vector:
    """The points without those that repeat their predecessor; first and last stay exact, or are one point."""
    kept = [points[0]]
    for point in points[1:-1]:
        if not _same(point, kept[-1]):
            kept.append(point)
    while len(kept) > 1 and _same(kept[-1], points[-1]):
        kept.pop()
    if not _same(kept[-1], points[-1]):
        kept.append(points[-1])
    return np.array(kept)


def _same(a: Vector, b: Vector) -> bool:
    return bool(np.max(np.abs(a - b)) <= SAME_POINT_RAD)


def _stopping_profile(path: BlendedPath, limits: RateLimits) -> Profile:
    """Speed up, cruise and slow down on each line: time-optimal for a straight line."""
    s, rate = [0.0], [0.0]
    for start, end in zip(path.knots[:-1], path.knots[1:], strict=True):
        share = np.maximum(np.abs(path(0.5 * (start + end), 1)), 1e-12)
        top = float(np.min(limits.velocity_rad_s / share))
        acceleration = float(np.min(limits.acceleration_rad_s2 / share))
        ramp = min(0.5 * top**2 / acceleration, 0.5 * (end - start))
        top = float(np.sqrt(2.0 * acceleration * ramp))
        if end - start - 2.0 * ramp > SHORTEST_INTERVAL_S * top:
            s += [start + ramp, end - ramp, end]
            rate += [top, top, 0.0]
        else:
            s += [0.5 * (start + end), end]
            rate += [top, 0.0]
    return Profile(np.array(s), np.array(rate))

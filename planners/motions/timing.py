"""Closed forms: least time from rest to rest on a straight joint line, and from a moving start.

Everything is rounded up to whole ticks, at most three of them.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planners.motions.curve import TICK_S, Curve, standing
from planners.motions.ramps import connect, least_time_s, reduced, whole_ticks
from planners.rates import RateLimits

Vector = NDArray[np.float64]

# Points nearer than this are one point: directions between them are rounding errors.
SAME_POINT_RAD = 1e-9

# A moving joint that has to be slower than its neighbours may only be able to be much slower, by turning back.
LONGER_TIMES = (1.0, 1.1, 1.3, 1.7, 2.5, 4.0)


def same_point(a: Vector, b: Vector) -> bool:
    """Whether two points are one."""
    return bool(np.max(np.abs(a - b)) <= SAME_POINT_RAD)


def line(start: Vector, goal: Vector, limits: RateLimits) -> Curve:
    """Speed up, cruise and slow down on a straight line, as fast as its tightest joint allows.

    Args:
        start: shape (n,) [rad].
        goal: shape (n,), another point [rad].
        limits: what to keep; their jerk is not considered.
    """
    share = np.maximum(np.abs(goal - start), SAME_POINT_RAD)
    rate = float(np.min(limits.velocity_rad_s / share))
    acceleration = float(np.min(limits.acceleration_rad_s2 / share))
    ramp_s = min(rate / acceleration, float(np.sqrt(1.0 / acceleration)))
    total_s = ramp_s + 1.0 / (acceleration * ramp_s)
    ramp = int(np.ceil(ramp_s / TICK_S))
    total = int(np.ceil(total_s / TICK_S)) + 1
    top = (goal - start) / (TICK_S * (total - ramp))
    ticks = np.array([0, ramp, total - ramp, total])
    on_ramp = 0.5 * TICK_S * ramp * top
    positions = np.array([start, start + on_ramp, goal - on_ramp, goal])
    rest = np.zeros_like(start)
    velocities = np.array([rest, top, top, rest])
    if 2 * ramp == total:
        return Curve(ticks[[0, 1, 3]], positions[[0, 1, 3]], velocities[[0, 1, 3]])
    return Curve(ticks, positions, velocities)


def polyline(points: Vector, limits: RateLimits, wait_ticks: int = 0) -> Curve:
    """Stop in each point of a polyline.

    Args:
        points: shape (m, n), m >= 1 [rad]; points that repeat their predecessor count once.
        limits: what to keep; their jerk is not considered.
        wait_ticks: how long to wait in each point between the first and the last.
    """
    points = _distinct(points)
    curves = [line(start, goal, limits) for start, goal in pairwise(points)]
    if not curves:
        return standing(points[-1], 1)
    whole = curves[0]
    for point, curve in zip(points[1:-1], curves[1:], strict=True):
        whole = (whole.then(standing(point, wait_ticks)) if wait_ticks else whole).then(curve)
    return whole


def from_moving(start: Vector, velocity: Vector, goal: Vector, limits: RateLimits) -> Curve | None:
    """Move from a moving start to rest in a point: no straight line, each joint takes its own ramps.

    Args:
        start: shape (n,) [rad].
        velocity: shape (n,), within the limits [rad/s].
        goal: shape (n,) [rad].
        limits: what to keep; their jerk is not considered.

    Returns:
        None when no time was found that suits all joints.
    """
    rest = np.zeros_like(start)
    least_s = least_time_s(start, velocity, goal, rest, reduced(limits))
    times = (int(whole_ticks(factor * least_s)) for factor in LONGER_TIMES)
    curves = (connect(start, velocity, goal, rest, ticks, limits) for ticks in times)
    return next((curve for curve in curves if curve is not None), None)


def brake(start: Vector, velocity: Vector, limits: RateLimits) -> Curve:
    """Bring each joint to rest as soon as it can.

    Args:
        start: shape (n,) [rad].
        velocity: shape (n,), not all 0 [rad/s].
        limits: what to keep; their jerk is not considered.
    """
    braking = np.maximum(np.ceil(np.abs(velocity) / (limits.acceleration_rad_s2 * TICK_S)), 1.0)
    knots = np.unique(np.concatenate(([0.0], braking)))
    braked = np.minimum(knots[:, np.newaxis], braking)
    share = braked / braking
    positions = start + TICK_S * velocity * braked * (1.0 - 0.5 * share)
    return Curve(knots.astype(np.int64), positions, velocity * (1.0 - share))


def _distinct(points: Vector) -> Vector:
    """The points without those that repeat their predecessor; the first and the last stay exact."""
    kept = [points[0]]
    for point in points[1:-1]:
        if not same_point(point, kept[-1]):
            kept.append(point)
    while len(kept) > 1 and same_point(kept[-1], points[-1]):
        kept.pop()
    if len(points) > 1 and not same_point(kept[-1], points[-1]):
        kept.append(points[-1])
    return np.array(kept)

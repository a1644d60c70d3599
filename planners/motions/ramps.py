"""Least-time motions in closed form: straight joint lines, and ramps between two states of the joints.

A ramp speeds up, cruises and slows down, each joint for itself, and all joints take the time of the slowest, after
Hauser and Ng-Thow-Hing, "Fast smoothing of manipulator trajectories using optimal bounded-acceleration shortcuts",
2010. Durations are rounded up to whole ticks, at most three of them.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planners.motions.curve import TICK_S, Curve, standing
from planners.problem import RateLimits

Vector = NDArray[np.float64]

# Points nearer than this are one point: directions between them are rounding errors.
SAME_POINT_RAD = 1e-9

# A moving joint that has to be slower than its neighbours may only be able to be much slower, by turning back.
LONGER_TIMES = (1.0, 1.1, 1.3, 1.7, 2.5, 4.0)


def same_point(a: Vector, b: Vector) -> bool:
    """Tell whether two points are one."""
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


# Ramps are solved for a little less than the limits and then rounded to ticks, which lends them a little more.
SHARE_OF_LIMITS = 0.999

# Each of the two ramps of a joint is rounded up by up to a tick.
ROUNDING_TICKS = 2

# Rates may exceed a limit by this share: rounding errors.
ROUNDING_SHARE = 1e-9


def least_time_s(p0: Vector, v0: Vector, p1: Vector, v1: Vector, limits: RateLimits) -> Vector:
    """Least time from one state to another, of the slowest joint.

    Args:
        p0: positions, shape (..., n) [rad].
        v0: velocities there, within the limits [rad/s].
        p1: positions to reach.
        v1: velocities there.
        limits: what to keep; their jerk is not considered.

    Returns:
        Shape (...) [s].
    """
    acceleration, top = limits.acceleration_rad_s2, limits.velocity_rad_s
    change = p1 - p0
    # Going straight from one velocity to the other covers this much; what lacks decides the direction of the cruise.
    direct = 0.5 * (v0 + v1) * np.abs(v1 - v0) / acceleration
    sign = np.where(change >= direct, 1.0, -1.0)
    v0, v1, change = sign * v0, sign * v1, sign * change
    peak = np.sqrt(np.maximum(0.5 * (v0**2 + v1**2) + acceleration * change, 0.0))
    cruise = np.minimum(peak, top)
    # What the ramps up to the cruise and down from it cover.
    on_ramps = (cruise**2 - 0.5 * (v0**2 + v1**2)) / acceleration
    cruise_s = np.where(peak > top, (change - on_ramps) / top, 0.0)
    time_s: Vector = np.max((2.0 * cruise - v0 - v1) / acceleration + cruise_s, axis=-1)
    return time_s


def whole_ticks(time_s: Vector) -> NDArray[np.int64]:
    """The ticks that ramps of such a least time need."""
    return np.ceil(time_s / TICK_S).astype(np.int64) + ROUNDING_TICKS


def reduced(limits: RateLimits) -> RateLimits:
    """The limits to solve for, so that the rounded ramps keep the true ones."""
    return RateLimits(SHARE_OF_LIMITS * limits.velocity_rad_s, SHARE_OF_LIMITS * limits.acceleration_rad_s2)


def connect(p0: Vector, v0: Vector, p1: Vector, v1: Vector, ticks: int, limits: RateLimits) -> Curve | None:
    """The motion from one state to another in a given time, every joint at its gentlest cruise velocity.

    Args:
        p0: positions, shape (n,) [rad].
        v0: velocities there [rad/s].
        p1: positions to reach.
        v1: velocities there.
        ticks: the time to take, see :func:`whole_ticks`.
        limits: what to keep; their jerk is not considered.

    Returns:
        None when some joint cannot take just that time: it would have to be faster, or could only be sooner or
        much later, as a joint that cannot stop before it must be where it is to be.
    """
    cruise = _cruise_velocity(p1 - p0, v0, v1, TICK_S * ticks, SHARE_OF_LIMITS * limits.acceleration_rad_s2)
    speed_up = SHARE_OF_LIMITS * TICK_S * limits.acceleration_rad_s2
    first = np.maximum(np.ceil(np.abs(cruise - v0) / speed_up), 1.0)
    last = np.maximum(np.ceil(np.abs(cruise - v1) / speed_up), 1.0)
    if not (first + last <= ticks).all():
        return None
    # With the ramps rounded the distance is met by another cruise velocity.
    mean = (p1 - p0) / TICK_S - 0.5 * (v0 * first + v1 * last)
    cruise = mean / (ticks - 0.5 * (first + last))
    up, down = (cruise - v0) / first, (v1 - cruise) / last
    most = (1.0 + ROUNDING_SHARE) * TICK_S * limits.acceleration_rad_s2
    kept = (np.abs(up) <= most) & (np.abs(down) <= most)
    if not (kept & (np.abs(cruise) <= (1.0 + ROUNDING_SHARE) * limits.velocity_rad_s)).all():
        return None
    return _three_phases(p0, v0, p1, v1, cruise, first, last, ticks)


def _cruise_velocity(change: Vector, v0: Vector, v1: Vector, time_s: float, acceleration: Vector) -> Vector:
    """The one velocity at which ramps to it and from it cover the distance in the time; NaN where none does."""
    low, high = np.minimum(v0, v1), np.maximum(v0, v1)
    spare_s = time_s - (high - low) / acceleration
    # The distance grows with the cruise velocity: a line between the two velocities, a parabola beyond either.
    ramps = 0.5 * (high**2 - low**2) / acceleration
    at_low, at_high = ramps + low * spare_s, ramps + high * spare_s
    between = (change - ramps) / np.where(spare_s > 0.0, spare_s, np.nan)
    beyond = np.where(change > at_high, change - at_high, np.where(change < at_low, at_low - change, 0.0))
    # A peak of height h above (or a dip below) takes 2 h / a of the spare time: h (spare - h / a) = distance.
    root_s2 = spare_s**2 - 4.0 * beyond / acceleration
    height = 0.5 * acceleration * (spare_s - np.sqrt(np.where(root_s2 >= 0.0, root_s2, np.nan)))
    cruise: Vector = np.where(change > at_high, high + height, np.where(change < at_low, low - height, between))
    return cruise


def _three_phases(
    p0: Vector, v0: Vector, p1: Vector, v1: Vector, cruise: Vector, first: Vector, last: Vector, ticks: int
) -> Curve:
    """Knots where any joint switches."""
    knots = np.unique(np.concatenate(([0.0], first, ticks - last, [float(ticks)])))
    t = knots[:, np.newaxis]
    speeding, slowing = np.minimum(t, first), np.maximum(t - (ticks - last), 0.0)
    cruising = t - speeding - slowing
    up, down = (cruise - v0) / first, (v1 - cruise) / last
    velocities = np.where(t < first, v0 + up * speeding, cruise + down * slowing)
    covered = (v0 + 0.5 * up * speeding) * speeding + cruise * cruising + (cruise + 0.5 * down * slowing) * slowing
    positions = p0 + TICK_S * covered
    positions[-1], velocities[-1] = p1, v1
    return Curve(knots.astype(np.int64), positions, velocities)

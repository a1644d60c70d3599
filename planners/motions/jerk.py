"""Jerk limits: the accelerations of a curve that jump made to grow and shrink evenly.

A curve averaged over a window of time keeps the velocity and acceleration limits of the curve and has no more jerk than
the change of its acceleration over a window divided by the window: on a straight line from rest to rest this is the
S-curve of seven phases. Biagiotti and Melchiorri, "FIR filters for online trajectory planning", 2012.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planners.motions.curve import TICK_S, Curve, Ticks, seconds
from planners.rates import RateLimits
from robot.trajectory import Trajectory

Vector = NDArray[np.float64]


def window_ticks(limits: RateLimits) -> int:
    """The window that keeps the jerk limits even where a joint goes from full speeding up to full braking [ticks]."""
    if limits.jerk_rad_s3 is None:
        return 0
    return int(np.ceil(np.max(2.0 * limits.acceleration_rad_s2 / limits.jerk_rad_s3) / TICK_S))


def ahead(start: Vector, velocity: Vector, window: int) -> Vector:
    """Where a curve has to start for its average to start in ``start``: half a window further [rad]."""
    point: Vector = start + 0.5 * TICK_S * window * velocity
    return point


def averaged(curve: Curve, window: int, joint_names: tuple[str, ...]) -> Trajectory:
    """The mean of a curve over a window of time that ends now, as samples.

    Args:
        curve: before it the joints moved evenly with its first velocity, after it they stay.
        window: [ticks], at least 1.
        joint_names: the joints of the columns.

    Returns:
        A motion that takes a window longer than the curve; a cubic between its samples repeats it exactly.
    """
    ticks = np.unique(np.concatenate((curve.sample_ticks(), curve.sample_ticks() + window)))
    window_s = TICK_S * window
    now, before = (_integrals(curve, each) for each in (ticks, ticks - window))
    positions, velocities, accelerations = ((a - b) / window_s for a, b in zip(now, before, strict=True))
    # The ends without rounding errors.
    positions[0], velocities[0] = (
        ahead(curve.positions_rad[0], curve.velocities_rad_s[0], -window),
        curve.velocities_rad_s[0],
    )
    positions[-1], velocities[-1] = curve.positions_rad[-1], curve.velocities_rad_s[-1]
    accelerations[[0, -1]] = 0.0
    return Trajectory(joint_names, seconds(ticks), positions, velocities, accelerations)


def _integrals(curve: Curve, ticks: Ticks) -> tuple[Vector, Vector, Vector]:
    """Integral of the position from the start [rad s], position and velocity; before and after the curve as well."""
    inside = np.clip(ticks, 0, curve.duration_ticks)
    outside_s = (TICK_S * (ticks - inside))[:, np.newaxis]
    position, velocity, _ = curve.at(inside)
    velocity = np.where(ticks[:, np.newaxis] > curve.duration_ticks, 0.0, velocity)
    area = _area(curve, inside) + outside_s * (position + 0.5 * outside_s * velocity)
    return area, position + outside_s * velocity, velocity


def _area(curve: Curve, ticks: Ticks) -> Vector:
    """Integral of the position from the start of the curve [rad s]."""
    span_s = (TICK_S * np.diff(curve.ticks))[:, np.newaxis]
    v0, v1 = curve.velocities_rad_s[:-1], curve.velocities_rad_s[1:]
    pieces = span_s * (curve.positions_rad[:-1] + span_s * (2.0 * v0 + v1) / 6.0)
    before = np.concatenate((np.zeros_like(pieces[:1]), np.cumsum(pieces, axis=0)))
    i = np.searchsorted(curve.ticks[1:-1], ticks, side="right")
    since_s = (TICK_S * (ticks - curve.ticks[i]))[:, np.newaxis]
    acceleration = ((v1 - v0) / span_s)[i]
    cubic = curve.velocities_rad_s[i] / 2.0 + since_s * acceleration / 6.0
    area: Vector = before[i] + since_s * (curve.positions_rad[i] + since_s * cubic)
    return area

"""A smooth curve through points in time that stays between each two of them, from rest to rest.

Fritsch, Butland: A Method for Constructing Local Monotone Piecewise Cubic Interpolants, SIAM J. Sci. Stat. Comput. 5
(1984). Unlike a spline with continuous accelerations it never swings beyond the points it is given, so that it keeps
limits that they keep.
"""

from __future__ import annotations

import numpy as np

from robot.trajectory import Vector


def knot_velocities(time_s: Vector, positions_rad: Vector) -> Vector:
    """Velocities at the points, shape (n, joints) [rad/s]: zero at the ends and where a joint turns round.

    Args:
        time_s: shape (n,), increasing [s].
        positions_rad: shape (n, joints) [rad].
    """
    velocities = np.zeros_like(positions_rad)
    spans = np.diff(time_s)[:, np.newaxis]
    slopes = np.diff(positions_rad, axis=0) / spans
    before, after = slopes[:-1], slopes[1:]
    # The harmonic mean of the two slopes, the one of the shorter span counting more.
    weight_before, weight_after = 2.0 * spans[1:] + spans[:-1], spans[1:] + 2.0 * spans[:-1]
    onward = before * after > 0.0
    weighted = np.divide(weight_before, before, where=onward, out=np.ones_like(before))
    weighted += np.divide(weight_after, after, where=onward, out=np.ones_like(after))
    velocities[1:-1] = np.where(onward, (weight_before + weight_after) / weighted, 0.0)
    return velocities


def knot_accelerations(time_s: Vector, positions_rad: Vector, velocities_rad_s: Vector) -> Vector:
    """Mean of the accelerations before and after each point on cubics with these velocities, shape (n, joints).

    Args:
        time_s: shape (n,), increasing [s].
        positions_rad: shape (n, joints) [rad].
        velocities_rad_s: shape (n, joints) [rad/s].
    """
    accelerations = np.zeros_like(positions_rad)
    spans = np.diff(time_s)[:, np.newaxis]
    slopes = np.diff(positions_rad, axis=0) / spans
    first, last = velocities_rad_s[:-1], velocities_rad_s[1:]
    starts = (6.0 * slopes - 4.0 * first - 2.0 * last) / spans
    ends = (2.0 * first + 4.0 * last - 6.0 * slopes) / spans
    accelerations[:-1] += 0.5 * starts
    accelerations[1:] += 0.5 * ends
    if len(time_s) > 1:
        accelerations[0] *= 2.0
        accelerations[-1] *= 2.0
    return accelerations

"""How a path is run through: progress over time, its samples, and the limits they keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.cartesian.spline import SplinePath
from planners.rates import RateLimits
from robot.trajectory import Trajectory

Vector = NDArray[np.float64]

# The servo loop runs at 100 Hz.
SAMPLE_PERIOD_S = 0.01

# Samples closer together than this lose digits in the interpolation between them.
SHORTEST_INTERVAL_S = 0.001


@dataclass(frozen=True)
class Profile:
    """Progress along a path: between knots the progress accelerates uniformly.

    Attributes:
        s: shape (k,), lengths [rad].
        rate: shape (k,), progress there [rad/s]; 0 at both ends.
    """

    s: Vector
    rate: Vector

    @property
    def times_s(self) -> Vector:
        """Time of each knot, shape (k,) [s]."""
        return np.concatenate(([0.0], np.cumsum(2.0 * np.diff(self.s) / (self.rate[:-1] + self.rate[1:]))))


def sampled(path: SplinePath, profile: Profile, joint_names: tuple[str, ...], points: Vector) -> Trajectory:
    """The motion along a path, sampled at its knots and at 100 Hz; it starts and ends exactly in ``points``' ends."""
    knots_s = profile.times_s
    times_s = _sample_times(knots_s)
    i = np.clip(np.searchsorted(knots_s, times_s, side="right") - 1, 0, len(knots_s) - 2)
    since_s = times_s - knots_s[i]
    acceleration = np.diff(profile.rate)[i] / np.diff(knots_s)[i]
    rate = profile.rate[i] + acceleration * since_s
    s = profile.s[i] + (profile.rate[i] + 0.5 * acceleration * since_s) * since_s
    tangent, curvature = path(s, 1), path(s, 2)
    positions = path(s)
    velocities = tangent * rate[:, np.newaxis]
    accelerations = curvature * rate[:, np.newaxis] ** 2 + tangent * acceleration[:, np.newaxis]
    positions[[0, -1]] = points[[0, -1]]
    velocities[[0, -1]] = 0.0
    # Arrived, the arm stays: the last braking belongs to the samples before.
    accelerations[-1] = 0.0
    return Trajectory(joint_names, times_s, positions, velocities, accelerations)


def _sample_times(knots_s: Vector) -> Vector:
    """Knots and a 100 Hz grid, without grid points beside knots and without knots beside each other."""
    kept = [0.0]
    for knot_s in knots_s[1:-1]:
        if knot_s - kept[-1] > SHORTEST_INTERVAL_S and knots_s[-1] - knot_s > SHORTEST_INTERVAL_S:
            kept.append(float(knot_s))
    kept.append(float(knots_s[-1]))
    knots = np.array(kept)
    grid = np.arange(SAMPLE_PERIOD_S, knots[-1], SAMPLE_PERIOD_S)
    after = np.searchsorted(knots, grid)
    apart = np.minimum(grid - knots[after - 1], knots[after] - grid) > SHORTEST_INTERVAL_S
    return np.sort(np.concatenate((knots, grid[apart])))


def within_limits(trajectory: Trajectory, limits: RateLimits) -> Trajectory:
    """The motion slowed down until its cubic interpolation keeps the limits everywhere."""
    span_s = np.diff(trajectory.time_s)[:, np.newaxis]
    slope = np.diff(trajectory.positions_rad, axis=0) / span_s
    v0, v1 = trajectory.velocities_rad_s[:-1], trajectory.velocities_rad_s[1:]
    a0, a1 = (6.0 * slope - 4.0 * v0 - 2.0 * v1) / span_s, (2.0 * v0 + 4.0 * v1 - 6.0 * slope) / span_s
    # Acceleration is a line over each interval and greatest at an end; velocity is a parabola, greatest there or
    # where the line crosses zero.
    crossing = np.clip(np.divide(a0, a0 - a1, out=np.zeros_like(a0), where=a0 != a1), 0.0, 1.0)
    turning = v0 + span_s * crossing * (a0 + 0.5 * crossing * (a1 - a0))
    velocity_excess = max(np.max(np.abs(v) / limits.velocity_rad_s) for v in (v0, v1, turning))
    acceleration_excess = max(np.max(np.abs(a) / limits.acceleration_rad_s2) for a in (a0, a1))
    stretch = max(1.0, float(velocity_excess), float(np.sqrt(acceleration_excess)))
    return Trajectory(
        trajectory.joint_names,
        trajectory.time_s * stretch,
        trajectory.positions_rad,
        trajectory.velocities_rad_s / stretch,
        trajectory.accelerations_rad_s2 / stretch**2,
    )

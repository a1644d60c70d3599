"""When is the arm where along a path: least time within velocity and acceleration limits, from rest to rest.

Straight lines have a closed form; polylines with rounded corners are timed by TOPP-RA (Pham & Pham, "A New Approach
to Time-Optimal Path Parameterization Based on Reachability Analysis", 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint

from planners.blending import BlendedPath
from robot.trajectory import Trajectory

Vector = NDArray[np.float64]

# The servo loop runs at 100 Hz.
SAMPLE_PERIOD_S = 0.01

# Samples closer together than this lose digits in the interpolation between them.
SHORTEST_INTERVAL_S = 0.001

# Points nearer than this are one point: directions between them are rounding errors.
SAME_POINT_RAD = 1e-9

# TOPP-RA's time grows with the grid, and the limits between its points are kept better: 100 points take 2 ms.
GRID_STEPS_PER_BLEND = 10
GRID_STEPS_ON_LINES = 60


@dataclass(frozen=True)
class RateLimits:
    """The most that each joint may do, shape (n,) each.

    Attributes:
        velocity_rad_s: above 0 [rad/s].
        acceleration_rad_s2: above 0 [rad/s^2].
    """

    velocity_rad_s: Vector
    acceleration_rad_s2: Vector


@dataclass(frozen=True)
class _Profile:
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
    profile = _stopping_profile(path, limits) if stops else _toppra_profile(path, limits)
    if profile is None:
        return None
    return _within_limits(_sampled(path, profile, joint_names, points), limits)


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


def _stopping_profile(path: BlendedPath, limits: RateLimits) -> _Profile:
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
    return _Profile(np.array(s), np.array(rate))


def _toppra_profile(path: BlendedPath, limits: RateLimits) -> _Profile | None:
    velocity, acceleration = limits.velocity_rad_s, limits.acceleration_rad_s2
    constraints = [
        JointVelocityConstraint(np.column_stack((-velocity, velocity))),
        # The default scheme exceeds the limit up to 2.4 times between grid points.
        JointAccelerationConstraint(
            np.column_stack((-acceleration, acceleration)),
            discretization_scheme=DiscretizationType.Interpolation,
        ),
    ]
    grid = _grid(path)
    solver = TOPPRA(constraints, path, gridpoints=grid, solver_wrapper="seidel")
    _, rate, _ = solver.compute_parameterization(0.0, 0.0)
    if rate is None or not np.all(np.isfinite(rate)) or np.any(rate[1:-1] <= 0.0):
        return None
    return _Profile(grid, np.concatenate(([0.0], rate[1:-1], [0.0])))


def _grid(path: BlendedPath) -> Vector:
    step = (path.knots[-1] - path.knots[0]) / GRID_STEPS_ON_LINES
    pieces = [path.knots[:1]]
    for start, end, blend in zip(path.knots[:-1], path.knots[1:], path.in_blend, strict=True):
        # A line has at least two steps, so that the arm may speed up and slow down on it.
        count = GRID_STEPS_PER_BLEND if blend else max(2, int(np.ceil((end - start) / step)))
        pieces.append(np.linspace(start, end, count + 1)[1:])
    return np.concatenate(pieces)


def _sampled(path: BlendedPath, profile: _Profile, joint_names: tuple[str, ...], points: Vector) -> Trajectory:
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


def _within_limits(trajectory: Trajectory, limits: RateLimits) -> Trajectory:
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

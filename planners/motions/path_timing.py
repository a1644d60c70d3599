"""Timing of a given curve of the joints: the fastest progress along it from rest to rest, and its samples.

TOPP-RA gives the least time within velocity and acceleration limits: Pham & Pham, "A New Approach to Time-Optimal Path
Parameterization Based on Reachability Analysis", 2018.
"""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from planners.motions.spline import NaturalSpline
from planners.problem import RateLimits
from robot.trajectory import Trajectory, Vector


class _Empty(ModuleType):
    """Module that any name can be imported from, and nothing used."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        # Python imports nothing from within a module without a path.
        self.__path__ = []

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


@contextlib.contextmanager
def _empty_modules(*names: str) -> Iterator[None]:
    """Have empty modules stand in for modules that are not loaded yet."""
    absent = [name for name in names if name not in sys.modules]
    sys.modules.update({name: _Empty(name) for name in absent})
    try:
        # Python 3.12 and later warn of the LaTeX in toppra's docstrings wherever they compile it.
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        for name in absent:
            del sys.modules[name]


# toppra imports these for its splines, a solver and plots. With them a planner process takes 165 MB in place of 84 MB
# and 0.7 s longer to start; matplotlib need not be installed.
with _empty_modules("scipy", "scipy.interpolate", "scipy.sparse", "matplotlib", "matplotlib.pyplot"):
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraintVarying

# The arm's longest trajectory: 180 000 samples at 100 Hz. A scaling of 1e-6 would make 25 million samples.
MAX_DURATION_S = 1800.0

SAMPLE_PERIOD_S = 0.01  # the servo loop runs at 100 Hz
SHORTEST_INTERVAL_S = 0.001  # samples closer together than this lose digits in the interpolation between them

# Where the joints stand nothing else bounds the progress, which is about 1 where they move, in scaled units. Much more
# makes numbers that toppra's solver takes for 0.
FASTEST_RATE = 30.0

# Where the arm can only stand, toppra's tolerance of 1e-8 in squared rates makes it crawl at up to 7e-4 of these units.
STANDING_RATE = 1e-3


def standing(joint_names: tuple[str, ...], point: Vector) -> Trajectory:
    """Return the motion of no duration that stays in a point, shape (n,) [rad]."""
    rest = np.zeros((1, len(point)))
    return Trajectory(joint_names, np.zeros(1), point[np.newaxis], rest, rest)


@dataclass(frozen=True)
class Profile:
    """Progress along a path: between knots the progress accelerates uniformly."""

    s: Vector  # shape (k,), lengths [rad]
    rate: Vector  # shape (k,), progress there [rad/s]; 0 at both ends

    @property
    def times_s(self) -> Vector:
        """Time of each knot, shape (k,) [s]."""
        return np.concatenate(([0.0], np.cumsum(2.0 * np.diff(self.s) / (self.rate[:-1] + self.rate[1:]))))


def sampled(path: NaturalSpline, profile: Profile, joint_names: tuple[str, ...]) -> Trajectory:
    """Return the motion along a path, sampled at the profile's knots and at 100 Hz; its ends are exact."""
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
    positions[[0, -1]] = path.points[[0, -1]]
    velocities[[0, -1]] = 0.0
    # Arrived, the arm stays: the last braking belongs to the samples before.
    accelerations[-1] = 0.0
    return Trajectory(joint_names, times_s, positions, velocities, accelerations)


def _sample_times(knots_s: Vector) -> Vector:
    """Return knots and a 100 Hz grid, without grid points beside knots and without knots beside each other."""
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
    """Return the motion, slowed down until its cubic interpolation keeps the limits everywhere."""
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
    velocities, accelerations = trajectory.velocities_rad_s / stretch, trajectory.accelerations_rad_s2 / stretch**2
    times_s = trajectory.time_s * stretch
    return Trajectory(trajectory.joint_names, times_s, trajectory.positions_rad, velocities, accelerations)


def toppra_profile(path: NaturalSpline, limits: RateLimits, top_rate: Vector | None = None) -> Profile | None:
    """Return the fastest progress along a path from rest to rest.

    Acceleration limits are kept at the points of the path's ``grid`` and nearly so between them. ``top_rate`` are
    further limits of the progress rate, each above 0, shape (len(path.grid),). None when the path demands an infinite
    acceleration, stands still, or has numbers that are not finite.
    """
    length = float(path.knots[-1] - path.knots[0])
    reach_s2 = np.abs(path(path.grid, 1)) * length / limits.acceleration_rad_s2
    unit_s = float(np.sqrt(np.max(reach_s2)))
    if not 0.0 < unit_s < np.inf:
        return None
    scaled = _ScaledPath(path, length, limits.acceleration_rad_s2 * unit_s**2)
    scaled_velocity = limits.velocity_rad_s * unit_s / scaled.joint_units_rad
    top = FASTEST_RATE if top_rate is None else top_rate * unit_s / length
    scaled_top = np.minimum(np.full(len(scaled.grid), FASTEST_RATE), top)
    rate = _fastest(scaled, scaled_velocity, scaled_top)
    # The motion may stop in a point, but has to get away from it.
    if not np.all(rate[:-1] + rate[1:] > 2.0 * STANDING_RATE * min(1.0, scaled_top.min())):
        return None
    return Profile(path.grid, rate * length / unit_s)


@dataclass(frozen=True)
class _ScaledPath:
    """A path from 0 to 1 for toppra, whose tolerances are for numbers of about 1; its last column is progress."""

    path: NaturalSpline
    length: float
    joint_units_rad: Vector

    @property
    def grid(self) -> Vector:
        return np.asarray((self.path.grid - self.path.knots[0]) / self.length)

    @property
    def dof(self) -> int:
        return len(self.joint_units_rad) + 1

    @property
    def path_interval(self) -> Vector:
        return np.array([0.0, 1.0])

    def __call__(self, path_positions: Vector, order: int = 0) -> Vector:
        joints = self.path(self.path.knots[0] + self.length * path_positions, order)
        progress = (path_positions, np.ones_like(path_positions), np.zeros_like(path_positions))[order]
        return np.column_stack((joints * (self.length**order / self.joint_units_rad), progress / FASTEST_RATE**2))


def _fastest(path: _ScaledPath, velocity: Vector, top_rate: Vector) -> Vector:
    """Return the greatest rate at each grid point, not a number where toppra finds none."""
    grid = path.grid
    allowed = np.column_stack((np.tile(velocity, (len(grid), 1)), top_rate / FASTEST_RATE**2))
    both_ways = np.stack((-allowed, allowed), axis=2)
    constraints = [
        JointVelocityConstraintVarying(lambda position: both_ways[np.searchsorted(grid, position)]),
        # The scheme that looks at single points exceeds the limits up to 2.4 times between them.
        JointAccelerationConstraint(np.ones(path.dof), DiscretizationType.Interpolation),
    ]
    solver = TOPPRA(constraints, path, gridpoints=grid, solver_wrapper="seidel")
    _, rate, _ = solver.compute_parameterization(0.0, 0.0)
    return np.full_like(grid, np.nan) if rate is None else rate


def time_along(
    path: NaturalSpline, joint_names: tuple[str, ...], limits: RateLimits, top_rate: Vector | None = None
) -> Trajectory | None:
    """Return the fastest motion from rest to rest within the limits; None if there is none or it takes too long."""
    profile = toppra_profile(path, limits, top_rate)
    if profile is None or profile.times_s[-1] > MAX_DURATION_S:
        return None
    return within_limits(sampled(path, profile, joint_names), limits)

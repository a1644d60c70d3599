"""Curves of the joints over time, each joint accelerating uniformly between knots, and their jerk limits.

Knots lie on a grid of whole ticks, so two of them are never so near each other that differences lose their digits.

A curve averaged over a window of time keeps the velocity and acceleration limits of the curve and has no more jerk than
the change of its acceleration over a window divided by the window: on a straight line from rest to rest this is the
S-curve of seven phases. Biagiotti and Melchiorri, "FIR filters for online trajectory planning", 2012.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.problem import RateLimits
from robot.trajectory import Trajectory

Vector = NDArray[np.float64]
Ticks = NDArray[np.int64]

# Rounding switches up to a tick costs at most three of them a piece, which is nothing beside motions of a second;
# accelerations over a tick still have seven digits.
TICK_S = 1e-4

# The servo loop runs at 100 Hz.
SAMPLE_TICKS = 100

# Samples of the 100 Hz grid this close to a knot would tell nothing more than the knot.
NEAR_KNOT_TICKS = 10


def seconds(ticks: Ticks) -> Vector:
    """Times in seconds, of the same shape."""
    return np.asarray(TICK_S * ticks, dtype=np.float64)


@dataclass(frozen=True)
class Curve:
    """Joint positions over time.

    Attributes:
        ticks: shape (k,), k >= 2, increasing from 0 [:data:`TICK_S`].
        positions_rad: shape (k, n), at the knots [rad].
        velocities_rad_s: shape (k, n), there [rad/s].
    """

    ticks: Ticks
    positions_rad: Vector
    velocities_rad_s: Vector

    @property
    def duration_ticks(self) -> int:
        """Length in time [ticks]."""
        return int(self.ticks[-1])

    def at(self, ticks: Ticks | Vector) -> tuple[Vector, Vector, Vector]:
        """Positions, velocities and accelerations, shape (m, n) each, at times from 0 to the end [ticks]."""
        i = np.searchsorted(self.ticks[1:-1], ticks, side="right")
        span_s = (TICK_S * np.diff(self.ticks))[i, np.newaxis]
        since_s = (TICK_S * (ticks - self.ticks[i]))[:, np.newaxis]
        velocity = self.velocities_rad_s[i]
        acceleration = (self.velocities_rad_s[i + 1] - velocity) / span_s
        position = self.positions_rad[i] + since_s * (velocity + 0.5 * since_s * acceleration)
        return position, velocity + since_s * acceleration, acceleration

    def stays_within(self, lower_rad: Vector, upper_rad: Vector) -> bool:
        """Tell whether no joint leaves its range, turning points between the knots included."""
        v0, v1 = self.velocities_rad_s[:-1], self.velocities_rad_s[1:]
        turns = v0 * v1 < 0.0
        span_s = TICK_S * np.diff(self.ticks)[:, np.newaxis]
        to_turn = np.divide(0.5 * span_s * v0**2, v0 - v1, out=np.zeros_like(v0), where=turns)
        reached = np.concatenate((self.positions_rad, self.positions_rad[:-1] + to_turn))
        return bool(np.all((reached >= lower_rad) & (reached <= upper_rad)))

    def sampled(self, joint_names: tuple[str, ...]) -> Trajectory:
        """The same motion as samples at the knots and every 10 ms; a cubic between samples repeats it exactly."""
        ticks = self.sample_ticks()
        positions, velocities, accelerations = self.at(ticks)
        positions[[0, -1]] = self.positions_rad[[0, -1]]
        velocities[[0, -1]] = self.velocities_rad_s[[0, -1]]
        # Arrived, the arm stays: the last braking belongs to the samples before.
        accelerations[-1] = 0.0
        return Trajectory(joint_names, seconds(ticks), positions, velocities, accelerations)

    def sample_ticks(self) -> Ticks:
        """Times of the knots and of a 100 Hz grid between them [ticks]."""
        grid = np.arange(SAMPLE_TICKS, self.duration_ticks, SAMPLE_TICKS)
        after = np.searchsorted(self.ticks, grid)
        apart = np.minimum(grid - self.ticks[after - 1], self.ticks[after] - grid) >= NEAR_KNOT_TICKS
        return np.sort(np.concatenate((self.ticks, grid[apart])))

    def then(self, following: Curve) -> Curve:
        """This curve and one that starts where and as fast as it ends."""
        return Curve(
            np.concatenate((self.ticks, self.duration_ticks + following.ticks[1:])),
            np.concatenate((self.positions_rad, following.positions_rad[1:])),
            np.concatenate((self.velocities_rad_s, following.velocities_rad_s[1:])),
        )

    def part(self, first: int, last: int) -> Curve:
        """The curve from one time to a later one [ticks]."""
        inside = self.ticks[(self.ticks > first) & (self.ticks < last)]
        ticks = np.concatenate(([first], inside, [last]))
        positions, velocities, _ = self.at(ticks)
        return Curve(ticks - first, positions, velocities)

    def replaced(self, first: int, last: int, piece: Curve) -> Curve:
        """This curve with another piece from one time to a later one [ticks]; the piece has the same end states."""
        whole = piece if first == 0 else self.part(0, first).then(piece)
        whole = whole if last == self.duration_ticks else whole.then(self.part(last, self.duration_ticks))
        # Neither rounding errors nor the piece's own may move the ends.
        whole.positions_rad[[0, -1]] = self.positions_rad[[0, -1]]
        whole.velocities_rad_s[[0, -1]] = self.velocities_rad_s[[0, -1]]
        return whole


def standing(point: Vector, ticks: int) -> Curve:
    """A curve that stays in a point, shape (n,) [rad]."""
    points = np.array([point, point])
    return Curve(np.array([0, ticks]), points, np.zeros_like(points))


def window_ticks(limits: RateLimits) -> int:
    """The window that keeps the jerk limits even where a joint goes from full speeding up to full braking [ticks]."""
    if limits.jerk_rad_s3 is None:
        return 0
    return int(np.ceil(np.max(2.0 * limits.acceleration_rad_s2 / limits.jerk_rad_s3) / TICK_S))


def averaging_start(start: Vector, velocity: Vector, window: int) -> Vector:
    """Return the point half a window ahead, at which a curve must start for its average to start in ``start`` [rad]."""
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
        averaging_start(curve.positions_rad[0], curve.velocities_rad_s[0], -window),
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

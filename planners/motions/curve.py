"""Curves of the joints over time: straight lines, ramps between two states of the joints, and limits of the jerk.

Points, positions and velocities of n joints have the shape (n,) and are in rad and rad/s. Each joint accelerates
uniformly between knots. Knots lie on a grid of whole ticks, so two of them are never so near each other that
differences lose their digits.

Lines and ramps take the least time within the limits of velocity and acceleration, in closed form. A ramp speeds up,
cruises and slows down, each joint for itself, and all joints take the time of the slowest, after Hauser and
Ng-Thow-Hing, "Fast smoothing of manipulator trajectories using optimal bounded-acceleration shortcuts", 2010. Durations
are rounded up to whole ticks, at most three of them.

Limits of the jerk are met by averaging: the mean of a curve over a window of time keeps the velocity and acceleration
limits of the curve and has no more jerk than the change of its acceleration over a window divided by the window. On a
straight line from rest to rest this is the S-curve of seven phases. Biagiotti and Melchiorri, "FIR filters for online
trajectory planning", 2012.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planners.problem import RateLimits
from robot.trajectory import Trajectory, Vector

Ticks = NDArray[np.int64]

# Rounding switches up to a tick costs at most three of them a piece, which is nothing beside motions of a second;
# accelerations over a tick still have seven digits.
TICK_S = 1e-4

SAMPLE_TICKS = 100  # the servo loop runs at 100 Hz
NEAR_KNOT_TICKS = 10  # samples of the 100 Hz grid this close to a knot add nothing to it
SAME_POINT_RAD = 1e-9  # points nearer than this are one point: directions between them are rounding errors

# A moving joint that has to be slower than its neighbours may only be able to be much slower, by turning back.
LONGER_TIMES = np.array([1.0, 1.1, 1.3, 1.7, 2.5, 4.0])

SHARE_OF_LIMITS = 0.999  # share of the limits for which ramps are solved: rounding to ticks makes them a little steeper
ROUNDING_TICKS = 2  # each of the two ramps of a joint is rounded up by up to a tick
ROUNDING_SHARE = 1e-9  # rates may exceed a limit by this share: rounding errors


def seconds(ticks: Ticks) -> Vector:
    """Return times in seconds."""
    return np.asarray(TICK_S * ticks, dtype=np.float64)


@dataclass(frozen=True)
class Curve:
    """Joint positions over time."""

    ticks: Ticks  # shape (k,), k >= 2, increasing from 0 [:data:`TICK_S`]
    positions_rad: Vector  # shape (k, n), at the knots [rad]
    velocities_rad_s: Vector  # shape (k, n), there [rad/s]

    @property
    def duration_ticks(self) -> int:
        """Length in time [ticks]."""
        return int(self.ticks[-1])

    @cached_property
    def accelerations_rad_s2(self) -> Vector:
        """Accelerations from each knot to the next, shape (k - 1, n)."""
        return np.asarray(np.diff(self.velocities_rad_s, axis=0) / (TICK_S * np.diff(self.ticks))[:, np.newaxis])

    def at(self, ticks: Ticks | Vector) -> tuple[Vector, Vector, Vector]:
        """Positions, velocities and accelerations, shape (m, n) each, at times from 0 to the end [ticks]."""
        i = np.searchsorted(self.ticks[1:-1], ticks, side="right")
        since_s = (TICK_S * (ticks - self.ticks[i]))[:, np.newaxis]
        # Short rows are taken in a quarter of the time of an index.
        position, velocity = self.positions_rad.take(i, axis=0), self.velocities_rad_s.take(i, axis=0)
        acceleration = self.accelerations_rad_s2.take(i, axis=0)
        gained = since_s * acceleration
        return position + since_s * (velocity + 0.5 * gained), velocity + gained, acceleration

    def stays_within(self, lower_rad: Vector, upper_rad: Vector) -> bool:
        """Tell whether no joint leaves its range, also at turning points between the knots."""
        v0, v1 = self.velocities_rad_s[:-1], self.velocities_rad_s[1:]
        turns = v0 * v1 < 0.0
        span_s = TICK_S * np.diff(self.ticks)[:, np.newaxis]
        to_turn = np.divide(0.5 * span_s * v0**2, v0 - v1, out=np.zeros_like(v0), where=turns)
        reached = np.concatenate((self.positions_rad, self.positions_rad[:-1] + to_turn))
        return bool(np.all((reached >= lower_rad) & (reached <= upper_rad)))

    def sampled(self, joint_names: tuple[str, ...]) -> Trajectory:
        """Return samples at the knots and every 10 ms; a cubic between them repeats the motion exactly."""
        ticks = self.sample_ticks()
        positions, velocities, accelerations = self.at(ticks)
        positions[[0, -1]] = self.positions_rad[[0, -1]]
        velocities[[0, -1]] = self.velocities_rad_s[[0, -1]]
        # Arrived, the arm stays: the last braking belongs to the samples before.
        accelerations[-1] = 0.0
        return Trajectory(joint_names, seconds(ticks), positions, velocities, accelerations)

    def sample_ticks(self) -> Ticks:
        """Return the times of the knots and of a 100 Hz grid between them [ticks]."""
        grid = np.arange(SAMPLE_TICKS, self.duration_ticks, SAMPLE_TICKS)
        after = np.searchsorted(self.ticks, grid)
        apart = np.minimum(grid - self.ticks[after - 1], self.ticks[after] - grid) >= NEAR_KNOT_TICKS
        return np.sort(np.concatenate((self.ticks, grid[apart])))

    def then(self, following: Curve) -> Curve:
        """Append a curve that starts with the position and velocity at the end of this one."""
        return Curve(
            np.concatenate((self.ticks, self.duration_ticks + following.ticks[1:])),
            np.concatenate((self.positions_rad, following.positions_rad[1:])),
            np.concatenate((self.velocities_rad_s, following.velocities_rad_s[1:])),
        )

    def part(self, first: int, last: int) -> Curve:
        """Return the curve from one time to a later one [ticks]."""
        inside = self.ticks[(self.ticks > first) & (self.ticks < last)]
        ticks = np.concatenate(([first], inside, [last]))
        positions, velocities, _ = self.at(ticks)
        return Curve(ticks - first, positions, velocities)

    def replaced(self, first: int, last: int, piece: Curve) -> Curve:
        """Replace a part from one time to a later one [ticks] by a piece with the same end states."""
        whole = piece if first == 0 else self.part(0, first).then(piece)
        whole = whole if last == self.duration_ticks else whole.then(self.part(last, self.duration_ticks))
        # Neither rounding errors nor the piece's own may move the ends.
        whole.positions_rad[[0, -1]] = self.positions_rad[[0, -1]]
        whole.velocities_rad_s[[0, -1]] = self.velocities_rad_s[[0, -1]]
        return whole


def constant_curve(point: Vector, ticks: int) -> Curve:
    """Return a curve that stays in a point."""
    points = np.array([point, point])
    return Curve(np.array([0, ticks]), points, np.zeros_like(points))


def window_ticks(limits: RateLimits) -> int:
    """Return the window that keeps the jerk limits even from full speeding up to full braking [ticks]."""
    if limits.jerk_rad_s3 is None:
        return 0
    return int(np.ceil(np.max(2.0 * limits.acceleration_rad_s2 / limits.jerk_rad_s3) / TICK_S))


def averaging_start(start: Vector, velocity: Vector, window: int) -> Vector:
    """Return the point half a window ahead, at which a curve must start for its average to start in ``start`` [rad]."""
    return np.asarray(start + 0.5 * TICK_S * window * velocity)


def averaged(curve: Curve, window: int, joint_names: tuple[str, ...]) -> Trajectory:
    """Return the mean of a curve over a window of at least one tick that ends now, as samples.

    Before the curve the joints moved evenly with its first velocity, after it they stay. The motion takes a window
    longer than the curve, and a cubic between its samples repeats it exactly.
    """
    ticks = np.unique(np.concatenate((curve.sample_ticks(), curve.sample_ticks() + window)))
    window_s = TICK_S * window
    now, before = (_integrals(curve, each) for each in (ticks, ticks - window))
    positions, velocities, accelerations = ((a - b) / window_s for a, b in zip(now, before, strict=True))
    # The ends without rounding errors.
    velocities[0] = curve.velocities_rad_s[0]
    positions[0] = averaging_start(curve.positions_rad[0], velocities[0], -window)
    positions[-1], velocities[-1] = curve.positions_rad[-1], curve.velocities_rad_s[-1]
    accelerations[[0, -1]] = 0.0
    return Trajectory(joint_names, seconds(ticks), positions, velocities, accelerations)


def _integrals(curve: Curve, ticks: Ticks) -> tuple[Vector, Vector, Vector]:
    """Return the integral of the position from the start [rad s], position and velocity, also outside the curve."""
    inside = np.clip(ticks, 0, curve.duration_ticks)
    outside_s = (TICK_S * (ticks - inside))[:, np.newaxis]
    position, velocity, _ = curve.at(inside)
    velocity = np.where(ticks[:, np.newaxis] > curve.duration_ticks, 0.0, velocity)
    area = _area(curve, inside) + outside_s * (position + 0.5 * outside_s * velocity)
    return area, position + outside_s * velocity, velocity


def _area(curve: Curve, ticks: Ticks) -> Vector:
    span_s = (TICK_S * np.diff(curve.ticks))[:, np.newaxis]
    v0, v1 = curve.velocities_rad_s[:-1], curve.velocities_rad_s[1:]
    pieces = span_s * (curve.positions_rad[:-1] + span_s * (2.0 * v0 + v1) / 6.0)
    before = np.concatenate((np.zeros_like(pieces[:1]), np.cumsum(pieces, axis=0)))
    i = np.searchsorted(curve.ticks[1:-1], ticks, side="right")
    since_s = (TICK_S * (ticks - curve.ticks[i]))[:, np.newaxis]
    cubic = curve.velocities_rad_s[i] / 2.0 + since_s * curve.accelerations_rad_s2[i] / 6.0
    return np.asarray(before[i] + since_s * (curve.positions_rad[i] + since_s * cubic))


def same_point(a: Vector, b: Vector) -> bool:
    """Tell whether two points are one."""
    return bool(np.max(np.abs(a - b)) <= SAME_POINT_RAD)


def line(start: Vector, goal: Vector, limits: RateLimits) -> Curve:
    """Speed up, cruise and slow down on a straight line to another point, as fast as its tightest joint allows."""
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
    velocities = np.array([np.zeros_like(top), top, top, np.zeros_like(top)])
    knots = [0, 1, 3] if 2 * ramp == total else [0, 1, 2, 3]
    return Curve(ticks[knots], positions[knots], velocities[knots])


def polyline(points: Vector, limits: RateLimits, wait_ticks: int = 0) -> Curve:
    """Stop in each distinct point of a polyline, (m, n), m >= 1 [rad], for ``wait_ticks`` between first and last."""
    points = _distinct(points)
    curves = [line(start, goal, limits) for start, goal in pairwise(points)]
    if not curves:
        return constant_curve(points[-1], 1)
    whole = curves[0]
    for point, curve in zip(points[1:-1], curves[1:], strict=True):
        whole = (whole.then(constant_curve(point, wait_ticks)) if wait_ticks else whole).then(curve)
    return whole


def from_moving(start: Vector, velocity: Vector, goal: Vector, limits: RateLimits) -> Curve | None:
    """Move from a moving start to rest in a point, each joint on its own ramps; None where no time suits all joints."""
    rest = np.zeros_like(start)
    least_s = least_time_s(start, velocity, goal, rest, reduced(limits))
    ticks = whole_ticks(LONGER_TIMES * least_s)
    p0, v0, p1, v1 = (np.tile(each, (len(ticks), 1)) for each in (start, velocity, goal, rest))
    ways = Ways(p0, v0, p1, v1, ticks, limits)
    return ways.curve(int(np.argmax(ways.possible))) if ways.possible.any() else None


def brake(start: Vector, velocity: Vector, limits: RateLimits) -> Curve:
    """Bring each joint to rest as soon as it can, from velocities that are not all 0."""
    braking = np.maximum(np.ceil(np.abs(velocity) / (limits.acceleration_rad_s2 * TICK_S)), 1.0)
    knots = np.unique(np.concatenate(([0.0], braking)))
    braked = np.minimum(knots[:, np.newaxis], braking)
    share = braked / braking
    positions = start + TICK_S * velocity * braked * (1.0 - 0.5 * share)
    return Curve(knots.astype(np.int64), positions, velocity * (1.0 - share))


def _distinct(points: Vector) -> Vector:
    """Leave out points that repeat their predecessor; the first and the last stay exact."""
    kept = [points[0]]
    for point in points[1:-1]:
        kept += [] if same_point(point, kept[-1]) else [point]
    while len(kept) > 1 and same_point(kept[-1], points[-1]):
        kept.pop()
    if len(points) > 1 and not same_point(kept[-1], points[-1]):
        kept.append(points[-1])
    return np.array(kept)


def least_time_s(p0: Vector, v0: Vector, p1: Vector, v1: Vector, limits: RateLimits) -> Vector:
    """Return the slowest joint's least time from p0 to p1, (n,) or (m, n), with velocities v0 and v1 there [s]."""
    acceleration, top = limits.acceleration_rad_s2, limits.velocity_rad_s
    change = p1 - p0
    # Going straight from one velocity to the other covers this; the rest of the way decides the cruise's direction.
    direct = 0.5 * (v0 + v1) * np.abs(v1 - v0) / acceleration
    sign = np.copysign(1.0, change - direct)
    v0, v1, change = sign * v0, sign * v1, sign * change
    peak = np.sqrt(np.maximum(0.5 * (v0**2 + v1**2) + acceleration * change, 0.0))
    cruise = np.minimum(peak, top)
    # The way on the ramps up to the cruise and down from it.
    on_ramps = (cruise**2 - 0.5 * (v0**2 + v1**2)) / acceleration
    cruise_s = np.where(peak > top, (change - on_ramps) / top, 0.0)
    # numpy is slow along a last axis of five.
    return np.asarray(np.ascontiguousarray(((2.0 * cruise - v0 - v1) / acceleration + cruise_s).T).max(axis=0))


def whole_ticks(time_s: Vector) -> NDArray[np.int64]:
    """Return the ticks that ramps of a least time need."""
    return np.ceil(time_s / TICK_S).astype(np.int64) + ROUNDING_TICKS


def reduced(limits: RateLimits) -> RateLimits:
    """Return the limits to solve for, so that rounded ramps keep the given ones."""
    return RateLimits(SHARE_OF_LIMITS * limits.velocity_rad_s, SHARE_OF_LIMITS * limits.acceleration_rad_s2)


class Ways:
    """Ways from p0, v0 to p1, v1 in times of :func:`whole_ticks`, shape (m,), cruising gently; the rest (m, n)."""

    def __init__(self, p0: Vector, v0: Vector, p1: Vector, v1: Vector, ticks: Ticks, limits: RateLimits) -> None:
        self._p0, self._v0, self._p1, self._v1 = p0, v0, p1, v1
        self._ticks: Vector = ticks[:, np.newaxis].astype(np.float64)
        cruise = _cruise_velocity(p1 - p0, v0, v1, TICK_S * self._ticks, SHARE_OF_LIMITS * limits.acceleration_rad_s2)
        speed_up = SHARE_OF_LIMITS * TICK_S * limits.acceleration_rad_s2
        self._first = first = np.maximum(np.ceil(np.abs(cruise - v0) / speed_up), 1.0)
        self._last = last = np.maximum(np.ceil(np.abs(cruise - v1) / speed_up), 1.0)
        # With the ramps rounded the distance is met by another cruise velocity.
        mean = (p1 - p0) / TICK_S - 0.5 * (v0 * first + v1 * last)
        self._cruise = cruise = mean / np.maximum(self._ticks - 0.5 * (first + last), 1.0)
        self._up, self._down = (cruise - v0) / first, (v1 - cruise) / last
        steepest = np.maximum(np.abs(self._up), np.abs(self._down))
        kept = steepest <= (1.0 + ROUNDING_SHARE) * TICK_S * limits.acceleration_rad_s2
        kept &= np.abs(cruise) <= (1.0 + ROUNDING_SHARE) * limits.velocity_rad_s
        # Whether all joints can, shape (m,).
        self.possible = (kept & (first + last <= self._ticks)).all(axis=1)

    def places(self, chosen: NDArray[np.intp], shares: Vector) -> Vector:
        """Return the positions of chosen ways after shares of their times, shape (chosen, shares, n)."""
        ticks = shares[:, np.newaxis, np.newaxis] * self._ticks[chosen]
        return self._at(chosen, ticks)[0].swapaxes(0, 1)

    def curve(self, i: int) -> Curve:
        """Return the curve of one way, with knots where any joint switches."""
        first, last, ticks = self._first[i], self._last[i], self._ticks[i]
        knots = np.array(sorted({0.0, *first.tolist(), *(ticks - last).tolist(), *ticks.tolist()}))
        positions, velocities = self._at(i, knots[:, np.newaxis])
        positions[-1], velocities[-1] = self._p1[i], self._v1[i]
        return Curve(knots.astype(np.int64), positions, velocities)

    def _at(self, i: int | NDArray[np.intp], ticks: Vector) -> tuple[Vector, Vector]:
        """Return positions and velocities of one way at times (k, 1), or of ways at times (k, ways, 1)."""
        rows = self._p0, self._v0, self._cruise, self._up, self._down, self._first
        p0, v0, cruise, up, down, first = (each.take(i, axis=0) for each in rows)
        speeding = np.minimum(ticks, first)
        slowing = np.maximum(ticks - (self._ticks[i] - self._last[i]), 0.0)
        cruising = ticks - speeding - slowing
        velocities = np.where(ticks < first, v0 + up * speeding, cruise + down * slowing)
        covered = (v0 + 0.5 * up * speeding) * speeding + cruise * cruising + (cruise + 0.5 * down * slowing) * slowing
        return p0 + TICK_S * covered, velocities


def _cruise_velocity(change: Vector, v0: Vector, v1: Vector, time_s: Vector, acceleration: Vector) -> Vector:
    """Return the cruise velocity at which the way is covered in the time; NaN where there is none."""
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
    return np.asarray(np.where(change > at_high, high + height, np.where(change < at_low, low - height, between)))

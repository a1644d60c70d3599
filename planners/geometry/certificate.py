"""The last check of every motion: the timed curve as it will be driven, the samples and the curve between them.

The check of a curve advances by distances. Where a pair of shapes has a clearance, the curve is free of contacts of
this pair as far to either side as the joints take to use the clearance up; the two rests are checked in their middles.
All pairs are looked at together in a few points first: most are further apart than they can come around these.

Two motions of different joints are free where they are free wherever either of them is on its way. The two are not
timed against each other: a motion can be slowed, paused, stopped and sent back at any moment. So every position of one
is checked with every position of the other: a rectangle of their times, which is divided until no shape carried by one
motion can come near a shape carried by the other, within a whole part of it.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planners.geometry.collision import CollidingPair, CollisionModel
from planners.geometry.joint_space import JointSpace
from robot.trajectory import Trajectory, Vector

# Contacts deeper than half of this are found: it is the width of ranges that are not divided any more.
FINEST_STEP_M = 0.0001

# After the first contact, earlier ones are searched for this finely only: enough for the time of the contact.
EARLIEST_STEP_M = 0.01

LOOKS_AT_ONCE = 64  # numbers about these take 20 MB among 1000 objects

# Most that a point of the robot travels to either side of where all pairs are looked at, with few pairs and with more:
# with 0.05 in place of 0.1 plans take 0.97 of the time on SO-101 and Panda, and 1.05 to 1.3 among 1000 objects.
MARGINS_M, FEW_PAIRS = (0.05, 0.1), 2000

CHECK_STEP_M = 0.001  # a search need not check more finely: its motions are certified afterwards


class Cubics:
    """Cubic pieces end to end, each between its Bernstein coefficients, shape (pieces, 4, n) [rad].

    Places on it are in pieces from the start. ``travelled_rad`` bounds how far each joint has moved at each end of a
    piece, shape (pieces + 1, n); between these a straight line bounds it.
    """

    def __init__(self, coefficients: Vector) -> None:
        self.coefficients = coefficients
        # The slope of a cubic stays between its own Bernstein coefficients.
        fastest = 3.0 * np.abs(np.diff(coefficients, axis=1)).max(axis=1)
        self.travelled_rad = np.concatenate((np.zeros_like(fastest[:1]), np.cumsum(fastest, axis=0)))

    @classmethod
    def line(cls, start: Vector, end: Vector) -> Cubics:
        """Return a straight line."""
        return cls((start + np.linspace(0.0, 1.0, 4)[:, np.newaxis] * (end - start))[np.newaxis])

    def point(self, piece: int, share: float) -> Vector:
        """Return the point at a share of a piece, shape (n,) [rad]."""
        rest = 1.0 - share
        weights = (rest * rest * rest, 3.0 * share * rest * rest, 3.0 * share * share * rest, share * share * share)
        return np.asarray(np.dot(weights, self.coefficients[piece]))


def first_contact(space: JointSpace, curve: Cubics, step_m: float) -> float | None:
    """Find the first contact on a curve with free ends; parts of no more travel than ``step_m`` are not divided [m]."""
    travel_m = curve.travelled_rad @ space.travel_m_per_rad
    if travel_m[-1] <= step_m:
        return None
    looks = math.ceil(0.5 * travel_m[-1] / MARGINS_M[len(space.approach_m_per_rad) > FEW_PAIRS])
    all_places = np.interp(np.linspace(0.0, travel_m[-1], 2 * looks + 1), travel_m, np.arange(len(travel_m)))
    for first in range(0, 2 * looks, 2 * LOOKS_AT_ONCE):
        places = all_places[first : first + 2 * LOOKS_AT_ONCE + 1]
        pieces = np.minimum(places.astype(np.int64), len(curve.coefficients) - 1)
        before, after = curve.travelled_rad[pieces], curve.travelled_rad[pieces + 1]
        # How much of its clearance each pair may have lost from the start to each place, shape (places, pairs + 1).
        way_m = (before + (places - pieces)[:, np.newaxis] * (after - before)) @ space.approach_m_per_rad.T
        margins_m = np.diff(way_m, axis=0).reshape(-1, 2, way_m.shape[1]).max(axis=1)
        for i in range(1, len(places), 2):
            near = space.near(curve.point(int(pieces[i]), float(places[i] - pieces[i])), margins_m[i // 2])
            at, ways_m = places[i - 1 : i + 2], way_m[i - 1 : i + 2].T
            contacts = (_first_of_pair(space, curve, pair, at, ways_m[pair], clear_m, step_m) for pair, clear_m in near)
            found = min((place for place in contacts if place is not None), default=None)
            if found is not None:
                return found
    return None


def _first_of_pair(
    space: JointSpace, curve: Cubics, pair: int, around: Vector, around_m: Vector, clearance_m: float, step_m: float
) -> float | None:
    """Find the first contact of a pair between the first and last of three places, with its clearance in the middle."""
    first = int(around[0])
    # The same at the ends of the pieces.
    way_m = (curve.travelled_rad[first : int(around[2]) + 2] @ space.approach_m_per_rad[pair]).tolist()
    begin_m, middle_m, end_m = around_m.tolist()
    # Parts of the way, the first one last.
    left, found = [(middle_m + clearance_m, end_m), (begin_m, middle_m - clearance_m)], None
    if clearance_m <= 0.0:
        left, found, step_m = [(begin_m, middle_m)], float(around[1]), max(step_m, EARLIEST_STEP_M)
    while left:
        begin_m, end_m = left.pop()
        if end_m - begin_m <= step_m:
            continue
        middle_m = 0.5 * (begin_m + end_m)
        piece = min(bisect_right(way_m, middle_m), len(way_m) - 1) - 1
        share = (middle_m - way_m[piece]) / (way_m[piece + 1] - way_m[piece])
        clearance_m = space.clearance_m(pair, curve.point(first + piece, share), 0.5 * (end_m - begin_m))
        if clearance_m > 0.0:
            left += [(middle_m + clearance_m, end_m), (begin_m, middle_m - clearance_m)]
        else:
            left, found = [(begin_m, middle_m)], first + piece + share
            step_m = max(step_m, EARLIEST_STEP_M)
    return found


def line_free(space: JointSpace, start: Vector, end: Vector) -> bool:
    """Return true if nothing touches on a straight line whose first point is taken to be free."""
    return space.free(end) and first_contact(space, Cubics.line(start, end), CHECK_STEP_M) is None


@dataclass(frozen=True)
class Contact:
    """Something touches on a motion."""

    time_s: float  # time of the first contact [s]
    # Pairs in contact, deepest first; empty where a condition of the space does not hold, or motions only come near.
    pairs: tuple[CollidingPair, ...]


def certify(space: JointSpace, trajectory: Trajectory) -> Contact | None:
    """Return the first contact on a motion of the space's joints; None if none is deeper than half the finest step."""
    time_s = _first_contact_s(space, trajectory)
    # Hulls are wider than links: overlaps of hulls only are checked again by parts. Each turn adds a pair.
    while time_s is not None and space.refine_at(trajectory.sample(time_s)[0]):
        time_s = _first_contact_s(space, trajectory)
    return None if time_s is None else Contact(time_s, space.contacts(trajectory.sample(time_s)[0]))


def _first_contact_s(space: JointSpace, trajectory: Trajectory) -> float | None:
    positions = trajectory.positions_rad
    if not space.free(positions[0]):
        return 0.0
    if len(positions) == 1:
        return None
    at = first_contact(space, cubics(trajectory), FINEST_STEP_M)
    if at is not None:
        return float(np.interp(at, np.arange(len(positions)), trajectory.time_s))
    return None if space.free(positions[-1]) else trajectory.duration_s


def cubics(trajectory: Trajectory) -> Cubics:
    """The curve that the samples describe."""
    third_s = np.diff(trajectory.time_s)[:, np.newaxis] / 3.0
    start, end = trajectory.positions_rad[:-1], trajectory.positions_rad[1:]
    leaving = start + third_s * trajectory.velocities_rad_s[:-1]
    arriving = end - third_s * trajectory.velocities_rad_s[1:]
    return Cubics(np.stack((start, leaving, arriving, end), axis=1))


# Shapes that come nearer to each other than this count as touching [m]: it bounds the number of parts.
NEAREST_M = 0.005

# Parts that are checked at most; 20 000 checks of the 49 pairs of two arms take half a second. Two motions that need
# more run close to each other for long.
MAX_PARTS = 4000


class _Way:
    """Motion as a curve with bounds of its travel; its joints are in ``columns`` of a configuration."""

    def __init__(self, motion: Trajectory, columns: list[int]) -> None:
        self.motion, self.columns = motion, columns
        if len(motion.time_s) == 1:
            self._lower = self._upper = self._fastest = motion.positions_rad
            return
        coefficients = cubics(motion).coefficients
        self._lower, self._upper = coefficients.min(axis=1), coefficients.max(axis=1)
        # The derivative of a cubic stays between its own Bernstein coefficients as well.
        slopes = 3.0 * np.diff(coefficients, axis=1) / np.diff(motion.time_s)[:, np.newaxis, np.newaxis]
        self._fastest = np.abs(slopes).max(axis=1)

    def around(self, from_s: float, to_s: float) -> tuple[Vector, Vector]:
        """Return the middle of a part of the motion, and how far each joint may be from it there, both [rad]."""
        middle = self.motion.sample(0.5 * (from_s + to_s))[0]
        if to_s <= from_s:
            return middle, np.zeros_like(middle)
        last = len(self._lower) - 1
        first = min(int(np.searchsorted(self.motion.time_s, from_s, side="right")) - 1, last)
        end = min(int(np.searchsorted(self.motion.time_s, to_s, side="left")), last + 1)
        pieces = slice(first, max(end, first + 1))
        within = np.maximum(self._upper[pieces].max(axis=0) - middle, middle - self._lower[pieces].min(axis=0))
        return middle, np.minimum(within, 0.5 * (to_s - from_s) * self._fastest[pieces].max(axis=0))


def encounter(
    collision: CollisionModel, first: Trajectory, second: Trajectory, others_rad: Mapping[str, float]
) -> Contact | None:
    """Find where motions of different joints touch or nearly do, wherever each is on its way; None if nowhere."""
    names = collision.joint_names
    ways = [_Way(motion, [names.index(name) for name in motion.joint_names]) for motion in (first, second)]
    q = np.array([others_rad.get(name, 0.0) for name in names])
    steps = np.zeros((len(ways), len(names)))
    for row, way in enumerate(ways):
        steps[row, way.columns] = 1.0
    # Pairs whose distance depends on one motion only were checked with it.
    between = np.flatnonzero((steps @ collision.approach_m_per_rad.T > 0.0).all(axis=0)).tolist()
    parts = [((0.0, first.duration_s), (0.0, second.duration_s), between)]
    checked = 0
    while parts:
        first_s, second_s, candidates = parts.pop()
        times_s = first_s, second_s
        checked += 1
        travel = np.zeros(len(names))
        for way, span_s in zip(ways, times_s, strict=True):
            q[way.columns], travel[way.columns] = way.around(*span_s)
        clearances_m = collision.near(q, collision.approach_m_per_rad[candidates] @ travel, candidates)
        if not clearances_m:
            continue
        by_way_m = [float(travel[way.columns] @ collision.travel_m_per_rad[way.columns]) for way in ways]
        longer = int(np.argmax(by_way_m))
        touching = min(clearance_m for _, clearance_m in clearances_m) <= 0.0
        if touching or sum(by_way_m) <= NEAREST_M or checked >= MAX_PARTS:
            return Contact(0.5 * sum(first_s), tuple(collision.colliding_pairs(q)))
        begin_s, end_s = times_s[longer]
        middle_s = 0.5 * (begin_s + end_s)
        near = [pair for pair, _ in clearances_m]
        halves = (begin_s, middle_s), (middle_s, end_s)
        parts += [(half, second_s, near) if longer == 0 else (first_s, half, near) for half in halves]
    return None

"""The last check of every motion: the timed curve as it will be driven, the samples and the curve between them.

The check of a curve is a bisection with margins as wide as the shapes can move. Where no pair of shapes is nearer than
the joints can bring it on a piece of the curve, that piece is free as a whole. Other pieces are halved, and a half is
checked for the candidate pairs of the whole only: a few of many. No distance is computed: a check with a margin costs
as much as one without, and most pieces are long.

Two motions of different joints are free where they are free wherever either of them is on its way. The two are not
timed against each other: a motion can be slowed, paused, stopped and sent back at any moment. So every position of one
is checked with every position of the other: a rectangle of their times, which is divided until no shape carried by one
motion can come near a shape carried by the other, within a whole part of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.geometry.collision import CollidingPair, CollisionModel
from planners.geometry.joint_space import ALL_PAIRS, NO_CANDIDATES, WIDEST_MARGIN_M, CandidatePairs, JointSpace
from robot.trajectory import Trajectory, Vector

Indices = NDArray[np.int64]

# Contacts deeper than half of this are found: it is the width of ranges that are not halved any more.
FINEST_STEP_M = 0.0001

# After the first contact, earlier ones are searched for this finely only: enough for the time of the contact.
EARLIEST_STEP_M = 0.01

# Curves this close to a line are one: what they carry moves by less than a thousandth of the finest step.
STRAIGHT_RAD = 1e-8


class Cubics:
    """Cubic pieces end to end, each between its Bernstein coefficients, shape (pieces, 4, n) [rad]."""

    def __init__(self, coefficients: Vector) -> None:
        self.coefficients = coefficients
        self._lower, self._upper = coefficients.min(axis=1), coefficients.max(axis=1)

    def __len__(self) -> int:
        return len(self.coefficients)

    def straight(self) -> bool:
        """Tell whether the curve is a straight line from its first point to its last, run through at whatever speed."""
        start, end = self.coefficients[0, 0], self.coefficients[-1, 3]
        length = float(np.linalg.norm(end - start))
        if length == 0.0:
            return False
        from_start = self.coefficients - start
        along = from_start @ ((end - start) / length)
        beside = from_start - along[:, :, np.newaxis] * ((end - start) / length)
        outside = max(-float(along.min()), float(along.max()) - length, float(np.abs(beside).max()))
        return outside <= STRAIGHT_RAD

    def spans(self) -> Spans:
        """The whole curve as one span."""
        ranges = (len(self) - 1).bit_length()
        bounds = [(self._lower, self._upper)]
        for _ in range(ranges):
            lower, upper = (np.concatenate((each, each[-1:])) if len(each) % 2 else each for each in bounds[-1])
            bounds.append((np.minimum(lower[::2], lower[1::2]), np.maximum(upper[::2], upper[1::2])))
        if ranges == 0:
            return _Parts(self.coefficients, np.zeros(1), 1.0)
        return _Ranges(self.coefficients, bounds, np.zeros(1, dtype=np.int64))


class _Ranges:
    """Ranges of a curve, of a power of two of its pieces each; ``joint_travel`` bounds them around ``points``."""

    def __init__(self, coefficients: Vector, bounds: list[tuple[Vector, Vector]], index: Indices) -> None:
        self._coefficients, self._bounds, self._index = coefficients, bounds, index
        self._size = 1 << (len(bounds) - 1)
        first = index * self._size
        middle = np.minimum(first + self._size // 2, len(coefficients) - 1)
        self.start, self.at = first.astype(np.float64), middle.astype(np.float64)
        self.points = coefficients[middle, 0]
        lower, upper = (each[index] for each in bounds[-1])
        self.joint_travel = np.maximum(upper - self.points, self.points - lower)

    def halves(self, of: Indices) -> tuple[Spans, Indices]:
        index = np.concatenate((2 * self._index[of], 2 * self._index[of] + 1))
        there = index * (self._size // 2) < len(self._coefficients)
        index, parents = index[there], np.concatenate((of, of))[there]
        if self._size == 2:
            return _Parts(self._coefficients[index], index.astype(np.float64), 1.0), parents
        return _Ranges(self._coefficients, self._bounds[:-1], index), parents


class _Parts:
    """Ranges within single pieces, each as long as the others, by their Bernstein coefficients, shape (m, 4, n)."""

    def __init__(self, coefficients: Vector, start: Vector, length: float) -> None:
        self._coefficients, self._length = coefficients, length
        self.start, self.at = start, start + 0.5 * length
        self.points = np.array([0.125, 0.375, 0.375, 0.125]) @ coefficients
        self.joint_travel = np.abs(coefficients - self.points[:, np.newaxis]).max(axis=1)

    def halves(self, of: Indices) -> tuple[Spans, Indices]:
        # De Casteljau.
        a, b, c, d = np.moveaxis(self._coefficients[of], 1, 0)
        ab, bc, cd = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + d)
        abc, bcd = 0.5 * (ab + bc), 0.5 * (bc + cd)
        middle = 0.5 * (abc + bcd)
        halves = np.concatenate((np.stack((a, ab, abc, middle), axis=1), np.stack((middle, bcd, cd, d), axis=1)))
        length, start = 0.5 * self._length, self.start[of]
        return _Parts(halves, np.concatenate((start, start + length)), length), np.concatenate((of, of))


Spans = _Ranges | _Parts


def first_contact(space: JointSpace, curve: Cubics, step_m: float) -> float | None:
    """Find the first contact on a curve with free ends; pieces of no more travel than ``step_m`` are not halved [m]."""
    found: float | None = None
    spans = curve.spans()
    candidate_pairs: list[CandidatePairs] = [ALL_PAIRS]
    while len(spans.at):
        travel_m = spans.joint_travel @ space.travel_m_per_rad
        least_m = step_m if found is None else max(step_m, EARLIEST_STEP_M)
        checked = (2.0 * travel_m > least_m) & (spans.start < (np.inf if found is None else found))
        # Something is near the widest spans nearly always: these keep their candidate pairs.
        narrow = np.flatnonzero(checked & (travel_m <= WIDEST_MARGIN_M))
        among = [candidate_pairs[i] for i in narrow]
        left = space.candidate_pairs(spans.points[narrow], spans.joint_travel[narrow], among)
        for i, candidates in zip(narrow, left, strict=True):
            candidate_pairs[i] = candidates
        unsure = [i for i in np.flatnonzero(checked) if candidate_pairs[i] != NO_CANDIDATES]
        for i in unsure:
            if (found is None or spans.at[i] < found) and space.touches_any(spans.points[i], candidate_pairs[i]):
                found = float(spans.at[i])
        spans, parents = spans.halves(np.array(unsure, dtype=np.int64))
        candidate_pairs = [candidate_pairs[i] for i in parents]
    return found


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
    curve = cubics(trajectory)
    if curve.straight() and space.line_free(positions[0], positions[-1], FINEST_STEP_M):
        return None
    at = first_contact(space, curve, FINEST_STEP_M)
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
    between = tuple(np.flatnonzero((collision.margins_m(steps) > 0.0).all(axis=0)).tolist())
    parts = [((0.0, first.duration_s), (0.0, second.duration_s), between)]
    checked = 0
    while parts:
        first_s, second_s, candidates = parts.pop()
        times_s = first_s, second_s
        checked += 1
        travel = np.zeros(len(names))
        for way, span_s in zip(ways, times_s, strict=True):
            q[way.columns], travel[way.columns] = way.around(*span_s)
        margins_m = collision.margins_m(travel[np.newaxis])[0]
        near = collision.candidate_pairs(q, margins_m, candidates)
        if not near:
            continue
        by_way_m = [float(travel[way.columns] @ collision.travel_m_per_rad[way.columns]) for way in ways]
        longer = int(np.argmax(by_way_m))
        if collision.touch_among(q, near) or sum(by_way_m) <= NEAREST_M or checked >= MAX_PARTS:
            return Contact(0.5 * sum(first_s), tuple(collision.colliding_pairs(q)))
        begin_s, end_s = times_s[longer]
        middle_s = 0.5 * (begin_s + end_s)
        halves = (begin_s, middle_s), (middle_s, end_s)
        parts += [(half, second_s, near) if longer == 0 else (first_s, half, near) for half in halves]
    return None

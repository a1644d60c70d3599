"""Continuous collision check of lines and curves: bisection with margins as wide as the shapes can move.

Where no pair of shapes is nearer than the joints can bring it on a piece of the curve, that piece is free as a whole.
Other pieces are halved, and a half is checked for the candidate pairs of the whole only: a few of many. No distance is
computed: a check with a margin costs as much as one without, and most pieces are long.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robot.trajectory import Vector

if TYPE_CHECKING:
    from planners.geometry.joint_space import JointSpace

Indices = NDArray[np.int64]

# Pairs that can touch within a range, by their indices; ALL_PAIRS before the first check.
CandidatePairs = tuple[int, ...] | None
ALL_PAIRS: None = None
NO_CANDIDATES: CandidatePairs = ()

# Contacts deeper than half of this are found: it is the width of ranges that are not halved any more.
FINEST_STEP_M = 0.0001

WIDEST_MARGIN_M = 0.1  # on longer pieces than this only the middle is checked

# After the first contact, earlier ones are searched for this finely only: enough for the time of the contact.
EARLIEST_STEP_M = 0.01

# Curves this close to a line are one: what they carry moves by less than a thousandth of the finest step.
STRAIGHT_RAD = 1e-8


class Cubics:
    """Cubic pieces end to end, by their Bernstein coefficients, shape (pieces, 4, n) [rad].

    Each piece stays between its coefficients.
    """

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
    """Ranges of a curve, each of a power of two of its pieces, by the pieces' bounds for each power.

    Ranges begin at ``start`` and have their ``points``, shape (m, n) [rad], ``at`` places in pieces of the curve.
    Joints may be ``joint_travel`` away from the points within the range, shape (m, n) [rad].
    """

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


def line_is_free(space: JointSpace, start: Vector, end: Vector, step_m: float) -> bool:
    """Return true if nothing touches on a straight line whose first point is taken to be free.

    On pieces along which nothing moves more than ``step_m`` only the ends are checked [m]. All pieces of a line are
    alike, so this takes half the time of :func:`first_contact`, and most motions are lines.
    """
    if not space.free(end):
        return False
    joint_travel = 0.5 * np.abs(end - start)
    travel_m = float(joint_travel @ space.travel_m_per_rad)
    at, half = np.array([0.5]), 0.5
    candidate_pairs: list[CandidatePairs] = [ALL_PAIRS]
    while len(at) and 2.0 * travel_m > step_m:
        points = start + at[:, np.newaxis] * (end - start)
        # Something is near the widest pieces nearly always: these keep their candidate pairs.
        if travel_m <= WIDEST_MARGIN_M:
            candidate_pairs = space.candidate_pairs(points, np.tile(joint_travel, (len(at), 1)), candidate_pairs)
            unsure = [i for i, candidates in enumerate(candidate_pairs) if candidates != NO_CANDIDATES]
            at, points, candidate_pairs = at[unsure], points[unsure], [candidate_pairs[i] for i in unsure]
        if any(space.touches_any(point, candidates) for point, candidates in zip(points, candidate_pairs, strict=True)):
            return False
        half, joint_travel, travel_m = 0.5 * half, 0.5 * joint_travel, 0.5 * travel_m
        at, candidate_pairs = np.concatenate((at - half, at + half)), candidate_pairs + candidate_pairs
    return True


def first_contact(space: JointSpace, curve: Cubics, step_m: float) -> float | None:
    """Find the first contact on a curve, coarse to fine, in pieces from the start; the ends are taken to be free.

    Pieces along which nothing moves more than ``step_m`` are not halved any more [m].
    """
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

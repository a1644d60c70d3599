"""Is a curve free between its points? Bisection with margins as wide as things can move.

Where nothing is nearer to anything than the joints can bring it on a piece of the curve, that piece is free as a whole.
Pieces of which that cannot be said are halved. No distance is computed: a check with a margin costs as much as one
without, and most pieces are long.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

# Contacts deeper than half of this are found: the range between two free checks that nothing more is asked about.
FINEST_STEP_M = 0.0001

# On longer pieces than this something is near nearly always: only their middle is looked at.
WIDEST_MARGIN_M = 0.1


# Once there is a contact, earlier ones are looked for this finely only: it is said when, and that is a sample's time.
EARLIEST_STEP_M = 0.01

# Curves this close to a line are one: what they carry moves by less than a thousandth of the finest step.
STRAIGHT_RAD = 1e-8


class Surroundings(Protocol):
    """What is asked about points, shape (n,) [rad]."""

    @property
    def travel_m_per_rad(self) -> Vector:
        """The most that anything moves per motion of each joint, shape (n,)."""
        ...

    def free(self, point: Vector) -> bool:
        """Whether nothing touches at a point."""
        ...

    def free_around(self, points: Vector, joint_travel: Vector) -> list[bool]:
        """Around which points, shape (m, n), nothing can touch within a range of each joint, shape (n,) [rad]."""
        ...


def line_is_free(around: Surroundings, start: Vector, end: Vector, step_m: float) -> bool:
    """Whether nothing touches on a straight line.

    Args:
        around: what there is to touch.
        start: first point, taken to be free.
        end: last point, checked as well.
        step_m: on pieces along which nothing moves more than this only the ends are checked [m].
    """
    if not around.free(end):
        return False
    joint_travel = 0.5 * np.abs(end - start)
    travel_m = float(joint_travel @ around.travel_m_per_rad)
    at, half = np.array([0.5]), 0.5
    while len(at) and 2.0 * travel_m > step_m:
        points = start + at[:, np.newaxis] * (end - start)
        if travel_m <= WIDEST_MARGIN_M:
            unsure = np.logical_not(around.free_around(points, joint_travel))
            at, points = at[unsure], points[unsure]
        if not all(around.free(point) for point in points):
            return False
        half, joint_travel, travel_m = 0.5 * half, 0.5 * joint_travel, 0.5 * travel_m
        at = np.concatenate((at - half, at + half))
    return True


class Cubics:
    """Cubic pieces end to end, by their Bernstein coefficients, between which each piece stays.

    Args:
        coefficients: shape (pieces, 4, n) [rad]; each piece starts where the one before ends.
    """

    def __init__(self, coefficients: Vector) -> None:
        self.coefficients = coefficients
        self._lower, self._upper = coefficients.min(axis=1), coefficients.max(axis=1)

    def __len__(self) -> int:
        return len(self.coefficients)

    def straight(self) -> bool:
        """Whether the curve is a straight line from its first point to its last, run through at whatever speed."""
        start, end = self.coefficients[0, 0], self.coefficients[-1, 3]
        length = float(np.linalg.norm(end - start))
        if length == 0.0:
            return False
        from_start = self.coefficients - start
        along = from_start @ ((end - start) / length)
        beside = from_start - along[:, :, np.newaxis] * ((end - start) / length)
        outside = max(-float(along.min()), float(along.max()) - length, float(np.abs(beside).max()))
        return outside <= STRAIGHT_RAD

    def middle(self, first: int, last: int) -> tuple[Vector, Vector]:
        """A point of the pieces from ``first`` up to ``last``, and how far each joint may be from it on them."""
        if last - first == 1:
            point = np.array([0.125, 0.375, 0.375, 0.125]) @ self.coefficients[first]
        else:
            point = self.coefficients[(first + last) // 2, 0]
        lower, upper = self._lower[first:last].min(axis=0), self._upper[first:last].max(axis=0)
        return point, np.maximum(upper - point, point - lower)

    def halves(self, piece: int) -> Cubics:
        """One piece as two, each of half its range (de Casteljau)."""
        a, b, c, d = self.coefficients[piece]
        ab, bc, cd = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + d)
        abc, bcd = 0.5 * (ab + bc), 0.5 * (bc + cd)
        middle = 0.5 * (abc + bcd)
        return Cubics(np.array([[a, ab, abc, middle], [middle, bcd, cd, d]]))


def first_contact(around: Surroundings, curve: Cubics, step_m: float, *, earliest: bool) -> float | None:
    """Where something touches on a curve, coarse to fine; the ends are taken to be free.

    Args:
        around: what there is to touch.
        curve: the curve.
        step_m: on pieces along which nothing moves more than this only the ends are checked [m].
        earliest: whether the first contact on the way is wanted, or any.

    Returns:
        In pieces from the start, or None.
    """
    found: float | None = None
    todo = deque([(curve, 0, len(curve), 0.0, 1.0)])
    while todo:
        part, first, last, origin, scale = todo.popleft()
        if found is not None and origin + first * scale >= found:
            continue
        point, joint_travel = part.middle(first, last)
        travel_m = float(joint_travel @ around.travel_m_per_rad)
        if travel_m <= WIDEST_MARGIN_M and around.free_around(point[np.newaxis], joint_travel)[0]:
            continue
        single = last - first == 1
        at = origin + scale * (first + 0.5 if single else (first + last) // 2)
        if not around.free(point) and (found is None or at < found):
            if not earliest:
                return at
            found = at
        if 2.0 * travel_m <= (step_m if found is None else max(step_m, EARLIEST_STEP_M)):
            continue
        if single:
            part, origin, scale, first, last = part.halves(first), origin + scale * first, 0.5 * scale, 0, 2
        cut = (first + last) // 2
        todo += [(part, first, cut, origin, scale), (part, cut, last, origin, scale)]
    return found

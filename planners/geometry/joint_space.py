"""The joints that move, and which of their configurations and lines are free."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from planners.budget import never
from planners.errors import StoppedError
from planners.geometry.collision import DEPTH_ACCURACY_M, NO_CONTACT, CollidingPair, CollisionModel
from robot.trajectory import Vector

# Pairs that can touch within a range, by their indices; ALL_PAIRS before the first check.
CandidatePairs = tuple[int, ...] | None
ALL_PAIRS: None = None
NO_CANDIDATES: CandidatePairs = ()

WIDEST_MARGIN_M = 0.1  # on longer pieces of a line or curve than this only the middle is checked
CHECK_STEP_M = 0.001  # a search need not check more finely: its motions are certified afterwards

# An allowed overlap has to shrink by this share of the way from where it was allowed, so that it is left and does not
# come again further on, where the same depth of parts wider than the links would be a contact of the links themselves.
LEAVING = 0.05

# Conditions have no margin as contacts have, so they are checked this often, in travel of the fastest point.
CONDITION_STEP_M = 0.01

CONDITION = -1  # stands for the condition among the candidate pairs of a range


class JointSpace:
    """Some joints, and which of their configurations and lines are free; ``checks`` counts the checks so far.

    Points of this space have the positions of ``joint_names``, shape (n,) [rad]; other joints stay at ``start_q``.
    Pairs of names in ``allowed`` may overlap near the start, less and less, with their depth there [m]. Free points
    also meet the condition ``holds``. ``also_free`` are configurations beside the start, such as goals, that touch
    nothing although hulls may overlap there; with the start they determine the pairs that are checked by their parts.
    ``should_stop`` ends long checks with :exc:`StoppedError`: certifying a motion close to a contact can take seconds.

    ``start`` is the point of ``start_q``. ``travel_m_per_rad`` is the most that any robot point moves per motion of
    each joint, shape (n,).
    """

    def __init__(
        self,
        collision: CollisionModel,
        joint_names: Sequence[str],
        start_q: Vector,
        allowed: Mapping[frozenset[str], float] = NO_CONTACT,
        holds: Callable[[Vector], bool] | None = None,
        also_free: Sequence[Vector] = (),
        should_stop: Callable[[], bool] = never,
    ) -> None:
        self._collision = collision
        columns = np.array([collision.joint_names.index(name) for name in joint_names])
        # A slice is quicker.
        adjacent = bool(np.all(np.diff(columns) == 1))
        self._columns = slice(int(columns[0]), int(columns[-1]) + 1) if adjacent else columns
        self._q = start_q.copy()
        self._allowed = allowed
        # What overlaps at the start is left in the parts long before it is in the hulls.
        self._refined = set(allowed)
        for q in (start_q, *also_free):
            self._refined |= collision.hull_only_pairs(q)
        self._holds = holds
        self._should_stop = should_stop
        self.checks = 0
        self.start = self.point(start_q).copy()
        self.lower_rad = collision.lower_rad[self._columns]
        self.upper_rad = collision.upper_rad[self._columns]
        self.travel_m_per_rad = collision.travel_m_per_rad[self._columns]

    def point(self, q: Vector) -> Vector:
        """The joints' part of a configuration."""
        return np.asarray(q[self._columns])

    def configuration(self, point: Vector) -> Vector:
        """Return the configuration of all joints at a point."""
        q = self._q.copy()
        q[self._columns] = point
        return q

    def free(self, point: Vector | Sequence[float]) -> bool:
        """Tell whether the robot touches nothing there, and the condition holds."""
        self.checks += 1
        self._q[self._columns] = point
        allowed = self._allowed and self._allowed_near(np.abs(point - self.start))
        if self._collision.in_collision(self._q, allowed, self._refined):
            return False
        return self._holds is None or self._holds(self._q)

    def candidate_pairs(
        self, points: Vector, joint_travel: Vector, among: Sequence[CandidatePairs]
    ) -> list[CandidatePairs]:
        """Return the pairs that can touch, and the condition, over a range of the joints around each point.

        Points and the greatest ``joint_travel`` from each have the shape (m, n) [rad]. For each point ``among`` has the
        candidate pairs of a range that contains this one; no others are checked. A range without candidate pairs is
        free.
        """
        self.checks += len(points)
        configurations, travel = np.tile(self._q, (len(points), 1)), np.zeros((len(points), len(self._q)))
        configurations[:, self._columns] = points
        travel[:, self._columns] = joint_travel
        margins_m = self._collision.margins_m(travel)
        away = joint_travel + np.abs(points - self.start)
        found: list[CandidatePairs] = []
        for i, q in enumerate(configurations):
            allowed = self._allowed and self._allowed_near(away[i])
            known = among[i]
            # What takes long here is a large scene as a whole, and parts.
            if (known is ALL_PAIRS or self._refined) and self._should_stop():
                raise StoppedError
            pairs = self._collision.candidate_pairs(q, margins_m[i], known and _pairs(known), allowed, self._refined)
            found.append(pairs if self._holds_around(q, joint_travel[i], among[i]) else (*pairs, CONDITION))
        return found

    def touches_any(self, point: Vector, among: CandidatePairs) -> bool:
        """Tell whether any candidate pair of a range touches at a point of the range."""
        if among is ALL_PAIRS:
            return not self.free(point)
        self.checks += 1
        self._q[self._columns] = point
        allowed = self._allowed and self._allowed_near(np.abs(point - self.start))
        if self._collision.touch_among(self._q, _pairs(among), allowed, self._refined):
            return True
        return self._holds is not None and CONDITION in among and not self._holds(self._q)

    def line_free(self, start: Vector, end: Vector, step_m: float = CHECK_STEP_M) -> bool:
        """Return true if nothing touches on a straight line whose first point is taken to be free.

        On pieces along which nothing moves more than ``step_m`` only the ends are checked [m]. All pieces of a line are
        alike, so this takes half the time of a check as a curve, and most motions are lines.
        """
        if not self.free(end):
            return False
        joint_travel = 0.5 * np.abs(end - start)
        travel_m = float(joint_travel @ self.travel_m_per_rad)
        at, half = np.array([0.5]), 0.5
        candidate_pairs: list[CandidatePairs] = [ALL_PAIRS]
        while len(at) and 2.0 * travel_m > step_m:
            points = start + at[:, np.newaxis] * (end - start)
            # Something is near the widest pieces nearly always: these keep their candidate pairs.
            if travel_m <= WIDEST_MARGIN_M:
                candidate_pairs = self.candidate_pairs(points, np.tile(joint_travel, (len(at), 1)), candidate_pairs)
                unsure = [i for i, candidates in enumerate(candidate_pairs) if candidates != NO_CANDIDATES]
                at, points, candidate_pairs = at[unsure], points[unsure], [candidate_pairs[i] for i in unsure]
            if any(self.touches_any(point, near) for point, near in zip(points, candidate_pairs, strict=True)):
                return False
            half, joint_travel, travel_m = 0.5 * half, 0.5 * joint_travel, 0.5 * travel_m
            at, candidate_pairs = np.concatenate((at - half, at + half)), candidate_pairs + candidate_pairs
        return True

    def refine_at(self, point: Vector) -> bool:
        """Let parts decide from now on where only hulls touch at a point; return true if any pair is new."""
        self._q[self._columns] = point
        new = self._collision.hull_only_pairs(self._q) - self._refined
        self._refined |= new
        return bool(new)

    def free_by_parts(self, point: Vector) -> bool:
        """Return true if the robot touches nothing there, by the parts where only hulls touch."""
        return self.free(point) or (self.refine_at(point) and self.free(point))

    def contacts(self, point: Vector) -> tuple[CollidingPair, ...]:
        """Return the forbidden contacts at a point, deepest first."""
        self._q[self._columns] = point
        pairs = self._collision.colliding_pairs(self._q, self._refined)
        allowed = self._allowed_near(np.abs(point - self.start))
        if not allowed:
            return tuple(pairs)
        overlaps_m = self._collision.overlaps_m(self._q)
        return tuple(
            pair
            for pair in pairs
            if pair.links not in allowed or overlaps_m.get(pair.links, 0.0) > allowed[pair.links] + DEPTH_ACCURACY_M
        )

    def _holds_around(self, q: Vector, joint_travel: Vector, among: CandidatePairs) -> bool:
        """Tell whether the condition holds where the joints move by so much at most, shape (n,) [rad]."""
        if self._holds is None or (among is not ALL_PAIRS and CONDITION not in among):
            return True
        return bool(joint_travel @ self.travel_m_per_rad <= CONDITION_STEP_M) and self._holds(q)

    def _allowed_near(self, joint_travel: Vector) -> dict[frozenset[str], float]:
        """Return the overlaps that are still allowed, with depths, at a distance from the start, shape (n,) [rad]."""
        shrunk_m = LEAVING * float(joint_travel @ self.travel_m_per_rad)
        left_m = {names: depth_m - shrunk_m for names, depth_m in self._allowed.items()}
        return {names: depth_m for names, depth_m in left_m.items() if depth_m > -DEPTH_ACCURACY_M}


def _pairs(candidate_pairs: tuple[int, ...]) -> tuple[int, ...]:
    """Return the candidate pairs of a range without the condition."""
    return candidate_pairs[:-1] if candidate_pairs[-1:] == (CONDITION,) else candidate_pairs

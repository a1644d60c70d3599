"""The joints that move, and which of their configurations and lines are free."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from planners.budget import never
from planners.errors import StoppedError
from planners.geometry.collision import DEPTH_ACCURACY_M, NO_CONTACT, CollidingPair, CollisionModel
from robot.trajectory import Vector

# An allowed overlap has to shrink by this share of the way from where it was allowed, so that it is left and does not
# come again further on, where the same depth of parts wider than the links would be a contact of the links themselves.
LEAVING = 0.05

# Conditions have no margin as contacts have, so they are checked this often, in travel of the fastest point.
CONDITION_STEP_M = 0.01

CONDITION = -1  # stands for the condition among the pairs


class JointSpace:
    """Some joints, and which of their configurations and lines are free; ``checks`` counts the checks so far.

    Points of this space have the positions of ``joint_names``, shape (n,) [rad]; other joints stay at ``start_q``.
    Pairs of names in ``allowed`` may overlap near the start, less and less, with their depth there [m]. Free points
    also meet the condition ``holds``. ``also_free`` are configurations beside the start, such as goals, that touch
    nothing although hulls may overlap there; with the start they determine the pairs that are checked by their parts.
    ``should_stop`` ends long checks with :exc:`StoppedError`: certifying a motion close to a contact can take seconds.

    ``start`` is the point of ``start_q``. ``travel_m_per_rad`` is the most that any robot point moves per motion of
    each joint, shape (n,). ``approach_m_per_rad`` is the most by which each pair loses clearance, and in the last row
    the condition, shape (pairs + 1, n).
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
        self._refined_pairs = frozenset(collision.pairs_of(self._refined))
        self._holds = holds
        self._should_stop = should_stop
        self.checks = 0
        self.start = self.point(start_q).copy()
        self.lower_rad = collision.lower_rad[self._columns]
        self.upper_rad = collision.upper_rad[self._columns]
        self.travel_m_per_rad = collision.travel_m_per_rad[self._columns]
        rows = np.vstack((collision.approach_m_per_rad[:, self._columns], self.travel_m_per_rad))
        # What may overlap near the start may overlap the less the further the joints have moved.
        rows[collision.pairs_of(allowed)] += LEAVING * self.travel_m_per_rad
        self.approach_m_per_rad = rows

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
        if self._collision.in_collision(self._q, self._refined_pairs, allowed):
            return False
        return self._holds is None or self._holds(self._q)

    def near(self, point: Vector, margin_m: Vector) -> list[tuple[int, float]]:
        """Return the pairs that have less clearance at a point than margins, shape (pairs + 1,), and the clearance [m].

        In contact it is 0 or less. The condition counts as a pair, with the index :data:`CONDITION`.
        """
        self.checks += 1
        # What takes long here is a large scene as a whole, and parts.
        if self._should_stop():
            raise StoppedError
        self._q[self._columns] = point
        found = self._collision.near(self._q, margin_m[:-1])
        for i, (pair, _) in enumerate(found) if self._refined_pairs else ():
            if pair in self._refined_pairs:
                found[i] = pair, self._by_parts_m(pair, point, float(margin_m[pair]))
        if self._holds is not None:
            found.append((CONDITION, self._clearance_of_condition()))
        return found

    def clearance_m(self, pair: int, point: Vector, margin_m: float) -> float:
        """Return a pair's clearance at a point, or ``margin_m`` where it has at least as much; see :meth:`near` [m]."""
        self.checks += 1
        self._q[self._columns] = point
        if pair == CONDITION:
            return self._clearance_of_condition()
        if pair in self._refined_pairs:
            return self._by_parts_m(pair, point, margin_m)
        return self._collision.clearance_m(self._q, pair, margin_m)

    def _by_parts_m(self, pair: int, point: Vector, margin_m: float) -> float:
        # Parts take long.
        if self._should_stop():
            raise StoppedError
        allowed = self._allowed_near(np.abs(point - self.start))
        return self._collision.refined_clearance_m(self._q, pair, margin_m, allowed)

    def _clearance_of_condition(self) -> float:
        return CONDITION_STEP_M if self._holds is None or self._holds(self._q) else 0.0

    def refine_at(self, point: Vector) -> bool:
        """Let parts decide from now on where only hulls touch at a point; return true if any pair is new."""
        self._q[self._columns] = point
        new = self._collision.hull_only_pairs(self._q) - self._refined
        self._refined |= new
        self._refined_pairs = frozenset(self._collision.pairs_of(self._refined))
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

    def _allowed_near(self, joint_travel: Vector) -> dict[frozenset[str], float]:
        """Return the overlaps that are still allowed, with depths, at a distance from the start, shape (n,) [rad]."""
        shrunk_m = LEAVING * float(joint_travel @ self.travel_m_per_rad)
        left_m = {names: depth_m - shrunk_m for names, depth_m in self._allowed.items()}
        return {names: depth_m for names, depth_m in left_m.items() if depth_m > -DEPTH_ACCURACY_M}

"""The joints that move, and which of their configurations and lines are free."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob

from planners.collision import NO_CONTACT, CollisionModel
from robot.model import Group

Vector = NDArray[np.float64]

# Links are centimetres thick and their hulls reach a few millimetres beyond them, so a contact between two checks
# this far apart stays in the hulls' margin.
CHECK_STEP_M = 0.005


class JointSpace:
    """The joints of a group, and which of their configurations and lines are free.

    Args:
        collision: the robot's collisions.
        group: the joints that move; points of this space have them in this order, shape (n,) [rad].
        start_q: configuration of all joints; those outside the group stay there.
        allowed: pairs of links that may overlap, and how deep [m].
    """

    def __init__(
        self,
        collision: CollisionModel,
        group: Group,
        start_q: Vector,
        allowed: Mapping[frozenset[str], float] = NO_CONTACT,
    ) -> None:
        self._collision = collision
        self._columns = np.array([collision.joint_names.index(name) for name in group.joints])
        self._q = start_q.copy()
        self._allowed = allowed
        self.lower_rad = collision.lower_rad[self._columns]
        self.upper_rad = collision.upper_rad[self._columns]
        self._travel_m_per_rad = collision.travel_m_per_rad[self._columns]

    def point(self, q: Vector) -> Vector:
        """The group's part of a configuration."""
        part: Vector = q[self._columns]
        return part

    def free(self, point: Vector | Sequence[float]) -> bool:
        """Whether the robot touches nothing there."""
        self._q[self._columns] = point
        return not self._collision.in_collision(self._q, self._allowed)

    def line_free(self, start: Vector, end: Vector, step_m: float = CHECK_STEP_M) -> bool:
        """Whether the robot touches nothing on a straight line.

        Args:
            start: first point, taken to be free.
            end: last point, checked as well.
            step_m: the most that any robot point moves from one check to the next [m].
        """
        return self.curve_free(np.array([start, end]), step_m)

    def curve_free(self, points: Vector, step_m: float = CHECK_STEP_M) -> bool:
        """Whether the robot touches nothing along a polyline.

        Args:
            points: shape (m, n); the first is taken to be free, the last is checked.
            step_m: the most that any robot point moves from one check to the next [m].
        """
        moved_m = np.cumsum(np.abs(np.diff(points, axis=0)) @ self._travel_m_per_rad)
        travel_m = np.concatenate(([0.0], moved_m))
        count = max(1, int(np.ceil(travel_m[-1] / step_m)))
        checks_m = np.arange(count + 1) * (travel_m[-1] / count)
        checked = np.stack([np.interp(checks_m, travel_m, joint) for joint in points.T], axis=1)
        return all(self.free(checked[i]) for i in coarse_to_fine(count))

    def space(self) -> ob.RealVectorStateSpace:
        """This space as OMPL sees it, with edge checks no further apart than :data:`CHECK_STEP_M`."""
        space = ob.RealVectorStateSpace(len(self._columns))
        bounds = ob.RealVectorBounds(len(self._columns))
        for i, (lower, upper) in enumerate(zip(self.lower_rad, self.upper_rad, strict=True)):
            bounds.setLow(i, float(lower))
            bounds.setHigh(i, float(upper))
        space.setBounds(bounds)
        # OMPL measures lines by their Euclidean length; no point travels more than |travel| times that.
        step_rad = CHECK_STEP_M / float(np.linalg.norm(self._travel_m_per_rad))
        space.setLongestValidSegmentFraction(step_rad / space.getMaximumExtent())
        return space


def coarse_to_fine(count: int) -> Iterator[int]:
    """1 to ``count``, each once: the last first, then halves, quarters and so on, to find out early what is blocked."""
    yield count
    stride = 1 << (count - 1).bit_length()
    while stride > 1:
        yield from range(stride // 2, count, stride)
        stride //= 2

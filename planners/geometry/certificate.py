"""The last check of every motion: the timed curve as it will be driven, the samples and the curve between them.

Two motions of different joints are free where they are free wherever either of them is on its way. The two are not
timed against each other: a motion can be slowed, paused, stopped and sent back at any moment. So every position of one
is checked with every position of the other: a rectangle of their times, which is divided until no shape carried by one
motion can come near a shape carried by the other, within a whole part of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planners.geometry.collision import CollidingPair, CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.geometry.sweep import FINEST_STEP_M, Cubics, first_contact
from robot.trajectory import Trajectory, Vector


@dataclass(frozen=True)
class Contact:
    """Something touches on a motion."""

    time_s: float  # time of the first contact [s]
    # Pairs in contact, deepest first; empty where a condition of the space does not hold.
    pairs: tuple[CollidingPair, ...]


def certify(space: JointSpace, trajectory: Trajectory) -> Contact | None:
    """Return the first contact on a motion, also between its samples, as :meth:`Trajectory.sample` joins them.

    None certifies the motion: no point of it is in contact, or by at most half of :data:`FINEST_STEP_M`. The motion has
    the joints of the space, in the same order.
    """
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


@dataclass(frozen=True)
class Encounter:
    """Two motions that may touch each other."""

    first_s: float  # time on the first one [s]
    second_s: float  # time on the second one [s]
    pairs: tuple[CollidingPair, ...]  # shapes in contact there, deepest first; empty where they only come near


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
) -> Encounter | None:
    """Find where two motions of different joints touch or come as near as `NEAREST_M`.

    Contacts of one motion alone are left out. Returns None if they cannot, at whatever speed each is played.
    ``others_rad`` has every joint that is in neither.
    """
    names = collision.joint_names
    ways = [_Way(motion, [names.index(name) for name in motion.joint_names]) for motion in (first, second)]
    q = np.array([others_rad.get(name, 0.0) for name in names])
    parts = [((0.0, first.duration_s), (0.0, second.duration_s), _pairs_between(collision, ways))]
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
            return Encounter(0.5 * sum(first_s), 0.5 * sum(second_s), tuple(collision.colliding_pairs(q)))
        begin_s, end_s = times_s[longer]
        middle_s = 0.5 * (begin_s + end_s)
        halves = (begin_s, middle_s), (middle_s, end_s)
        parts += [(half, second_s, near) if longer == 0 else (first_s, half, near) for half in halves]
    return None


def _pairs_between(collision: CollisionModel, ways: list[_Way]) -> tuple[int, ...]:
    """Return the pairs of shapes whose distance depends on both motions; others were checked with each motion."""
    steps = np.zeros((len(ways), len(collision.joint_names)))
    for row, way in enumerate(ways):
        steps[row, way.columns] = 1.0
    moved = collision.margins_m(steps) > 0.0
    return tuple(np.flatnonzero(moved.all(axis=0)).tolist())

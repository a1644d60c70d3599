"""How much has been looked at: the measure of a search's work, which is the same on every machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from planners.geometry.joint_space import JointSpace
from planners.geometry.sweep import ANYTHING, NOTHING, Threats, line_is_free
from planners.motions.curve import Curve

Vector = NDArray[np.float64]

# Checks a second on the machine that the optimisation time is meant for, all that goes with them included.
NOMINAL_CHECKS_PER_S = 30_000

# On longer pieces than this something is near nearly always: only their middle is looked at.
WIDEST_MARGIN_M = 0.05


def checks_in(time_s: float) -> int:
    """The checks that so much time is worth."""
    return int(time_s * NOMINAL_CHECKS_PER_S)


@lru_cache
def coarse_first(pieces: int) -> Vector:
    """Where a line of so many pieces has the ends of its pieces but its start, shape (pieces, 1).

    The end comes first, and the others so that they are spread well at any time: what is in the way is found soon.
    """
    bits = pieces.bit_length()
    turned = [int(f"{i:0{bits}b}"[::-1], 2) for i in range(pieces)]
    shares = 1.0 - np.argsort(turned)[:, np.newaxis] / pieces
    shares.flags.writeable = False
    return shares


class CountedSpace:
    """A joint space that counts the configurations it is asked about.

    Args:
        space: the joints that move, and what they must not touch.
        should_stop: once true, no line or curve is called free any more: long ones take longer than a cancel may.

    Attributes:
        checks: how many questions were answered so far.
        travel_m_per_rad: the most that anything moves per motion of each joint, shape (n,).
        lower_rad: shape (n,), lower position limits.
        upper_rad: shape (n,), upper position limits.
    """

    def __init__(self, space: JointSpace, should_stop: Callable[[], bool] = lambda: False) -> None:
        self._space = space
        self._should_stop = should_stop
        self.checks = 0
        self.travel_m_per_rad = space.travel_m_per_rad
        self.lower_rad = space.lower_rad
        self.upper_rad = space.upper_rad

    def free(self, point: Vector | Sequence[float]) -> bool:
        """Whether nothing touches at a point."""
        self.checks += 1
        return self._space.free(point)

    def threats(self, points: Vector, joint_travel: Vector, among: Sequence[Threats]) -> list[Threats]:
        """As :meth:`JointSpace.threats`."""
        self.checks += len(points)
        return self._space.threats(points, joint_travel, among)

    def touches_any(self, point: Vector, among: Threats) -> bool:
        """As :meth:`JointSpace.touches_any`."""
        self.checks += 1
        return self._space.touches_any(point, among)

    def line_free(self, start: Vector, end: Vector, step_m: float) -> bool:
        """As :meth:`JointSpace.line_free`."""
        return not self._should_stop() and line_is_free(self, start, end, step_m)

    def glance(self, start: Vector, end: Vector, step_m: float) -> bool:
        """Whether nothing touches in points of a straight line.

        Args:
            start: first point, taken to be free.
            end: last point, looked at as well.
            step_m: nothing moves further than this from one point to the next [m].
        """
        travel_m = float(np.abs(end - start) @ self.travel_m_per_rad)
        points = start + coarse_first(max(1, int(np.ceil(travel_m / step_m)))) * (end - start)
        return all(self.free(point) for point in points)

    def curve_free(self, curve: Curve, step_m: float) -> bool:
        """Whether all joints stay in their ranges and nothing touches along a curve; its ends are taken to be free.

        Args:
            curve: the curve.
            step_m: nothing more is asked between two free points between which about so much is moved [m].
        """
        if not curve.stays_within(self.lower_rad, self.upper_rad):
            return False
        points = self._evenly(curve, step_m)
        half = len(points) // 2
        middles = np.array([half])
        threats: list[Threats] = [ANYTHING]
        while half and len(middles):
            here = points[middles]
            joint_travel = np.maximum(np.abs(points[middles - half] - here), np.abs(points[middles + half] - here))
            if np.max(joint_travel @ self.travel_m_per_rad) <= WIDEST_MARGIN_M:
                threats = self.threats(here, joint_travel, threats)
                unsure = [i for i, threat in enumerate(threats) if threat != NOTHING]
                middles, threats = middles[unsure], [threats[i] for i in unsure]
            touching = (self.touches_any(points[i], threat) for i, threat in zip(middles, threats, strict=True))
            if self._should_stop() or any(touching):
                return False
            half //= 2
            middles, threats = np.concatenate((middles - half, middles + half)), threats + threats
        return True

    def _evenly(self, curve: Curve, step_m: float) -> Vector:
        """Points on the curve, a power of two and one, between which the same is moved, at most a step."""
        ticks = curve.sample_ticks()
        moved_m = np.abs(np.diff(curve.at(ticks)[0], axis=0)) @ self.travel_m_per_rad
        travel_m = np.concatenate(([0.0], np.cumsum(moved_m)))
        pieces = 1 << max(0, int(np.ceil(np.log2(max(travel_m[-1], step_m) / step_m))))
        return curve.at(np.interp(np.linspace(0.0, travel_m[-1], pieces + 1), travel_m, ticks))[0]

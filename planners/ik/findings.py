"""What the descents of one question came to."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.geometry.collision import CollidingPair, CollisionModel
from planners.geometry.forward import ForwardKinematics
from planners.ik.conditions import ROTATION_ARM_M
from planners.ik.constraints import ConditionSet, Wish
from planners.problem import Deviation

Vector = NDArray[np.float64]

# After so many restarts without a new solution, when there is one, more rarely find any.
FRUITLESS_RESTARTS = 6

# A wish that so many restarts one after the other come no nearer to is out of reach; of 1000 poses within reach none
# needed more.
HOPELESS_RESTARTS = 20
NEARER_M = 0.001

# Solutions closer than this to a known one in every joint are the same.
DISTINCT_RAD = 0.1

# More goals than this hardly shorten the motion.
MAX_SOLUTIONS = 6

# Of what is preferred, this much more is as good as the best: below what a servo arm shows.
AS_GOOD_RAD = 0.02


@dataclass(frozen=True)
class Found:
    """What the descents of one question found.

    Attributes:
        solutions: configurations in which all that is required holds and nothing touches, those that meet the
            preferences best, least time from the seed first.
        colliding: what touches in the best configuration that meets the wish, when in every such one something does.
        nearest_q: the configuration that comes nearest, free of contacts if any is.
        nearest: its deviation from what is asked.
    """

    solutions: tuple[Vector, ...]
    colliding: tuple[CollidingPair, ...]
    nearest_q: Vector
    nearest: Deviation


@dataclass(frozen=True)
class _End:
    """Where one descent ended.

    Attributes:
        q: the configuration.
        tight: whether the robot's hulls touch something there.
        collides: whether more than the hulls does.
        beyond_m: how far all that is required is from holding.
        less_liked_m: how far the preferences are.
    """

    q: Vector
    tight: bool
    collides: bool
    beyond_m: float
    less_liked_m: float

    @property
    def solves(self) -> bool:
        """Whether all that is required holds and nothing touches."""
        return self.beyond_m == 0.0 and not self.collides


class Findings:
    """What the descents of one question found so far."""

    def __init__(self, forward: ForwardKinematics, collision: CollisionModel | None, wish: Wish) -> None:
        self._collision = collision
        self._required = ConditionSet(forward, wish.required)
        self._preferred = ConditionSet(forward, wish.preferred)
        self._both = ConditionSet(forward, (*wish.required, *wish.preferred))
        self._ends: list[_End] = []
        self._least_beyond_m, self._least_liked_m = math.inf, math.inf
        self.begin()

    def begin(self, patience: int = HOPELESS_RESTARTS) -> None:
        """A row of descents begins, in which so many may be fruitless as long as there is no solution."""
        self._fruitless, self._patience = 0, patience

    def enough(self, wanted: int) -> bool:
        """Whether more descents would hardly help."""
        good = [end for end in self._ends if end.solves and not end.tight]
        patience = FRUITLESS_RESTARTS if good else self._patience
        return sum(end.less_liked_m == 0.0 for end in good) >= wanted or self._fruitless >= patience

    @property
    def any_solution(self) -> bool:
        """Whether anything was found that meets all that is required."""
        return any(end.solves for end in self._ends)

    @property
    def only_touching(self) -> bool:
        """Whether all that is required can be had, but only with something touching, for all that was found."""
        return not self.any_solution and any(end.beyond_m == 0.0 for end in self._ends)

    @property
    def only_colliding(self) -> bool:
        """Whether nothing free was found, neither in tolerance nor near it."""
        return all(end.collides for end in self._ends)

    def add(self, q: Vector) -> None:
        """Take the end of one descent."""
        self._fruitless += 1
        if any(end.solves and np.max(np.abs(q - end.q)) < DISTINCT_RAD for end in self._ends):
            return
        end = self._judged(q)
        self._ends.append(end)
        if end.beyond_m < self._least_beyond_m - NEARER_M:
            self._least_beyond_m, self._fruitless = end.beyond_m, 0
        if end.solves:
            if end.less_liked_m <= max(0.0, self._least_liked_m - NEARER_M):
                self._fruitless = 0
            self._least_liked_m = min(self._least_liked_m, end.less_liked_m)

    def result(self, move_time_s: Callable[[Vector], float]) -> Found:
        """Sum up."""
        nearest = min(self._ends, key=lambda end: (end.collides, end.beyond_m, end.less_liked_m))
        deviation = self._both.deviation(nearest.q)
        solving = [end for end in self._ends if end.solves]
        if not solving:
            meeting = next((end for end in self._ends if end.beyond_m == 0.0), None)
            return Found((), self._pairs(meeting), nearest.q, deviation)
        # Where only parts within the hulls are apart, motions are slow to check and rarely found.
        roomy = [end for end in solving if not end.tight] or solving
        most_m = min(end.less_liked_m for end in roomy) + ROTATION_ARM_M * AS_GOOD_RAD
        liked = [end.q for end in roomy if end.less_liked_m <= most_m]
        return Found(tuple(sorted(liked, key=move_time_s)), (), nearest.q, deviation)

    def _judged(self, q: Vector) -> _End:
        tight = self._collision is not None and self._collision.in_collision(q)
        collides = tight and self._collision is not None and self._collision.collides(q)
        return _End(q, tight, collides, self._required.beyond_m(q), self._preferred.beyond_m(q))

    def _pairs(self, end: _End | None) -> tuple[CollidingPair, ...]:
        return tuple(self._collision.colliding_pairs(end.q)) if self._collision is not None and end is not None else ()

"""Polylines on which a condition holds, where so few configurations meet it that a search would draw none of them.

Two trees grow towards each other in short steps, each brought back to where the condition holds, after Berenson et al.,
"Manipulation planning on constraint manifolds", 2009.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from planners.motions.path import Query

Vector = NDArray[np.float64]

Project = Callable[[Vector], Vector | None]

# Its name in plans.
PROJECTED_SEARCH = "RRTConnect on constraints"

# Steps this long stay near the condition in between, and most descents back to it take two or three steps.
STEP_RAD = 0.15

# A step that has been brought back to less than this share of its length leads nowhere new.
LEAST_PROGRESS = 0.2

# Trees that reach out further at once are caught in corners.
STEPS_AT_ONCE = 20


def projected_search(query: Query, project: Project, seed: int, should_stop: Callable[[], bool]) -> Vector | None:
    """Find a polyline on which the space's condition holds.

    Args:
        query: what to search for; the condition holds at its start and goals.
        project: brings a point to one nearby where the condition holds, or gives None.
        seed: same query and seed, same path.
        should_stop: asked before each step; a search it ends has no path.

    Returns:
        Shape (m, n) from the start to one of the goals, or None.
    """
    rng = np.random.default_rng(seed)
    grower = _Grower(query, project, should_stop)
    tree, other = _Tree([query.start]), _Tree(query.goals)
    forward = True
    while not should_stop():
        drawn = rng.uniform(query.space.lower_rad, query.space.upper_rad)
        here = grower.grow(tree, tree.nearest(drawn), drawn)
        there = grower.grow(other, other.nearest(tree.points[here]), tree.points[here])
        if np.array_equal(other.points[there], tree.points[here]):
            halves = [list(tree.to_root(here))[::-1], list(other.to_root(there))[1:]]
            path = np.array([*halves[0], *halves[1]])
            return path if forward else path[::-1]
        tree, other, forward = other, tree, not forward
    return None


class _Tree:
    """Points, and from which of them each was reached."""

    def __init__(self, roots: Sequence[Vector]) -> None:
        self.points = list(roots)
        self._parents = [-1] * len(self.points)

    def nearest(self, point: Vector) -> int:
        return int(np.argmin(np.sum((np.array(self.points) - point) ** 2, axis=1)))

    def add(self, point: Vector, parent: int) -> int:
        self.points.append(point)
        self._parents.append(parent)
        return len(self.points) - 1

    def to_root(self, index: int) -> Iterator[Vector]:
        while index >= 0:
            yield self.points[index]
            index = self._parents[index]


class _Grower:
    """Takes steps on which nothing touches and the condition holds."""

    def __init__(self, query: Query, project: Project, should_stop: Callable[[], bool]) -> None:
        self._query = query
        self._project = project
        self._should_stop = should_stop

    def grow(self, tree: _Tree, index: int, target: Vector) -> int:
        """Step from a point of a tree towards a target as far as it goes; the index of the last point."""
        for _ in range(STEPS_AT_ONCE):
            point = tree.points[index]
            reached = None if self._should_stop() else self._step(point, target)
            if reached is None or np.linalg.norm(target - reached) > np.linalg.norm(target - point):
                break
            index = tree.add(reached, index)
            if reached is target:
                break
        return index

    def _step(self, point: Vector, target: Vector) -> Vector | None:
        space, way = self._query.space, target - point
        length = float(np.linalg.norm(way))
        if length <= STEP_RAD and space.line_free(point, target, self._query.step_m):
            return target
        step = min(STEP_RAD, 0.5 * length)
        reached = self._project(point + way * (step / max(length, STEP_RAD)))
        if reached is None or np.linalg.norm(reached - point) < LEAST_PROGRESS * step:
            return None
        return reached if space.line_free(point, reached, self._query.step_m) else None

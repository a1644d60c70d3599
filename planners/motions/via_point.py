"""Paths by way of one point: two straight lines in joint space, the quickest of many first.

One via point is enough to pass most obstacles. A tree finds some path, on either side of an obstacle, and shortening
keeps it on that side; of via points drawn at random, those come first that hardly take longer than no obstacle would.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planners.motions.path import Query, line_free_sparsely
from robot.trajectory import Vector

# Points drawn at once, and compared in one numpy call.
POINTS = 1024

# Checks after which a tree finds a path sooner: no quick via point is free then as a rule.
MOST_CHECKS = 100


def via_point(
    query: Query, velocity_rad_s: Vector, rng: np.random.Generator, should_stop: Callable[[], bool]
) -> Vector | None:
    """Find a path of shape (3, n) to one of the goals by way of a point, among the quickest of the points drawn."""
    space, goals = query.space, np.array(query.goals)
    points = rng.uniform(space.lower_rad, space.upper_rad, (POINTS, len(query.start)))
    times_s = _times_s(points, query.start[np.newaxis], velocity_rad_s) + _times_s(points, goals, velocity_rad_s)
    most = space.checks + MOST_CHECKS
    for index in _least(times_s.ravel(), MOST_CHECKS).tolist():
        if space.checks >= most or should_stop():
            break
        goal, point = goals[index // POINTS], points[index % POINTS]
        lines = ((query.start, point), (point, goal))
        if all(line_free_sparsely(space, first, last, query.step_m) for first, last in lines):
            return np.array([query.start, point, goal])
    return None


def _times_s(points: Vector, others: Vector, velocity_rad_s: Vector) -> Vector:
    """Return how long the slowest joint takes between each two of some points, shape (others, points) [s]."""
    # numpy is slow with a last axis of five.
    moved_rad = np.abs(points.T[:, np.newaxis] - others.T[:, :, np.newaxis])
    times_s: Vector = np.max(moved_rad / velocity_rad_s[:, np.newaxis, np.newaxis], axis=0)
    return times_s


def _least(values: Vector, count: int) -> NDArray[np.intp]:
    """Return the indices of the least values, shape (count,) or more where some are equal, in their order."""
    # Each try is a check at least, so hardly any is needed; sorting all of them took longer than the checks.
    few = np.flatnonzero(values <= np.partition(values, count - 1)[count - 1])
    return few[np.argsort(values[few], kind="stable")]

"""Collision-free polylines: the straight joint line, or OMPL's RRT-Connect and shortcuts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from planners.joint_space import JointSpace

Vector = NDArray[np.float64]


# Longer tree edges mean fewer nodes; past this most edges of a folded arm collide.
TREE_EDGE_RAD = 1.0

# Shortcuts gain little after this many tries on paths of five joints.
SHORTCUT_TRIES = 40

# A shortcut that saves less does not pay for its checks.
LEAST_GAIN_RAD = 0.02

# The libraries' log would go to the worker's stderr; what matters is in the answer.
ou.setLogLevel(ou.LOG_NONE)


def search(
    joint_space: JointSpace, start: Vector, goals: Sequence[Vector], seed: int, should_stop: Callable[[], bool]
) -> Vector | None:
    """Find a polyline by RRT-Connect and straighten it.

    Args:
        joint_space: where to search.
        start: free point, shape (n,).
        goals: free points, any one of which will do.
        seed: same problem and seed, same path.
        should_stop: asked all the time; a search it ends has no path.

    Returns:
        Shape (m, n) from the start to one of the goals, or None.
    """
    path = _rrt_connect(joint_space, start, goals, seed, should_stop)
    return None if path is None else shortcut(joint_space, path, seed, should_stop)


def shortcut(joint_space: JointSpace, path: Vector, seed: int, should_stop: Callable[[], bool]) -> Vector:
    """Replace parts of a polyline by straight lines where they are free.

    Returns:
        Shape (k, n) with the same ends, no longer than ``path`` in any norm.
    """
    rng = np.random.default_rng(seed)
    points = list(path)
    for _ in range(SHORTCUT_TRIES):
        if len(points) < 3 or should_stop():
            break
        points = _one_shortcut(joint_space, points, rng)
    return np.array(points)


def _one_shortcut(joint_space: JointSpace, points: list[Vector], rng: np.random.Generator) -> list[Vector]:
    """Try the line between two points drawn along the polyline; the ends are drawn often, as they save most."""
    position = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    first, last = np.sort(np.clip(rng.uniform(-0.2, 1.2, 2), 0.0, 1.0)) * position[-1]
    i = min(int(np.searchsorted(position, first, side="right")) - 1, len(points) - 2)
    j = min(int(np.searchsorted(position, last, side="right")) - 1, len(points) - 2)
    if i == j:
        return points
    start, end = (
        points[k] + (at - position[k]) / (position[k + 1] - position[k]) * (points[k + 1] - points[k])
        for k, at in ((i, first), (j, last))
    )
    detour = np.linalg.norm(np.diff([start, *points[i + 1 : j + 1], end], axis=0), axis=1).sum()
    if detour - np.linalg.norm(end - start) < LEAST_GAIN_RAD or not joint_space.line_free(start, end):
        return points
    head = points[: i + 1] if first > position[i] else points[:i]
    tail = points[j + 1 :] if last < position[j + 1] else points[j + 2 :]
    return [*head, start, end, *tail]


def _rrt_connect(
    joint_space: JointSpace, start: Vector, goals: Sequence[Vector], seed: int, should_stop: Callable[[], bool]
) -> Vector | None:
    # Everything is made anew for each search: a planner keeps its random generator and its last solution.
    ou.RNG.setSeed(seed + 1)  # OMPL refuses 0
    size = len(start)
    space = joint_space.space()
    setup = og.SimpleSetup(space)
    information = setup.getSpaceInformation()
    setup.setStateValidityChecker(lambda state: joint_space.free(state[0:size]))
    setup.setStartState(_state(space, start))
    goal_states = ob.GoalStates(information)
    for goal in goals:
        goal_states.addState(_state(space, goal))
    setup.setGoal(goal_states)
    planner = og.RRTConnect(information)
    planner.setRange(TREE_EDGE_RAD)
    setup.setPlanner(planner)
    # A condition with a period of its own would abort the process at exit.
    setup.solve(ob.PlannerTerminationCondition(should_stop))
    if not setup.haveExactSolutionPath():
        return None
    path = setup.getSolutionPath()
    return np.array([path.getState(i)[0:size] for i in range(path.getStateCount())])


def _state(space: ob.RealVectorStateSpace, point: Vector) -> ob.RealVectorStateType:
    state = space.allocState()
    for i, value in enumerate(point):
        state[i] = float(value)
    return state

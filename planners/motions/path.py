"""Collision-free polylines: OMPL's searches, and shortcuts from vertex to vertex."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from planners.motions.effort import CountedSpace

Vector = NDArray[np.float64]

# Longer tree edges mean fewer nodes and fewer checks until a path is there; past this they grow again.
TREE_EDGE_RAD = 1.7

RRT_CONNECT = "RRTConnect"

# OMPL's searches with edges of a length to choose, by their names; see planners.problem.PLANNER_IDS.
TREES = {
    RRT_CONNECT: og.RRTConnect,
    "RRT": og.RRT,
    "RRTstar": og.RRTstar,
    "InformedRRTstar": og.InformedRRTstar,
    "SORRTstar": og.SORRTstar,
    "LBKPIECE1": og.LBKPIECE1,
    "BKPIECE1": og.BKPIECE1,
    "KPIECE1": og.KPIECE1,
}

# The libraries' log would go to the worker's stderr; what matters is in the answer.
ou.setLogLevel(ou.LOG_NONE)


@dataclass(frozen=True)
class Query:
    """What to search for.

    Attributes:
        space: where to search.
        start: free point, shape (n,).
        goals: free points, any one of which will do.
        step_m: the most that any robot point moves from one check to the next [m].
    """

    space: CountedSpace
    start: Vector
    goals: Sequence[Vector]
    step_m: float


def search(query: Query, name: str, seed: int, should_stop: Callable[[], bool]) -> Vector | None:
    """Find a polyline by one of OMPL's planners.

    Args:
        query: what to search for.
        name: one of planners.problem.PLANNER_IDS.
        seed: same query and seed, same path.
        should_stop: asked all the time; a search it ends has no path.

    Returns:
        Shape (m, n) from the start to one of the goals, or None.
    """
    # Everything is made anew for each search: a planner keeps its random generator and its last solution.
    ou.RNG.setSeed(seed + 1)  # OMPL refuses 0
    size = len(query.start)
    setup = _setup(query)
    information = setup.getSpaceInformation()
    if name == RRT_CONNECT:
        information.setMotionValidator(_Edges(information, query))
    setup.setPlanner(_planner(name, information))
    # A condition with a period of its own would abort the process at exit.
    setup.solve(ob.PlannerTerminationCondition(should_stop))
    if not setup.haveExactSolutionPath():
        return None
    path = setup.getSolutionPath()
    return np.array([path.getState(i)[0:size] for i in range(path.getStateCount())])


def without_detours(space: CountedSpace, path: Vector, step_m: float) -> Vector | None:
    """Leave out the vertices that a free straight line can pass by, from each vertex to the furthest it can reach.

    Args:
        space: what is free.
        path: shape (m, n).
        step_m: the most that any robot point moves from one check to the next [m].

    Returns:
        Shape (k, n) with the same ends, or None: looked at so finely, the path itself is not free.
    """
    kept = [0]
    while kept[-1] < len(path) - 1:
        here = kept[-1]
        further = range(len(path) - 1, here, -1)
        reached = next((i for i in further if space.line_free(path[here], path[i], step_m)), None)
        if reached is None:
            return None
        kept.append(reached)
    return path[kept]


class _Edges(ob.MotionValidator):
    """Tree edges checked in one go: a call from C++ for each configuration takes as long as the check itself."""

    def __init__(self, information: ob.SpaceInformation, query: Query) -> None:
        super().__init__(information)
        self._query = query
        self._size = len(query.start)

    def checkMotion(self, first: ob.RealVectorStateType, second: ob.RealVectorStateType) -> bool:  # noqa: N802
        start, end = np.array(first[0 : self._size]), np.array(second[0 : self._size])
        return self._query.space.glance(start, end, self._query.step_m)


def _planner(name: str, information: ob.SpaceInformation) -> ob.Planner:
    if name == "BITstar":
        return og.BITstar(information)
    planner = TREES[name](information)
    planner.setRange(TREE_EDGE_RAD)
    return planner


def _setup(query: Query) -> og.SimpleSetup:
    size, free = len(query.start), query.space.free
    space = _ompl_space(query)
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: free(state[0:size]))
    setup.setStartState(_state(space, query.start))
    goal_states = ob.GoalStates(setup.getSpaceInformation())
    for goal in query.goals:
        goal_states.addState(_state(space, goal))
    setup.setGoal(goal_states)
    return setup


def _ompl_space(query: Query) -> ob.RealVectorStateSpace:
    size = len(query.start)
    space = ob.RealVectorStateSpace(size)
    bounds = ob.RealVectorBounds(size)
    for i, (lower, upper) in enumerate(zip(query.space.lower_rad, query.space.upper_rad, strict=True)):
        bounds.setLow(i, float(lower))
        bounds.setHigh(i, float(upper))
    space.setBounds(bounds)
    # OMPL measures lines by their Euclidean length; no point travels more than |travel| times that.
    step_rad = query.step_m / float(np.linalg.norm(query.space.travel_m_per_rad))
    space.setLongestValidSegmentFraction(min(1.0, step_rad / space.getMaximumExtent()))
    return space


def _state(space: ob.RealVectorStateSpace, point: Vector) -> ob.RealVectorStateType:
    state = space.allocState()
    for i, value in enumerate(point):
        state[i] = float(value)
    return state

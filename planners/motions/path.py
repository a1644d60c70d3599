"""Collision-free polylines: searches with shortcuts from vertex to vertex, and their effort.

RRT-Connect grows two trees towards each other (Kuffner and LaValle, 2000). From a node whose way was blocked once it
only goes to points nearby: most others are behind an obstacle (Yershova et al., "Dynamic-domain RRTs", 2005). Where a
search would hardly ever draw a configuration that meets a condition, the trees grow in short steps, each projected onto
the condition (Berenson et al., "Manipulation planning on constraint manifolds", 2009). Other searches are OMPL's. The
effort of a search is counted in checks, which is the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from planners.budget import never
from planners.geometry.joint_space import JointSpace
from planners.motions.curve import Curve
from robot.trajectory import Vector

# Checks a second on the machine that the optimisation time is meant for, all that goes with them included.
NOMINAL_CHECKS_PER_S = 30_000

CURVE_SHARES = np.linspace(0.0, 1.0, 65)  # shares of a curve's time between which its travel is measured
CHECKS_A_POLL = 16  # checks of a curve between two polls for a cancel, which take a quarter of a check in a worker

# No point of the arm travels further along a tree edge [m]. Longer edges mean fewer nodes and fewer checks until a path
# is there, but past this most are blocked: SO-101, of 0.4 m, and arms of 1 m have the same best length.
TREE_EDGE_M = 1.3

RRT_CONNECT = "RRTConnect"

# Brings a point to one nearby where the space's condition holds, or returns None.
Project = Callable[[Vector], Vector | None]

PROJECTED_SEARCH = "RRTConnect on constraints"

# Steps this long stay near the condition in between, and most descents back to it take two or three steps.
STEP_RAD = 0.15

LEAST_PROGRESS = 0.2  # a step that has been brought back to less than this share of its length leads nowhere new
STEPS_AT_ONCE = 20  # trees that reach out further at once are caught in corners
DRAWN = 64  # points drawn at once
COMPARED = 16_384  # distances to a tree computed at once: all of them at once took up to 3 ms, out of the cache
DOMAIN_EDGES = 4.0  # edges from a blocked point within which it is still gone on from
VIA_POINTS = 1024  # via points drawn at once, and compared in one numpy call
MOST_CHECKS = 100  # checks after which a tree finds a path sooner: no quick via point is free then as a rule


@lru_cache
def coarse_first(pieces: int) -> Vector:
    """Return the fractions at which a line's pieces end: the end first, then well spread, shape (pieces, 1)."""
    bits = pieces.bit_length()
    turned = [int(f"{i:0{bits}b}"[::-1], 2) for i in range(pieces)]
    shares = 1.0 - np.argsort(turned)[:, np.newaxis] / pieces
    shares.flags.writeable = False
    return shares


def line_free_sparsely(space: JointSpace, start: Vector, end: Vector, step_m: float) -> bool:
    """Return true if nothing touches in points of a line, a step apart at most; its start is taken to be free."""
    if not space.free(end):  # as four of five edges of a tree in a narrow passage
        return False
    shares = coarse_first(max(1, math.ceil(np.abs(end - start) @ space.travel_m_per_rad / step_m)))[1:]
    return all(map(space.free, start + shares * (end - start)))


def amid_steps(space: JointSpace, start: Vector, end: Vector, step_m: float) -> Vector:
    """Return points half-way between the points of :func:`line_free_sparsely`, shape (m, n) [rad]."""
    shares = coarse_first(max(1, math.ceil(np.abs(end - start) @ space.travel_m_per_rad / step_m)))
    return start + (shares - 0.5 / len(shares)) * (end - start)


def curve_free(space: JointSpace, curve: Curve, step_m: float, should_stop: Callable[[], bool] = never) -> bool:
    """Return true if joints stay in range and nothing touches at steps along a curve; its ends are taken to be free."""
    if not curve.stays_within(space.lower_rad, space.upper_rad):
        return False
    ticks, travel_m = curve.duration_ticks * CURVE_SHARES, np.zeros_like(CURVE_SHARES)
    samples = curve.at(ticks)[0]
    (np.abs(samples[1:] - samples[:-1]) @ space.travel_m_per_rad).cumsum(out=travel_m[1:])
    shares = coarse_first(max(1, math.ceil(travel_m[-1] / step_m)))[1:, 0]
    points = curve.at(np.interp(travel_m[-1] * shares, travel_m, ticks))[0]
    return all((i % CHECKS_A_POLL or not should_stop()) and space.free(point) for i, point in enumerate(points))


# The libraries' log would go to the worker's stderr; what matters is in the answer.
ou.setLogLevel(ou.LOG_NONE)


@dataclass(frozen=True)
class Query:
    """Query of a path search."""

    space: JointSpace  # where to search
    start: Vector  # free point, shape (n,)
    goals: Sequence[Vector]  # free points to choose from
    step_m: float  # greatest travel of a point of the robot from one check to the next [m]

    @cached_property
    def weights(self) -> Vector:
        """Weights of the joints in distances, shape (n,): a wrist turns further in an edge than a shoulder."""
        # By the root of the travel that a joint causes; searches on Fetch then take half the checks, by the travel 3/5.
        return np.asarray(np.sqrt(self.space.travel_m_per_rad))


class TreeSearch:
    """Search by one of planners.problem.PLANNER_IDS; the same query and seed give the same path."""

    def __init__(self, query: Query, name: str, seed: int) -> None:
        # Each search has objects of its own: a planner keeps its random generator, its trees and its last solution.
        ou.RNG.setSeed(seed + 1)  # OMPL refuses 0
        self._size = size = len(query.start)
        free, space = query.space.free, _ompl_space(query)
        self._setup = setup = og.SimpleSetup(space)
        information = setup.getSpaceInformation()
        setup.setStateValidityChecker(lambda state: free(state[0:size]))
        setup.setStartState(_state(space, query.start))
        goal_states = ob.GoalStates(information)
        for goal in query.goals:
            goal_states.addState(_state(space, goal))
        setup.setGoal(goal_states)
        search = getattr(og, name)(information)
        # BIT* has no edges of a length to choose.
        if hasattr(search, "setRange"):
            search.setRange(TREE_EDGE_M / _travel_m_per_rad(query))
        setup.setPlanner(search)

    def run(self, should_stop: Callable[[], bool]) -> Vector | None:
        """Go on until there is a polyline of shape (m, n) from the start to a goal; None once it is to stop."""
        # A condition with a period of its own would abort the process at exit.
        self._setup.solve(ob.PlannerTerminationCondition(should_stop))
        if not self._setup.haveExactSolutionPath():
            return None
        path = self._setup.getSolutionPath()
        return np.array([path.getState(i)[0 : self._size] for i in range(path.getStateCount())])


def without_detours(space: JointSpace, path: Vector, step_m: float, should_stop: Callable[[], bool] = never) -> Vector:
    """Leave out vertices of a free path that a free line passes by, until the search is to stop."""
    kept = [0]
    while kept[-1] < len(path) - 1:
        here = kept[-1]
        further = range(len(path) - 1, here + 1, -1)
        free = (i for i in further if not should_stop() and line_free_sparsely(space, path[here], path[i], step_m))
        kept.append(next(free, here + 1))
    return path[kept]


def _ompl_space(query: Query) -> ob.RealVectorStateSpace:
    size = len(query.start)
    space, bounds = ob.RealVectorStateSpace(size), ob.RealVectorBounds(size)
    for i, (lower, upper) in enumerate(zip(query.space.lower_rad, query.space.upper_rad, strict=True)):
        bounds.setLow(i, float(lower))
        bounds.setHigh(i, float(upper))
    space.setBounds(bounds)
    step_rad = query.step_m / _travel_m_per_rad(query)
    space.setLongestValidSegmentFraction(min(1.0, step_rad / space.getMaximumExtent()))
    return space


def _travel_m_per_rad(query: Query) -> float:
    """Return the most that a point travels by the Euclidean length of a line, which is how OMPL measures them."""
    return float(np.linalg.norm(query.space.travel_m_per_rad))


def _state(space: ob.RealVectorStateSpace, point: Vector) -> ob.RealVectorStateType:
    state = space.allocState()
    for i, value in enumerate(point):
        state[i] = float(value)
    return state


class ConnectSearch:
    """RRT-Connect, in steps that ``project`` brings to where the space's condition holds; as :class:`TreeSearch`."""

    def __init__(self, query: Query, project: Project | None, seed: int) -> None:
        self._query, self._project = query, project
        self._rng = np.random.default_rng(seed)
        self._trees = _Tree([query.start], query.weights), _Tree(query.goals, query.weights)

    def run(self, should_stop: Callable[[], bool]) -> Vector | None:
        """Go on as :meth:`TreeSearch.run` does."""
        grower, space = _Grower(self._query, self._project, should_stop), self._query.space
        while not should_stop():
            # The smaller tree grows: it is in the narrower place.
            tree, other = sorted(self._trees, key=lambda each: len(each.points))
            drawn = _drawn(space, self._rng, DRAWN)
            for index, point in tree.near(drawn, grower.edge):
                here = grower.grow(tree, index, point) if self._project else grower.reach(tree, index, point)
                if here == index:
                    continue
                there = grower.grow(other, other.nearest(tree.points[here]), tree.points[here])
                if np.array_equal(other.points[there], tree.points[here]):
                    path = np.array([*list(tree.to_root(here))[::-1], *list(other.to_root(there))[1:]])
                    return path if tree is self._trees[0] else path[::-1]
                break
        return None


def reachable(query: Query, project: Project, seed: int, should_stop: Callable[[], bool]) -> Vector:
    """Grow a tree from the start, some branches towards the goals, until it is to stop; return its points, (m, n)."""
    rng = np.random.default_rng(seed)
    grower, tree = _Grower(query, project, should_stop), _Tree([query.start], query.weights)
    for goal in query.goals:
        grower.grow(tree, 0, goal)
    while not should_stop():
        drawn, known = rng.uniform(query.space.lower_rad, query.space.upper_rad), len(tree.points)
        here = grower.grow(tree, tree.nearest(drawn), drawn)
        if len(tree.points) > known and len(query.goals):
            grower.grow(tree, here, query.goals[int(rng.integers(len(query.goals)))])
    return tree.points


class _Tree:
    """Points, the point from which each was reached, and how far from each it may go on, in weighted distance."""

    def __init__(self, roots: Sequence[Vector], weights: Vector) -> None:
        self._weights = weights
        # A row for each point and room for more: the point, the weighted point, and the square of this.
        self._rows = np.empty((0, 2 * len(weights) + 1))
        self._parents: list[int] = []
        self.reach: list[float] = []
        for root in roots:
            self.add(root, -1)

    @property
    def points(self) -> Vector:
        """Points of the tree, shape (m, n) [rad]."""
        return self._rows[: len(self._parents), : len(self._weights)]

    def nearest(self, point: Vector) -> int:
        return int(np.argmin(self._squares(point[np.newaxis])))

    def near(self, drawn: Vector, edge: float) -> Iterator[tuple[int, Vector]]:
        """Yield, of the drawn points, (m, n), within reach of the tree, the nearest one's index and an edge from it."""
        own, count = np.sum((drawn * self._weights) ** 2, axis=1), max(8, COMPARED // len(self._parents))
        for first in range(0, len(drawn), count):
            some = slice(first, first + count)
            squares = self._squares(drawn[some])
            # By rounding a square may be below 0.
            nearest, away = squares.argmin(axis=1), np.sqrt(np.maximum(squares.min(axis=1) + own[some], 1e-12))
            points = self.points[nearest]
            ends = points + np.minimum(1.0, edge / away)[:, np.newaxis] * (drawn[some] - points)
            for index, distance, end in zip(nearest.tolist(), away.tolist(), ends, strict=True):
                if distance <= self.reach[index]:
                    yield index, end

    def add(self, point: Vector, parent: int) -> int:
        index, weighted = len(self._parents), point * self._weights
        if index == len(self._rows):
            self._rows = np.concatenate((self._rows, np.empty((max(index, 64), self._rows.shape[1]))))
        self._rows[index] = np.concatenate((point, weighted, [weighted @ weighted]))
        self._parents.append(parent)
        self.reach.append(np.inf)
        return index

    def to_root(self, index: int) -> Iterator[Vector]:
        while index >= 0:
            yield self._rows[index, : len(self._weights)]
            index = self._parents[index]

    def _squares(self, points: Vector) -> Vector:
        """Return the squared weighted distances of points to the tree's, (m, tree), less the points' own squares."""
        rows, size = self._rows[: len(self._parents)], len(self._weights)
        return np.asarray((-2.0 * self._weights * points) @ rows[:, size:-1].T + rows[:, -1])


class _Grower:
    """Takes steps on which nothing touches and the condition holds."""

    def __init__(self, query: Query, project: Project | None, should_stop: Callable[[], bool]) -> None:
        self._query = query
        self._project = project
        self._should_stop = should_stop
        # No point of the robot travels further than a weighted distance times the length of the weights.
        edge = TREE_EDGE_M / float(np.linalg.norm(query.weights))
        self.edge, self._domain = (edge, DOMAIN_EDGES * edge) if project is None else (np.inf, np.inf)

    def reach(self, tree: _Tree, index: int, point: Vector) -> int:
        """Go from a point of a tree to another one; the index of the last point."""
        if line_free_sparsely(self._query.space, tree.points[index], point, self._query.step_m):
            return tree.add(point, index)
        tree.reach[index] = self._domain
        return index

    def grow(self, tree: _Tree, index: int, target: Vector) -> int:
        """Step from a point of a tree towards a target as far as it goes; the index of the last point."""
        for taken in range(STEPS_AT_ONCE):
            point = tree.points[index]
            if taken and self._should_stop():  # before the first step the caller asks, once for many
                break
            reached = self._stride(point, target) if self._project is None else self._step(point, target, self._project)
            if reached is None:
                tree.reach[index] = self._domain
                break
            index = tree.add(reached, index)
            if reached is target:
                break
        return index

    def _stride(self, point: Vector, target: Vector) -> Vector | None:
        way = target - point
        weighted = way * self._query.weights
        length = math.sqrt(weighted @ weighted)
        reached = target if length <= self.edge else point + way * (self.edge / length)
        return reached if line_free_sparsely(self._query.space, point, reached, self._query.step_m) else None

    def _step(self, point: Vector, target: Vector, project: Project) -> Vector | None:
        space, way = self._query.space, target - point
        length = float(np.linalg.norm(way))
        if length <= STEP_RAD and line_free_sparsely(space, point, target, self._query.step_m):
            return target
        step = min(STEP_RAD, 0.5 * length)
        reached = project(point + way * (step / max(length, STEP_RAD)))
        if reached is None or np.linalg.norm(reached - point) < LEAST_PROGRESS * step:
            return None
        if np.linalg.norm(target - reached) > length:
            return None
        return reached if line_free_sparsely(space, point, reached, self._query.step_m) else None


def via_point(
    query: Query, velocity_rad_s: Vector, rng: np.random.Generator, should_stop: Callable[[], bool]
) -> Vector | None:
    """Find a path of shape (3, n) to one of the goals by way of a point, among the quickest of the points drawn.

    One via point is enough to pass most obstacles. A tree finds some path, on either side of an obstacle, and
    shortening keeps it on that side; of via points drawn at random, those come first that hardly take longer than no
    obstacle would.
    """
    space, goals, points = query.space, query.goals, _drawn(query.space, rng, VIA_POINTS)
    # numpy is slow with a last axis of five, and with arrays that do not fit into the cache.
    by_joint, tops, ends = np.ascontiguousarray(points.T), velocity_rad_s[:, np.newaxis], (query.start, *goals)
    from_start_s, *to_goals_s = ((np.abs(by_joint - end[:, np.newaxis]) / tops).max(axis=0) for end in ends)
    most, times_s = space.checks + MOST_CHECKS, (np.array(to_goals_s) + from_start_s).ravel()
    # Each try is a check at least, so hardly any is needed; sorting all of them took longer than the checks.
    few = np.flatnonzero(times_s <= np.partition(times_s, MOST_CHECKS - 1)[MOST_CHECKS - 1])
    for index in few[np.argsort(times_s[few], kind="stable")].tolist():
        if space.checks >= most or should_stop():
            break
        goal, point = goals[index // VIA_POINTS], points[index % VIA_POINTS]
        lines = ((query.start, point), (point, goal))
        if all(line_free_sparsely(space, first, last, query.step_m) for first, last in lines):
            return np.array([query.start, point, goal])
    return None


def _drawn(space: JointSpace, rng: np.random.Generator, count: int) -> Vector:
    """Draw points within the limits, shape (count, n): as `uniform` does, which takes twice as long."""
    return np.asarray(space.lower_rad + (space.upper_rad - space.lower_rad) * rng.random((count, len(space.lower_rad))))

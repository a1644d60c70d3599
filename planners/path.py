"""Collision-free polylines: the straight joint line, or OMPL's RRT-Connect and shortcuts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from planners.collision import NO_CONTACT, CollisionModel
from robot.model import Group

Vector = NDArray[np.float64]

# Links are centimetres thick and their hulls reach a few millimetres beyond them, so a contact between two checks
# this far apart stays in the hulls' margin.
CHECK_STEP_M = 0.005

# Longer tree edges mean fewer nodes; past this most edges of a folded arm collide.
TREE_EDGE_RAD = 1.0

# Shortcuts gain little after this many tries on paths of five joints.
SHORTCUT_TRIES = 40

# A shortcut that saves less does not pay for its checks.
LEAST_GAIN_RAD = 0.02

# The libraries' log would go to the worker's stderr; what matters is in the answer.
ou.setLogLevel(ou.LOG_NONE)


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

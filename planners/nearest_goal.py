"""Goal that works, nearest to one that does not: found among free configurations, and verified by a plan.

A joint goal in collision is moved out of the contact in many directions, and the shortest way out is taken. A goal of
the tip is met in several configurations whose contacts do not count; each of those is moved out of its contacts, and
the tip's place there that is nearest to the one asked for is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from planners.budget import Budget
from planners.geometry.collision import CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.goals import JointGoal, PoseGoal, PositionGoal
from planners.ik.goal_states import GoalQuery, GoalStates
from planners.problem import Plan, PlanningFailure, PlanningProblem
from robot.description.model import RobotModel
from robot.trajectory import Vector

# Distances of the ways out of a contact that are tried, in travel of the fastest point [m].
DISTANCES_M = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28)

# The last of them is narrowed down to a sixteenth.
HALVINGS = 4

# Ways out of a contact, beside those of single joints and the way back to the start.
DIRECTIONS = 32
DIRECTIONS_SEED = 3

# A free place may lie in a pocket that no motion reaches, so several are tried.
TRIES = 6

# Configurations that meet a goal of the tip.
CONFIGURATIONS = 4

# Shares of the way from the tip to a goal: places there work where those near the goal do not.
SHARES = (0.97, 0.9, 0.8, 0.6)

# Digits of a suggested goal, which people read: a tenth of a millimetre, and a fifteenth of a servo's tick.
DIGITS = 4


def nearest_goal(
    problem: PlanningProblem,
    robot: RobotModel,
    states: GoalStates,
    collision: CollisionModel,
    plan: Callable[[PlanningProblem], Plan | PlanningFailure],
    budget: Budget,
    allowed_time_s: float,
) -> JointGoal | PositionGoal | PoseGoal | None:
    """Find the goal; None where none was found.

    Args:
        problem: has no plan.
        robot: the arm.
        states: finds configurations.
        collision: collisions of the arm with itself and the scene.
        plan: verifies a goal.
        budget: ends the search.
        allowed_time_s: time that the budget allows [s].
    """
    start_q = np.array([problem.start_rad[name] for name in collision.joint_names])
    start_q = np.clip(start_q, collision.lower_rad, collision.upper_rad)
    space = JointSpace(collision, robot.groups[problem.group], start_q, collision.overlaps_m(start_q))
    search = _Search(problem, states, collision, space, start_q, budget)
    match problem.goal:
        case JointGoal() as goal:
            candidates: Iterator[JointGoal | PositionGoal | PoseGoal] = search.joint_goals(goal, robot)
        case PositionGoal() | PoseGoal() as goal:
            candidates = search.tip_goals(goal, robot)
        case _:
            return None
    for candidate in islice(candidates, TRIES):
        if budget.used_up():
            break
        left_s = allowed_time_s - budget.spent_s
        if isinstance(plan(replace(problem, goal=candidate, allowed_time_s=left_s, optimization_time_s=0.0)), Plan):
            return candidate
    return None


def ways_out(
    space: JointSpace, point: Vector, start: Vector, moving: Vector, should_stop: Callable[[], bool]
) -> list[tuple[float, Vector]]:
    """Return free points around one that is not, nearest first, with the most that anything moves to there [m].

    Args:
        space: what is free.
        point: shape (n,) [rad].
        start: a free point, shape (n,) [rad].
        moving: joints that may differ from the point, shape (n,), 1 or 0.
        should_stop: ends the search.
    """
    found: list[tuple[float, Vector]] = []
    least_m = np.inf
    for direction in _directions(point, start, moving):
        if should_stop():
            break
        travel_m = float(np.abs(direction) @ space.travel_m_per_rad)
        if travel_m == 0.0:
            continue
        way, blocked_m = direction / travel_m, 0.0
        for distance_m in DISTANCES_M:
            if blocked_m >= least_m:
                break
            end = np.clip(point + distance_m * way, space.lower_rad, space.upper_rad)
            if space.free(end):
                free_m = _narrowed(space, point, way, blocked_m, distance_m)
                found.append((free_m, np.clip(point + free_m * way, space.lower_rad, space.upper_rad)))
                least_m = min(least_m, free_m)
                break
            blocked_m = distance_m
    return sorted(found, key=lambda each: each[0])


def _narrowed(space: JointSpace, point: Vector, way: Vector, blocked_m: float, free_m: float) -> float:
    """Return a distance at which a way is free, nearer to one at which it is not."""
    for _ in range(HALVINGS):
        middle_m = 0.5 * (blocked_m + free_m)
        if space.free(np.clip(point + middle_m * way, space.lower_rad, space.upper_rad)):
            free_m = middle_m
        else:
            blocked_m = middle_m
    return free_m


def _directions(point: Vector, start: Vector, moving: Vector) -> Iterator[Vector]:
    """Yield ways out: back to the start, by each joint alone, and by all of them."""
    yield (start - point) * moving
    for joint in np.flatnonzero(moving):
        for sign in (1.0, -1.0):
            way = np.zeros(len(point))
            way[joint] = sign
            yield way
    yield from np.random.default_rng(DIRECTIONS_SEED).normal(size=(DIRECTIONS, len(point))) * moving


class _Search:
    """Candidates for one problem, most promising first."""

    def __init__(
        self,
        problem: PlanningProblem,
        states: GoalStates,
        collision: CollisionModel,
        space: JointSpace,
        start_q: Vector,
        budget: Budget,
    ) -> None:
        self._problem, self._states, self._collision = problem, states, collision
        self._space, self._start_q, self._budget = space, start_q, budget

    def joint_goals(self, goal: JointGoal, robot: RobotModel) -> Iterator[JointGoal]:
        """Yield joint goals near one."""
        names = robot.groups[self._problem.group].joints
        start = self._space.point(self._start_q)
        point = np.array([goal.positions_rad.get(name, at) for name, at in zip(names, start, strict=True)])
        moving = np.array([float(name in goal.positions_rad) for name in names])
        for _, free in ways_out(self._space, point, start, moving, self._budget.used_up):
            values = dict(zip(names, free.tolist(), strict=True))
            yield replace(goal, positions_rad={name: round(values[name], DIGITS) for name in goal.positions_rad})

    def tip_goals(self, goal: PositionGoal | PoseGoal, robot: RobotModel) -> Iterator[PositionGoal | PoseGoal]:
        """Yield goals of the tip near one, those near it first, then those on the way there."""
        group = robot.groups[self._problem.group]
        query = GoalQuery(
            group, self._start_q, self._problem.path_constraints, self._budget, CONFIGURATIONS, avoid_collisions=False
        )
        found = self._states.find(goal, query)
        asked_m = np.array(goal.position_m if isinstance(goal, PositionGoal) else goal.pose.position_m)
        if isinstance(found, PlanningFailure):
            nearest_m = found.details.get("nearest_m")
            places_m = [] if nearest_m is None else [np.array(nearest_m)]
            asked_m = places_m[0] if places_m else asked_m
        else:
            places_m = self._places_m(goal, [state.q for state in found])
            places_m.sort(key=lambda place_m: float(np.linalg.norm(place_m - asked_m)))
        tip_m = np.array(self._states.point_m(goal, self._start_q))
        ways_m = [tip_m + share * (asked_m - tip_m) for share in SHARES]
        # An orientation that is asked for is rarely to be had where the joints were turned out of a contact.
        for place_m in (*places_m[: TRIES // 2], *ways_m):
            yield moved_to(goal, place_m)

    def _places_m(self, goal: PositionGoal | PoseGoal, configurations: Sequence[Vector]) -> list[Vector]:
        """Return where the tip is in free configurations near some, shape (3,) [m]."""
        start = self._space.point(self._start_q)
        places_m = []
        for q in configurations:
            point = self._space.point(q)
            for _, free in ways_out(self._space, point, start, np.ones(len(point)), self._budget.used_up)[:TRIES]:
                places_m.append(np.array(self._states.point_m(goal, self._space.configuration(free))))
        return places_m


def moved_to(goal: PositionGoal | PoseGoal, place_m: Vector) -> PositionGoal | PoseGoal:
    """Return a goal at another place, shape (3,) [m]."""
    x, y, z = (round(value, DIGITS) for value in place_m.tolist())
    if isinstance(goal, PositionGoal):
        return replace(goal, position_m=(x, y, z))
    return replace(goal, pose=replace(goal.pose, position_m=(x, y, z)))

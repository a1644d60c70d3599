"""Goal that works, near a goal that does not: found among free configurations, and verified by a plan.

A joint goal in collision is moved out of the contact in many directions, and the shortest way out is taken. Otherwise a
tree of free motions is grown from the start, and the goal is moved to the nearest of its configurations. In
place of a path of the tip there is its first part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from planners import checks
from planners.budget import Budget
from planners.cartesian.planning import plan_cartesian
from planners.cartesian.tip_path import TipPath, first_part
from planners.geometry.certificate import line_free
from planners.geometry.collision import CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.geometry.kinematics import ForwardKinematics
from planners.goals import AnyGoal, JointGoal, PoseGoal, PositionGoal
from planners.ik.goal_states import GoalQuery, GoalStates
from planners.motions.path import Project, Query, reachable
from planners.problem import (
    CartesianPlan,
    CartesianProblem,
    MoveItErrorCode,
    PathGoal,
    Plan,
    PlanningError,
    PlanningFailure,
    PlanningProblem,
)
from robot.description.model import Group, RobotModel
from robot.trajectory import Vector

# Distances of the ways out of a contact that are tried, in travel of the fastest point [m].
DISTANCES_M = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28)

HALVINGS = 5  # bisections of the way between a free point and a point that is not

# Ways out of a contact, beside the ways of single joints and the way back to the start.
DIRECTIONS = 32
DIRECTIONS_SEED = 3

TRIES = 6  # a free place may lie in a pocket that no motion reaches, so several are tried
CONFIGURATIONS = 4  # configurations that meet a goal of the tip

# Codes of goals around which nothing is in the way, or nothing that moving the goal a little would help against: no
# motion to them was found, or they violate the constraints of the path.
UNREACHED = (MoveItErrorCode.TIMED_OUT, MoveItErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS)

# Shares of the time that is left: for places around a goal, for configurations of a goal, for the tree, and for each
# plan, so that others follow.
AROUND_SHARE, FIND_SHARE, TREE_SHARE, TRY_SHARE = 0.6, 0.5, 0.5, 0.5

# Checks of a tree, which take about 0.1 s, and their coarseness [m]; the tree is the same on every machine.
TREE_CHECKS = 3000
TREE_STEP_M = 0.01

# A goal is worth suggesting if it is nearer than the start by this share of the way, and one after it is further off
# by the other.
LEAST_GAIN, STEP_SHARE = 0.05, 0.1

DIGITS = 4  # digits of a suggested goal, which people read: a tenth of a millimetre, and a fifteenth of a servo's tick


def nearest_goal(
    problem: PlanningProblem,
    code: MoveItErrorCode,
    robot: RobotModel,
    states: GoalStates,
    collision: CollisionModel,
    plan: Callable[[PlanningProblem], Plan | PlanningFailure],
    budget: Budget,
) -> JointGoal | PositionGoal | PoseGoal | None:
    """Find the goal; None where none was found, PlanningError where the problem is refused for another reason."""
    try:
        checks.check_request(robot, problem)
    except PlanningError as error:
        # A goal beyond the limits is moved to the limits.
        if "upper_rad" not in error.failure.details:
            raise
    checks.check_start(robot, problem.start_rad)
    group = robot.groups[problem.group]
    start_q = collision.start(problem.start_rad, group.joints)
    allowed = collision.overlaps_m(start_q)
    holds, project = states.within(group, problem.path_constraints, start_q)
    space = JointSpace(collision, group.joints, start_q, allowed, holds, should_stop=budget.should_stop)
    search = _Search(problem, states, group, space, project, budget)
    for candidates, part in search.phases(problem.goal, around=code not in UNREACHED):
        for candidate in islice(candidates, TRIES):
            if part.used_up():
                break
            # Its plan must fit into the time that the problem allows, and leave time for others.
            allowed_s = min(problem.allowed_time_s, TRY_SHARE * part.left_s)
            tried = replace(problem, goal=candidate, allowed_time_s=allowed_s, optimization_time_s=0.0)
            if isinstance(plan(tried), Plan):
                return candidate
    return None


def ways_out(
    space: JointSpace, point: Vector, start: Vector, moving: Vector, should_stop: Callable[[], bool]
) -> list[tuple[float, Vector]]:
    """Return free points around one in contact, nearest first, with the travel there [m]; ``moving`` is 1 or 0."""
    found: list[tuple[float, Vector]] = []
    least_m = np.inf
    for direction in _directions(point, start, moving):
        if should_stop():
            break
        travel_m = float(np.abs(direction) @ space.travel_m_per_rad)
        if travel_m == 0.0:
            continue
        way, blocked_m = direction / travel_m, 0.0

        def end(distance_m: float, way: Vector = way) -> Vector:
            return np.clip(point + distance_m * way, space.lower_rad, space.upper_rad)

        for distance_m in DISTANCES_M:
            if blocked_m >= least_m:
                break
            if space.free(end(distance_m)):
                free_m = furthest(lambda distance_m: space.free(end(distance_m)), distance_m, blocked_m)
                found.append((free_m, end(free_m)))
                least_m = min(least_m, free_m)
                break
            blocked_m = distance_m
    return sorted(found, key=lambda each: each[0])


def furthest(holds: Callable[[float], bool], yes: float, no: float) -> float:
    """Return the last value from one at which a condition holds to one at which it does not, by bisection."""
    for _ in range(HALVINGS):
        middle = 0.5 * (yes + no)
        yes, no = (middle, no) if holds(middle) else (yes, middle)
    return yes


def _directions(point: Vector, start: Vector, moving: Vector) -> Iterator[Vector]:
    """Yield ways out: back to the start, by each joint alone, and by all of them."""
    yield (start - point) * moving
    for joint in np.flatnonzero(moving):
        for sign in (1.0, -1.0):
            way = np.zeros(len(point))
            way[joint] = sign
            yield way
    yield from np.random.default_rng(DIRECTIONS_SEED).normal(size=(DIRECTIONS, len(point))) * moving


_TipOrJointGoal = JointGoal | PositionGoal | PoseGoal


class _Search:
    """Candidates for one problem, most promising first."""

    def __init__(
        self,
        problem: PlanningProblem,
        states: GoalStates,
        group: Group,
        space: JointSpace,
        project: Project | None,
        budget: Budget,
    ) -> None:
        self._problem, self._states, self._group = problem, states, group
        self._space, self._budget = space, budget
        self._project = project or (lambda point: np.clip(point, space.lower_rad, space.upper_rad))
        self._start = space.start

    def phases(self, goal: AnyGoal, *, around: bool) -> Iterator[tuple[Iterator[_TipOrJointGoal], Budget]]:
        """Yield the candidates of each way to look for them, and the time for it."""
        match goal:
            # The check of a goal ends at the first flaw, which another flaw may follow.
            case JointGoal(positions_rad) if positions_rad.keys() <= set(self._group.joints) and not any(
                math.isnan(value) for value in positions_rad.values()
            ):
                if around:
                    part = self._budget.share(AROUND_SHARE)
                    yield self._joint_goals(goal, part), part
                yield self._reached_joint_goals(goal), self._budget
            case PositionGoal() | PoseGoal():
                yield self._tip_goals(goal), self._budget

    def _joint_goals(self, goal: JointGoal, budget: Budget) -> Iterator[JointGoal]:
        """Yield joint goals near one, the first within the limits where one is beyond them."""
        asked, moving = self._asked(goal)
        point = np.clip(asked, self._space.lower_rad, self._space.upper_rad)
        if not np.array_equal(point, asked) and self._space.free(point):
            yield self._joint_goal(goal, point)
        for _, free in ways_out(self._space, point, self._start, moving, budget.used_up):
            yield self._joint_goal(goal, free)

    def _reached_joint_goals(self, goal: JointGoal) -> Iterator[JointGoal]:
        """Yield joint goals to which there are motions, those near one first, at last the furthest straight ahead."""
        asked, moving = self._asked(goal)
        target = np.clip(asked, self._space.lower_rad, self._space.upper_rad)
        # Joints that are not asked for stay.
        points = np.where(moving > 0.0, self._reachable([target]), self._start)
        away_m = np.abs(points - target) @ self._space.travel_m_per_rad
        for point in points[spread(away_m, TRIES - 1)]:
            if moving.all() or self._space.free(point):
                yield self._joint_goal(goal, point)
        way = target - self._start
        share = furthest(lambda share: line_free(self._space, self._start, self._start + share * way), 0.0, 1.0)
        if share > 0.0:
            yield self._joint_goal(goal, self._start + share * way)

    def _tip_goals(self, goal: PositionGoal | PoseGoal) -> Iterator[PositionGoal | PoseGoal]:
        """Yield goals of the tip: at the nearest place within reach, then at places to which there are motions."""
        start_q, budget = self._space.configuration(self._start), self._budget.share(FIND_SHARE)
        query = GoalQuery(self._group, start_q, None, budget, CONFIGURATIONS, avoid_collisions=False)
        found = self._states.find(goal, query)
        states = [] if isinstance(found, PlanningFailure) else found
        asked_m = np.array(goal.position_m)
        if isinstance(found, PlanningFailure) and "nearest_m" in found.details:
            asked_m = np.array(found.details["nearest_m"])
            yield moved_to(goal, asked_m)
        points = self._reachable([self._space.point(state.q) for state in states])
        places_m = np.array([self._states.point_m(goal, self._space.configuration(point)) for point in points])
        for place_m in places_m[spread(np.linalg.norm(places_m - asked_m, axis=1), TRIES)]:
            yield moved_to(goal, place_m)

    def _asked(self, goal: JointGoal) -> tuple[Vector, Vector]:
        """Return the point of a joint goal, and which of its joints are asked for, 1 or 0; shape (n,) each."""
        joints = zip(self._group.joints, self._start, strict=True)
        point = np.array([goal.positions_rad.get(name, at) for name, at in joints])
        return point, np.array([float(name in goal.positions_rad) for name in self._group.joints])

    def _joint_goal(self, goal: JointGoal, point: Vector) -> JointGoal:
        rounded = np.clip(np.round(point, DIGITS), self._space.lower_rad, self._space.upper_rad)
        values = dict(zip(self._group.joints, rounded.tolist(), strict=True))
        return replace(goal, positions_rad={name: values[name] for name in goal.positions_rad})

    def _reachable(self, goals: Sequence[Vector]) -> Vector:
        space, budget = self._space, self._budget.share(TREE_SHARE)
        query, most = Query(space, self._start, goals, TREE_STEP_M), space.checks + TREE_CHECKS
        seed = self._problem.seed
        return reachable(query, self._project, seed, lambda: space.checks >= most or budget.used_up())


def spread(away_m: Vector, most: int) -> list[int]:
    """Choose ``most`` points nearer to a goal than the first by ``away_m``, nearest first, each a step further off."""
    chosen: list[int] = []
    limit_m = (1.0 - LEAST_GAIN) * float(away_m[0])
    for index in np.argsort(away_m, kind="stable").tolist():
        step_m = STEP_SHARE * float(away_m[0] - away_m[chosen[0]]) if chosen else 0.0
        if len(chosen) == most or away_m[index] > limit_m:
            break
        if not chosen or away_m[index] >= away_m[chosen[-1]] + step_m:
            chosen.append(index)
    return chosen


def moved_to(goal: PositionGoal | PoseGoal, place_m: Vector) -> PositionGoal | PoseGoal:
    """Return a goal at another place, shape (3,) [m]."""
    x, y, z = (round(value, DIGITS) for value in place_m.tolist())
    if isinstance(goal, PositionGoal):
        return replace(goal, position_m=(x, y, z))
    return replace(goal, pose=replace(goal.pose, position_m=(x, y, z)))


# The end is rounded, and a path that ends there brakes there, so it may have to be a little shorter [m].
LESS_M = (0.0, 0.0005, 0.002, 0.005)

SHARES = (0.9, 0.75, 0.5, 0.25)  # shares that are tried where no part near the end could be planned
LEAST_M = 0.001  # shorter parts are no motion [m]
TOLERANCE_M = 0.001  # tolerance of the path's end as a goal of its own, as most clients of MoveIt have it [m]

# Failures of a path that could be followed in part: it takes too long to plan, or cannot be timed.
UNFOLLOWED = (MoveItErrorCode.TIMED_OUT, MoveItErrorCode.PLANNING_FAILED)

OTHER_WAY_SHARE = 0.5  # a search for another way has no more of the time than this share


def nearest_end(
    problem: CartesianProblem,
    robot: RobotModel,
    collision: CollisionModel,
    forward: ForwardKinematics,
    plan: Callable[[PlanningProblem], Plan | PlanningFailure],
    budget: Budget,
) -> PathGoal | None:
    """Find how far a path that fails can be followed, and if ``plan`` finds another way to its end; None if neither."""

    def follow(path: CartesianProblem) -> CartesianPlan | PlanningFailure:
        try:
            return plan_cartesian(path, robot, collision, forward, budget)
        except PlanningError as error:
            return error.failure

    followed = follow(problem)
    if isinstance(followed, PlanningFailure) and followed.code not in UNFOLLOWED:
        return None
    forward.place(collision.start(problem.start_rad, robot.groups[problem.group].joints))
    start = forward.placement(problem.link).copy()
    length_m = TipPath(start, problem.segments).length_m
    most_m = followed.fraction * length_m if isinstance(followed, CartesianPlan) else length_m
    end, along_m = None, 0.0
    lengths_m = [most_m - less_m for less_m in LESS_M] + [share * most_m for share in SHARES]
    for part_m in sorted({length_m for length_m in lengths_m if length_m > LEAST_M}, reverse=True):
        if budget.used_up():
            break
        part = replace(problem, segments=first_part(start, problem.segments, part_m, DIGITS))
        found = follow(part)
        if isinstance(found, CartesianPlan) and found.stopped_by is None:
            end, along_m = part.segments[-1].end, part_m
            break
    other_way = not budget.used_up() and isinstance(plan(end_as_goal(problem, OTHER_WAY_SHARE * budget.left_s)), Plan)
    if end is None and not other_way:
        return None
    return PathGoal(end, along_m / length_m if length_m > 0.0 else 0.0, length_m, other_way)


def end_as_goal(problem: CartesianProblem, allowed_time_s: float) -> PlanningProblem:
    """Return the problem of a motion to a path's end that need not follow the path."""
    end = problem.segments[-1].end
    goal: PositionGoal | PoseGoal = PositionGoal(problem.link, end.position_m, TOLERANCE_M)
    if problem.keep_orientation:
        goal = PoseGoal(problem.link, end, TOLERANCE_M, (problem.orientation_tolerance_rad,) * 3, strict=True)
    return PlanningProblem(
        problem.group,
        problem.start_rad,
        goal,
        problem.velocity_scaling,
        problem.acceleration_scaling,
        allowed_time_s,
        path_constraints=problem.path_constraints,
        optimization_time_s=0.0,
    )

"""Search for a motion: from a start and goal configurations to a timed motion, certified as it will be executed.

A straight line comes first, then two of them by way of a point, then searches by OMPL. A path that was found is
shortened in time: random parts of it are replaced by least-time ramps where those are free.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import count, pairwise

import numpy as np

from planners.budget import Budget
from planners.geometry.certificate import certify
from planners.geometry.joint_space import JointSpace
from planners.motions.curve import (
    TICK_S,
    Curve,
    Ways,
    averaged,
    averaging_start,
    brake,
    from_moving,
    least_time_s,
    line,
    polyline,
    reduced,
    same_point,
    whole_ticks,
    window_ticks,
)
from planners.motions.path import (
    NOMINAL_CHECKS_PER_S,
    PROJECTED_SEARCH,
    RRT_CONNECT,
    ConnectSearch,
    Project,
    Query,
    TreeSearch,
    amid_steps,
    curve_free,
    line_free_sparsely,
    via_point,
    without_detours,
)
from planners.motions.path_timing import MAX_DURATION_S, standing
from planners.problem import VIA_POINT, MoveItErrorCode, PlanningFailure, RateLimits, planner_name
from robot.trajectory import Trajectory, Vector

# Rounds, after which without a gain a curve is about as short as it gets, and parts in each. One numpy call gives the
# times that they would save: of all rounds at once in 270 us, of one in 170.
PARTS = 5, 32
ROUNDS = np.arange(PARTS[0])[:, np.newaxis]
TRIES_A_ROUND = 4  # parts of a round that are tried, those first that save most
SHRINK = 0.7  # parts become shorter by this factor from round to round, and longer again after a gain
LEAST_GAIN_TICKS = 100  # a part that saves less does not pay for its checks [ticks]
FIRST_LOOKS = np.array([0.5, 0.25, 0.75, 0.125, 0.375, 0.625, 0.875])  # checked first, as shares of a part's time

STRAIGHT_LINE = "straight line"
SPARSE_STEP_M = 0.2  # sparse check of a straight line before it is timed: most blocked ones are found here [m]

# Coarse checks of edges [m] and curves [share of the reach] let trees grow and motions shorten soonest; all are finer
# after a contact half-way (SO-101: 0.85 of p95) or in the certificate. Steps of 0.04 m make SO-101's motions longer.
SEARCH_STEPS_M = (0.08, 0.03, 0.01, 0.005)
CURVE_STEPS = (0.04, 0.02, 0.01, 0.002)

CHECKS_A_ROUND = 6000  # work after which the shortest motion so far is certified: little is left as the time is over

# A search that has found nothing by then, in some 10 s, is given up for another: trees would grow without a bound. Two
# searches in turns take as many checks.
CHECKS_A_SEARCH = 300_000


@dataclass(frozen=True)
class MotionTask:
    """Move from a point of the joint space to any one of the goals."""

    space: JointSpace  # the joints that move
    joint_names: tuple[str, ...]  # their names
    limits: RateLimits  # limits of the motion
    start: Vector  # shape (n,) [rad]
    start_velocity: Vector  # shape (n,), within the limits [rad/s]
    goals: Sequence[Vector]  # free points, the soonest first
    seed: int = 0  # same task and seed, same motion
    attempts: int = 100  # number of searched motions, at most; the shortest is taken
    planner_id: str = ""  # the search, as planners.problem.planner_name knows it
    # Time to search for shorter motions, as the amount of work that nominally takes it; infinite for as many searches
    # as the budget allows [s].
    optimization_time_s: float = 0.0
    # Brings points to ones nearby where the space's condition holds, or returns None; with it there is a search of its
    # own, since others hardly ever draw a point that meets a condition.
    project: Project | None = None

    @cached_property
    def window(self) -> int:
        """Window over which curves are averaged to keep the limits of the jerk, 0 for none [ticks]."""
        return window_ticks(self.limits)

    @cached_property
    def least_s(self) -> float:
        """Return the time that the soonest goal takes where nothing is in the way; 0 without a goal [s]."""
        goals, rest = np.array(self.goals).reshape(-1, len(self.start)), np.zeros_like(self.start)
        times_s = least_time_s(self.start, self.start_velocity, goals, rest, self.limits)
        return float(times_s.min()) if len(goals) else 0.0

    @property
    def curve_start(self) -> Vector:
        """Point from which a curve must start whose average starts in the start, shape (n,) [rad]."""
        return averaging_start(self.start, self.start_velocity, self.window)


@dataclass(frozen=True)
class Motion:
    """A certified motion."""

    trajectory: Trajectory  # from the start to a goal
    method: str  # "straight line", "via point", or the search that found its path
    goal: int  # index of the goal that it reaches


def find_motion(task: MotionTask, budget: Budget) -> Motion | PlanningFailure:
    """Move straight where that is free, else search; ValueError: there is no such planner.

    Once the budget is used up, the best motion found by then is the answer. There is none where it was used up before,
    where every motion would take too long, or where a moving arm cannot stop before it touches something.
    """
    answer = _too_slow(task) or _straight(task, budget)
    if answer is not None:
        return answer
    moving = bool(task.start_velocity.any())
    lead = brake(task.curve_start, task.start_velocity, task.limits) if moving else None
    refusal = None if lead is None else _cannot_stop(task, lead)
    return refusal or _Searching(task, budget, lead).best() or budget.failure()


def _too_slow(task: MotionTask) -> PlanningFailure | None:
    """Return the refusal of a task whose limits are so low that no motion to any goal ends in time."""
    if task.least_s <= MAX_DURATION_S:
        return None
    text = f"the motion takes {task.least_s:.6g} s at least, more than the limit of {MAX_DURATION_S:g} s"
    details = {"least_s": task.least_s, "limit_s": MAX_DURATION_S}
    return PlanningFailure(MoveItErrorCode.FAILURE, f"{text}: raise the velocity and acceleration scaling", details)


def _straight(task: MotionTask, budget: Budget) -> Motion | None:
    """Return the motion to the first goal that can be reached without a search."""
    moving = bool(task.start_velocity.any())
    for index, goal in enumerate(task.goals):
        if budget.used_up():
            return None
        if moving:
            curve = from_moving(task.curve_start, task.start_velocity, goal, task.limits)
        elif same_point(task.start, goal):
            return Motion(standing(task.joint_names, task.start), STRAIGHT_LINE, index)
        else:
            free = line_free_sparsely(task.space, task.start, goal, SPARSE_STEP_M)
            curve = line(task.start, goal, task.limits) if free else None
        trajectory = None if curve is None else _certified(task, curve)
        if trajectory is not None:
            return Motion(trajectory, STRAIGHT_LINE, index)
    return None


def _certified(task: MotionTask, curve: Curve) -> Trajectory | None:
    """Return the curve's samples, their jerk limited, if nothing touches on them."""
    if not curve.stays_within(task.space.lower_rad, task.space.upper_rad):
        return None
    names = task.joint_names
    trajectory = averaged(curve, task.window, names) if task.window else curve.sampled(names)
    return None if certify(task.space, trajectory) else trajectory


def _cannot_stop(task: MotionTask, lead: Curve) -> PlanningFailure | None:
    """Return the failure if a search from the stopping point is of no use, else None."""
    stop = lead.positions_rad[-1]
    if np.any((stop < task.space.lower_rad) | (stop > task.space.upper_rad)):
        text = "the arm moves too fast to stop within its joint limits"
        return PlanningFailure(MoveItErrorCode.START_STATE_INVALID, text)
    contact = certify(task.space, lead.sampled(task.joint_names))
    if contact is None:
        return None
    pairs = [[pair.first, pair.second] for pair in contact.pairs]
    text = f"the arm moves too fast to stop before it touches something after {contact.time_s:.2f} s"
    details = {"time_s": contact.time_s, "colliding_pairs": pairs}
    return PlanningFailure(MoveItErrorCode.START_STATE_INVALID, text, details)


class _Searching:
    """Several searches for one task, and their results."""

    def __init__(self, task: MotionTask, budget: Budget, lead: Curve | None) -> None:
        self._task = task
        self._budget = budget
        name = planner_name(task.planner_id)
        if name is None:
            raise ValueError(f"there is no planner {task.planner_id!r}")
        self._name = name if task.project is None else PROJECTED_SEARCH
        self._space = task.space
        self._rng = np.random.default_rng(task.seed)
        self._number = count()
        self._search: TreeSearch | ConnectSearch | None = None  # a search that has not found a path
        self._search_end = 0  # checks after which it is given up
        self._finer = 0
        self._lead = lead
        # Where no via point of the quickest is free, others hardly ever are.
        self._try_via_points = self._name == RRT_CONNECT
        # Checks after which no shorter motion is looked for, and no other curve in this round; infinite without one.
        self._last_check = self._round_end = np.inf

    def best(self) -> Motion | None:
        """Return the shortest in time of the motions found while there is work to be done."""
        best: Motion | None = None
        searches = self._task.attempts if np.isfinite(self._task.optimization_time_s) else np.inf
        while searches > 0 and not self._budget.used_up() and not (best and self._space.checks >= self._last_check):
            found = self._found(searches, has_motion=best is not None)
            searches -= len(found)
            known, any_shorter = best, False
            for method, stages in sorted(found, key=lambda each: each[1][-1].duration_ticks):
                shorter = [one for one in stages if not best or TICK_S * one.ticks[-1] < best.trajectory.duration_s]
                any_shorter = any_shorter or bool(shorter)
                best = self._shortest(method, shorter) or best
            if any_shorter and best is known:
                self._finer = min(self._finer + 1, len(SEARCH_STEPS_M) - 1)
            if best is None and found:
                searches = self._task.attempts
        return best

    def _shortest(self, method: str, stages: Sequence[Curve]) -> Motion | None:
        """Return the motion along the last of ever shorter curves that can be certified."""
        # Where the first touches something, so does all that became of it, as a rule.
        free, touching, tried, motion = -1, len(stages), len(stages) - 1, None
        while touching - free > 1:
            # The best motion is still of use after the deadline, but not once the request is cancelled.
            trajectory = None if self._budget.should_stop() else _certified(self._task, stages[tried])
            if trajectory is None:
                touching = tried
            else:
                free, end = tried, stages[tried].positions_rad[-1]
                reached = next(i for i, q in enumerate(self._task.goals) if np.array_equal(q, end))
                motion = Motion(trajectory, method, reached)
            tried = 0 if free < 0 else (free + touching) // 2
        return motion

    def _found(self, searches: float, *, has_motion: bool) -> list[tuple[str, list[Curve]]]:
        """Return the curves found in a round, by which search, each with its shorter and shorter stages."""
        found: list[tuple[str, list[Curve]]] = []
        self._round_end = self._space.checks + CHECKS_A_ROUND if has_motion else np.inf
        self._last_check = self._last_check if has_motion else np.inf
        while len(found) < searches and not self._enough():
            began = self._space.checks
            method, path = self._path(next(self._number))
            step_m = CURVE_STEPS[self._finer] * float(self._space.travel_m_per_rad.max())
            if path is None or not self._holds(path, step_m):
                continue
            effort = self._space.checks - began
            curve = polyline(path, self._task.limits, self._task.window)
            curve = curve if self._lead is None else self._lead.then(curve)
            if np.isinf(self._round_end):
                self._last_check = self._space.checks + NOMINAL_CHECKS_PER_S * self._task.optimization_time_s
                self._round_end = self._space.checks + CHECKS_A_ROUND
            along = partial(curve_free, self._space, step_m=step_m, should_stop=self._budget.used_up)
            stages = smooth(curve, self._task.limits, self._space.free, along, self._rng, self._enough)
            found.append((method, stages))
            # Obstacles cost it hardly any time, or no other path is found in the checks that are left.
            quickest = TICK_S * (stages[-1].duration_ticks - LEAST_GAIN_TICKS) < self._task.least_s
            if quickest or self._last_check - self._space.checks < effort:
                self._last_check = self._space.checks
        return found

    def _path(self, number: int) -> tuple[str, Vector | None]:
        """Return how a path was searched for, and the path without its detours if there is one."""
        start = self._task.start if self._lead is None else self._lead.positions_rad[-1]
        query = Query(self._space, start, self._task.goals, SEARCH_STEPS_M[self._finer])
        if self._try_via_points:
            path = via_point(query, self._task.limits.velocity_rad_s, self._rng, self._enough)
            self._try_via_points = path is not None
            if path is not None:
                return VIA_POINT, path
        path = self._searched(query, number)
        if path is not None:
            path = without_detours(self._space, path, query.step_m, self._budget.used_up)
        return self._name, path

    def _holds(self, path: Vector, step_m: float) -> bool:
        """Return true if a path is free amid the search's steps too, where curves have shorter ones; else refine."""
        search_m = SEARCH_STEPS_M[self._finer]
        edges = () if 0.5 * search_m <= step_m else pairwise(path)
        free = all(self._space.free(point) for edge in edges for point in amid_steps(self._space, *edge, search_m))
        self._finer = min(self._finer + (not free), len(SEARCH_STEPS_M) - 1)
        return free

    def _searched(self, query: Query, number: int) -> Vector | None:
        """Let the search go on, or another once it has found a path, or nothing for long."""
        if self._search is None or self._space.checks >= self._search_end:
            seed, ours = self._task.seed + number, self._name in (RRT_CONNECT, PROJECTED_SEARCH)
            search = ConnectSearch(query, self._task.project, seed) if ours else TreeSearch(query, self._name, seed)
            self._search, self._search_end = search, self._space.checks + CHECKS_A_SEARCH
        path = self._search.run(lambda: self._space.checks >= self._search_end or self._enough())
        self._search = self._search if path is None else None
        return path

    def _enough(self) -> bool:
        """Tell whether a round has done its share of the work, or the budget is used up."""
        return self._budget.used_up() or self._space.checks >= min(self._last_check, self._round_end)


def smooth(
    curve: Curve,
    limits: RateLimits,
    free: Callable[[Vector], bool],
    along: Callable[[Curve], bool],
    rng: np.random.Generator,
    should_stop: Callable[[], bool],
) -> list[Curve]:
    """Return a free curve, then ever shorter ones by pieces whose points are ``free``, all ``along``; ends stay."""
    stages, reach, solved_for = [curve], 1.0, reduced(limits)
    while not should_stop():
        curve = stages[-1]
        middles, lengths = rng.random((2, *PARTS))
        halves = 0.5 * reach * SHRINK**ROUNDS * lengths
        shares = np.clip((middles - halves, middles + halves), 0.0, 1.0)
        first, last = ends = np.rint(shares * curve.duration_ticks).astype(np.int64).reshape(2, -1)
        (p0, p1), (v0, v1) = (each.reshape(2, len(first), -1) for each in curve.at(ends.ravel())[:2])
        ticks = whole_ticks(least_time_s(p0, v0, p1, v1, solved_for))
        gains = last - first - ticks
        best = np.argsort(-gains.reshape(PARTS), axis=1, kind="stable")[:, :TRIES_A_ROUND] + PARTS[1] * ROUNDS
        best = best[gains[best] >= LEAST_GAIN_TICKS]
        ways = Ways(p0[best], v0[best], p1[best], v1[best], ticks[best], limits)
        best, kept = best[ways.possible], np.flatnonzero(ways.possible)
        looks = zip(best.tolist(), kept.tolist(), ways.places(kept, FIRST_LOOKS), strict=True)
        pieces = ((i, ways.curve(k)) for i, k, points in looks if not should_stop() and all(map(free, points)))
        i, piece = next(((i, piece) for i, piece in pieces if along(piece)), (0, None))
        if piece is None:
            break
        stages.append(curve.replaced(int(first[i]), int(last[i]), piece))
        reach = min(1.0, reach * SHRINK ** (i // PARTS[1] - 1))
    return stages

"""Goal configurations, found by IK descents from sampled starts, or the failure that is true of a goal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.budget import Budget
from planners.checks import check_start_contact, contact_failure, in_words
from planners.geometry.collision import CollidingPair, CollisionModel
from planners.geometry.kinematics import ForwardKinematics, Placements
from planners.goals import (
    AnyGoal,
    AnyOf,
    AxisGoal,
    ConstraintGoal,
    Constraints,
    JointGoal,
    PoseGoal,
    PositionGoal,
    SingleGoal,
)
from planners.ik.constraints import (
    ROTATION_ARM_M,
    Condition,
    ConditionSet,
    GoalConditions,
    JointCondition,
    TaskGoal,
    Violation,
    conditions,
    goal_conditions,
)
from planners.ik.kinematics import Descent, Kinematics
from planners.problem import Deviation, MoveItErrorCode, PlanningError, PlanningFailure
from robot.description.model import Group, RobotModel
from robot.trajectory import Vector


def goal_in_collision(pairs: Sequence[CollidingPair]) -> PlanningFailure:
    """Return the failure of a goal that holds in contact only."""
    return contact_failure(MoveItErrorCode.GOAL_IN_COLLISION, "in the goal these would touch", pairs)


def goal_violates(violations: Sequence[Violation]) -> PlanningFailure:
    """Return the failure of a goal that violates the constraints."""
    return _violated(MoveItErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS, "the goal violates the constraints", violations)


def check_start_place(pairs: Sequence[CollidingPair], violations: Sequence[Violation]) -> None:
    """Check for contact at the start, where shallow contact is allowed, and for violated path constraints."""
    check_start_contact(pairs)
    if violations:
        code = MoveItErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS
        raise PlanningError(_violated(code, "the start violates the path constraints", violations))


def none_of(failures: Sequence[PlanningFailure]) -> PlanningFailure:
    """Return the failure of several alternatives: the message of the first, and all of them in the details."""
    first = failures[0]
    others = [{"code": int(failure.code), "message": failure.message} for failure in failures]
    message = f"no alternative of {len(failures)} can be reached; the first: {first.message}"
    return PlanningFailure(first.code, message, {**first.details, "alternatives": others})


def out_of_reach(
    goal: TaskGoal, nearest_m: Sequence[float], nearest: Deviation, violations: Sequence[Violation]
) -> PlanningFailure:
    """Return the failure of a goal, with the nearest place, shape (3,) [m], and the deviation and violations there."""
    if isinstance(goal, ConstraintGoal):
        text = "no configuration meets all constraints; in the nearest one"
        return _violated(MoveItErrorCode.NO_IK_SOLUTION, text, violations)
    point = [round(float(value), 4) for value in nearest_m]
    details: dict[str, Any] = {"nearest_m": point, "distance_m": nearest.position_m}
    details |= {"orientation_rad": nearest.orientation_rad, "tolerance_m": goal.tolerance_m}
    if isinstance(goal, PositionGoal) or nearest.position_m > goal.tolerance_m:
        any_will_do = isinstance(goal, PositionGoal) or (isinstance(goal, PoseGoal) and not goal.strict)
        orientation = "whatever its orientation" if any_will_do else "in the orientation asked for"
        sentence = f"cannot reach {in_words(goal.position_m)} m, {orientation}: the nearest point it can reach is"
        units = "; positions are in metres" if nearest.position_m > 10.0 else ""  # millimetres, perhaps
        sentence += f" {in_words(point)} m, {100.0 * nearest.position_m:.1f} cm away{units}"
    else:
        sentence = f"reaches {in_words(goal.position_m)} m, but not in the orientation asked for:"
        sentence += f" the nearest one there is {math.degrees(nearest.orientation_rad):.1f}° off"
    return PlanningFailure(MoveItErrorCode.NO_IK_SOLUTION, f"{goal.link!r} {sentence}", details)


def out_of_time(
    goal: TaskGoal, failure: PlanningFailure, nearest_m: Sequence[float], nearest: Deviation
) -> PlanningFailure:
    """Add the nearest point so far to the failure of a search that was ended; arguments as :func:`out_of_reach`."""
    if isinstance(goal, ConstraintGoal):
        return failure
    point = [round(float(value), 4) for value in nearest_m]
    message = f"{failure.message}; the nearest point so far is {in_words(point)} m,"
    message += f" {100.0 * nearest.position_m:.1f} cm away"
    return replace(
        failure, message=message, details={**failure.details, "nearest_m": point, "distance_m": nearest.position_m}
    )


def _violated(code: MoveItErrorCode, what: str, violations: Sequence[Violation]) -> PlanningFailure:
    sentences = "; ".join(violation.sentence for violation in violations)
    return PlanningFailure(code, f"{what}: {sentences}", {"violations": [dict(v.details) for v in violations]})


FRUITLESS_RESTARTS = 6  # restarts without a new solution, when there is one, after which more rarely find any

# Restarts in a row that come no nearer to a goal out of reach; of 1000 poses within reach none needed more.
HOPELESS_RESTARTS = 20
NEARER_M = 0.001

DISTINCT_RAD = 0.1  # solutions closer than this to a known one in every joint, whole turns apart, are the same

# A whole turn of a joint leaves the robot where it is, so each solution is also a goal with joints turned once around
# where their limits allow it. The nearest of these goals is reached soonest; where it is blocked, as by the floor below
# a shoulder, the way to another one leads to the other side. UR5's joints would have 32 a solution.
TURN_RAD = 2.0 * math.pi
TURNED_A_SOLUTION = 4

MAX_SOLUTIONS = 6  # more goals than this hardly shorten the motion

# Preferences that are missed by this much more than in the best configuration count as equal: a servo arm cannot show
# the difference.
PREFERENCE_SLACK_RAD = 0.02

# Configurations drawn once; those nearest to a target start the restarts. Placing them takes 4 ms, once per link.
SAMPLES = 2000
SAMPLE_SEED = 7

RESTARTS = 30  # of 1000 reachable targets placo solves 99 % collision-free with 10 restarts and all with 30
RESTARTS_AMONG_OBSTACLES = 100  # further restarts, from free samples, where all of these end in contact
ALREADY_THERE_RAD = 1e-6  # a joint goal this near already holds: a servo's step is 1.5 mrad


@dataclass(frozen=True)
class SearchResult:
    """Configurations that the descents of one search found."""

    # Free configurations in which the required conditions hold and the preferred ones hold best, and their whole turns,
    # least time from the seed first.
    solutions: tuple[Vector, ...]
    # Contacts in the first configuration in which the required conditions hold, if all of them have some.
    colliding: tuple[CollidingPair, ...]
    nearest_q: Vector  # the configuration that comes nearest, free of contacts if any is
    nearest: Deviation  # its deviation from the conditions


@dataclass(frozen=True)
class _End:
    """End of one descent; it is tight where hulls touch something, and collides where more than the hulls does."""

    q: Vector
    tight: bool
    violation_m: float
    preference_error_m: float
    collision: CollisionModel | None

    @cached_property
    def collides(self) -> bool:
        # By parts it takes as long as two descents, and is of no use where an end is found that is not tight.
        return self.tight and self.collision is not None and self.collision.collides(self.q)

    @property
    def roomy(self) -> bool:
        return self.violation_m == 0.0 and not self.tight

    @property
    def solves(self) -> bool:
        return self.violation_m == 0.0 and not self.collides


class DescentResults:
    """Results of the descents of one search so far; ``turning`` marks joints that may turn once around, shape (n,)."""

    def __init__(
        self,
        forward: ForwardKinematics,
        collision: CollisionModel | None,
        goal_conditions: GoalConditions,
        turning: NDArray[np.bool_],
    ) -> None:
        self._collision = collision
        self._turning = turning
        self._required = ConditionSet(forward, goal_conditions.required)
        self._preferred = ConditionSet(forward, goal_conditions.preferred)
        self._both = ConditionSet(forward, (*goal_conditions.required, *goal_conditions.preferred))
        self._ends: list[_End] = []
        self._least_violation_m, self._least_preference_error_m = math.inf, math.inf
        self.begin()

    def begin(self, patience: int = HOPELESS_RESTARTS) -> None:
        """Begin a series of descents; ``patience`` of them may be fruitless as long as there is no solution."""
        self._fruitless, self._patience = 0, patience

    def enough(self, wanted: int) -> bool:
        """Tell whether more descents would hardly help."""
        good = [end for end in self._ends if end.roomy]
        patience = FRUITLESS_RESTARTS if good else self._patience
        return sum(end.preference_error_m == 0.0 for end in good) >= wanted or self._fruitless >= patience

    @property
    def any_solution(self) -> bool:
        """True when a free configuration was found in which the required conditions hold."""
        return any(end.roomy for end in self._ends) or any(end.solves for end in self._ends)

    @property
    def only_touching(self) -> bool:
        """True when the required conditions hold only in configurations in contact, of those found."""
        return not self.any_solution and any(end.violation_m == 0.0 for end in self._ends)

    @property
    def only_colliding(self) -> bool:
        """True when every configuration found is in contact."""
        return all(end.tight for end in self._ends) and all(end.collides for end in self._ends)

    def add(self, q: Vector) -> None:
        """Take the end of one descent."""
        self._fruitless += 1
        if self._known(q, (end.q for end in self._ends if end.roomy)):
            return
        tight = self._collision is not None and self._collision.in_collision(q)
        end = _End(q, tight, self._required.violation_m(q), self._preferred.violation_m(q), self._collision)
        self._ends.append(end)
        if end.violation_m < self._least_violation_m - NEARER_M:
            self._least_violation_m, self._fruitless = end.violation_m, 0
        if end.roomy:
            if end.preference_error_m <= max(0.0, self._least_preference_error_m - NEARER_M):
                self._fruitless = 0
            self._least_preference_error_m = min(self._least_preference_error_m, end.preference_error_m)

    def result(self, arrange: Callable[[list[Vector]], tuple[Vector, ...]]) -> SearchResult:
        """Return the solutions in the arrangement that a function gives them, or the nearest configuration."""
        # Where only parts within the hulls are apart, motions are slow to check and rarely found.
        roomy = [end for end in self._ends if end.roomy]
        for end in self._ends if not roomy else ():
            if end.solves and not self._known(end.q, (other.q for other in roomy)):
                roomy.append(end)
        nearest = min(roomy or self._ends, key=lambda end: (end.collides, end.violation_m, end.preference_error_m))
        deviation = self._both.deviation(nearest.q)
        if not roomy:
            meeting = next((end for end in self._ends if end.violation_m == 0.0), None)
            return SearchResult((), self._pairs(meeting), nearest.q, deviation)
        most_m = min(end.preference_error_m for end in roomy) + ROTATION_ARM_M * PREFERENCE_SLACK_RAD
        preferred = [end.q for end in roomy if end.preference_error_m <= most_m]
        return SearchResult(arrange(preferred), (), nearest.q, deviation)

    def _known(self, q: Vector, others: Iterable[Vector]) -> bool:
        """Return true if a configuration is one of others, or whole turns from it where joints may turn once around."""
        apart = np.abs(q - np.array([*others]).reshape(-1, len(q)))
        turns = np.where(self._turning, np.rint(apart / TURN_RAD), 0.0)
        return bool((np.abs(apart - TURN_RAD * turns) < DISTINCT_RAD).all(axis=1).any())

    def _pairs(self, end: _End | None) -> tuple[CollidingPair, ...]:
        return tuple(self._collision.colliding_pairs(end.q)) if self._collision is not None and end is not None else ()


@dataclass(frozen=True)
class GoalState:
    """A configuration in which a goal holds."""

    q: Vector  # the configuration, shape (n,) [rad]
    deviation: Deviation  # from the goal


@dataclass(frozen=True)
class GoalQuery:
    """Query for configurations in which a goal holds."""

    group: Group  # the joints that may move
    start_q: Vector  # present configuration, shape (n,) [rad]
    constraints: Constraints | None  # constraints that must hold beside the goal
    budget: Budget  # ends the search
    wanted: int = MAX_SOLUTIONS  # number of configurations that are enough
    avoid_collisions: bool = True  # False to accept configurations in contact
    accept_start: bool = True  # True to accept the start even in contact, as a motion may begin there


class GoalStates:
    """Goal configurations ``q`` of one robot, in the order of its collision model's joints."""

    def __init__(self, robot: RobotModel, collision: CollisionModel) -> None:
        self.forward = ForwardKinematics(robot, collision.joint_names)
        self._collision = collision
        self._kinematics = Kinematics(robot, self.forward, collision.joint_names)
        self._max_velocity = np.array([robot.joints[name].max_velocity for name in collision.joint_names])
        limits = collision.lower_rad, collision.upper_rad
        followed = {joint.mimic.joint for joint in robot.joints.values() if joint.mimic}
        angular = [robot.joints[name].unit == "rad" and name not in followed for name in collision.joint_names]
        self._turning = np.array(angular) & (collision.upper_rad - collision.lower_rad >= TURN_RAD)
        self._samples = np.random.default_rng(SAMPLE_SEED).uniform(*limits, (SAMPLES, len(collision.joint_names)))
        self._placements: dict[str, Placements] = {}

    def within(
        self, group: Group, constraints: Constraints | None, start_q: Vector
    ) -> tuple[Callable[[Vector], bool] | None, Callable[[Vector], Vector | None] | None]:
        """Return the condition of constraints on configurations and the projection on them; None without any."""
        if constraints is None or constraints.empty:
            return None, None
        return self.condition_set(constraints).holds, self.projection(group, constraints, start_q)

    def condition_set(self, constraints: Constraints | None) -> ConditionSet:
        """Return the conditions of constraints."""
        return ConditionSet(self.forward, conditions(constraints, self._collision))

    def projection(self, group: Group, constraints: Constraints, start_q: Vector) -> Callable[[Vector], Vector | None]:
        """Return a projection of points of a group's joints, (n,) [rad], to where constraints hold; None on failure."""
        descent = Descent(self._kinematics, group, GoalConditions(conditions(constraints, self._collision)))
        columns = [self._collision.joint_names.index(name) for name in group.joints]

        def project(point: Vector) -> Vector | None:
            q = start_q.copy()
            q[columns] = point
            inside = descent.inside(q)
            return None if inside is None else inside[columns]

        return project

    def find(self, goal: AnyGoal, query: GoalQuery) -> Sequence[GoalState] | PlanningFailure:
        """Find configurations in which a checked goal holds, the soonest reached first; or why there is none."""
        if not isinstance(goal, AnyOf):
            return self._single(goal, query)
        answers = [self._single(single, query) for single in goal.goals]
        failures = [answer for answer in answers if isinstance(answer, PlanningFailure)]
        states = [state for answer in answers if not isinstance(answer, PlanningFailure) for state in answer]
        if not states:
            return failures[0] if len(failures) == 1 else none_of(failures)
        return sorted(states, key=lambda state: self._move_time_s(query.start_q, state.q))

    def point_m(self, goal: TaskGoal, q: Vector) -> list[float]:
        """Return the point of a goal's link [m]; the root link's origin for a goal of constraints."""
        self.forward.place(q)
        point_m = np.zeros(3)
        if isinstance(goal, PositionGoal):
            placement = self.forward.placement(goal.link)
            point_m = placement.translation + placement.rotation @ np.array(goal.offset_m)
        elif isinstance(goal, AxisGoal | PoseGoal):
            point_m = self.forward.placement(goal.link).translation
        return [float(value) for value in point_m]

    def _single(self, goal: SingleGoal, query: GoalQuery) -> Sequence[GoalState] | PlanningFailure:
        if isinstance(goal, JointGoal):
            return self._joint_goal(goal, query)
        also = conditions(query.constraints, self._collision)
        wanted = goal_conditions(goal, self._collision)
        whole = ConditionSet(self.forward, (*wanted.required, *wanted.preferred, *also))
        if query.accept_start and whole.holds(query.start_q):
            return [GoalState(query.start_q, whole.deviation(query.start_q))]
        found = self.search(wanted.also(also), query)
        if found.solutions:
            goal_set = ConditionSet(self.forward, (*wanted.required, *wanted.preferred))
            return [GoalState(q, goal_set.deviation(q)) for q in found.solutions]
        return self._refusal(goal, wanted, also, found, query)

    def _joint_goal(self, goal: JointGoal, query: GoalQuery) -> Sequence[GoalState] | PlanningFailure:
        goal_q = query.start_q.copy()
        for name, value in goal.positions_rad.items():
            goal_q[self._collision.joint_names.index(name)] = value
        goal_q = np.clip(goal_q, self._collision.lower_rad, self._collision.upper_rad)
        violations = self.condition_set(query.constraints).violations(goal_q)
        if violations:
            return goal_violates(violations)
        if query.accept_start and np.max(np.abs(goal_q - query.start_q)) <= ALREADY_THERE_RAD:
            return [GoalState(query.start_q, Deviation())]
        pairs = self._collision.colliding_pairs(goal_q) if query.avoid_collisions else []
        return goal_in_collision(pairs) if pairs else [GoalState(goal_q, Deviation())]

    def _refusal(
        self, goal: TaskGoal, wanted: GoalConditions, also: Sequence[Condition], found: SearchResult, query: GoalQuery
    ) -> PlanningFailure:
        if query.budget.used_up():
            nearest_m = self.point_m(goal, found.nearest_q)
            failure = out_of_time(goal, query.budget.failure(), nearest_m, found.nearest)
            return self._with_configuration(failure, found.nearest_q, query.group)
        if found.colliding:
            return goal_in_collision(found.colliding)
        if also:
            alone = self.search(wanted, query)
            if alone.solutions:
                return goal_violates(ConditionSet(self.forward, also).violations(alone.solutions[0]))
            found = alone
        return self._out_of_reach(goal, wanted, found, query)

    def _out_of_reach(
        self, goal: TaskGoal, wanted: GoalConditions, found: SearchResult, query: GoalQuery
    ) -> PlanningFailure:
        q = found.nearest_q
        if isinstance(goal, PoseGoal | AxisGoal):
            # The point with the nearest orientation there is more useful than a compromise between both.
            point, *turns = wanted.required
            if turns:
                found = self.search(GoalConditions((point,), (*turns, *wanted.preferred)), query)
            q = found.solutions[0] if found.solutions else found.nearest_q
        goal_set = ConditionSet(self.forward, (*wanted.required, *wanted.preferred))
        nearest = goal_set.deviation(q)
        failure = out_of_reach(goal, self.point_m(goal, q), nearest, goal_set.violations(q))
        return self._with_configuration(failure, q, query.group)

    def _with_configuration(self, failure: PlanningFailure, q: Vector, group: Group) -> PlanningFailure:
        if "nearest_m" not in failure.details:
            return failure
        nearest_rad = {name: float(q[self._collision.joint_names.index(name)]) for name in group.joints}
        return replace(failure, details={**failure.details, "nearest_rad": nearest_rad})

    def search(self, goal_conditions: GoalConditions, query: GoalQuery) -> SearchResult:
        """Find configurations in which conditions hold, or as nearly as possible; descents begin at the start."""
        collision = self._collision if query.avoid_collisions else None
        results = DescentResults(self.forward, collision, goal_conditions, self._turning)
        required = GoalConditions(goal_conditions.required)
        self._descend(results, goal_conditions, self._starts(goal_conditions, query), query)
        if goal_conditions.preferred and not results.any_solution:
            # The preferences may lead all descents away from where the required conditions hold.
            self._descend(results, required, self._starts(required, query), query)
        if results.only_touching and not query.budget.used_up():
            starts = self._free_samples_near(required, query)
            self._descend(results, required, starts, query, patience=RESTARTS_AMONG_OBSTACLES)
        if results.only_colliding:
            # Every descent ended in a contact: the nearest free point is then known to a few centimetres only.
            results.add(next(self._free_samples_near(goal_conditions, query), query.start_q))
        return results.result(lambda solutions: self._with_turns(solutions, required, query))

    def _with_turns(self, solutions: list[Vector], required: GoalConditions, query: GoalQuery) -> tuple[Vector, ...]:
        """Return solutions and their whole turns within the limits, least time from the start first."""
        columns = [self._collision.joint_names.index(name) for name in query.group.joints]
        columns = [column for column in columns if self._turning[column]]
        in_range = [condition for condition in required.required if isinstance(condition, JointCondition)]
        found: list[Vector] = []
        for solution in solutions if columns else ():
            turned = [q for q in self._turns(solution, columns, query.start_q) if all(c.holds(q) for c in in_range)]
            found += turned[:TURNED_A_SOLUTION]
        return tuple(sorted(found or solutions, key=lambda q: self._move_time_s(query.start_q, q)))

    def _turns(self, solution: Vector, columns: Sequence[int], start_q: Vector) -> list[Vector]:
        """Return a solution with each joint's turns nearest to the start, the nearest first."""
        choices = []
        for column in columns:
            turned = solution[column] + TURN_RAD * np.arange(-2, 3)
            turned = turned[
                (turned >= self._collision.lower_rad[column]) & (turned <= self._collision.upper_rad[column])
            ]
            choices.append(turned[np.argsort(np.abs(turned - start_q[column]), kind="stable")][:2])
        found = np.tile(solution, (math.prod(map(len, choices)), 1))
        found[:, columns] = list(product(*choices))
        times_s = np.sum(np.abs(found - start_q) / self._max_velocity, axis=1)
        return list(found[np.argsort(times_s, kind="stable")])

    def _move_time_s(self, start_q: Vector, goal_q: Vector) -> float:
        """Least time between configurations at the joints' velocity limits [s]."""
        return float(np.max(np.abs(goal_q - start_q) / self._max_velocity))

    def _descend(
        self,
        results: DescentResults,
        goal_conditions: GoalConditions,
        starts: Iterable[Vector],
        query: GoalQuery,
        patience: int = HOPELESS_RESTARTS,
    ) -> None:
        results.begin(patience)
        descent = Descent(self._kinematics, query.group, goal_conditions)
        for q in starts:
            results.add(descent(q))
            if results.enough(query.wanted) or query.budget.used_up():
                break

    def _starts(self, goal_conditions: GoalConditions, query: GoalQuery) -> Iterator[Vector]:
        """Yield the starts of descents: the robot's configuration, then the samples nearest to the conditions."""
        yield query.start_q
        yield from islice(self._samples_near(goal_conditions, query), RESTARTS)

    def _free_samples_near(self, goal_conditions: GoalConditions, query: GoalQuery) -> Iterator[Vector]:
        near = self._samples_near(goal_conditions, query)
        return islice((q for q in near if not self._collision.in_collision(q)), RESTARTS_AMONG_OBSTACLES)

    def _samples_near(self, goal_conditions: GoalConditions, query: GoalQuery) -> Iterator[Vector]:
        """Yield samples of the group's joints, the nearest to the conditions first."""
        moving = [self._collision.joint_names.index(name) for name in query.group.joints]
        distances_m = self._distances_m((*goal_conditions.required, *goal_conditions.preferred))
        for i in np.argsort(distances_m, kind="stable"):
            q = query.start_q.copy()
            q[moving] = self._samples[i][moving]
            for condition in goal_conditions.required:
                if isinstance(condition, JointCondition) and condition.column in moving:
                    q[condition.column] = condition.position_rad
            yield q

    def _distances_m(self, conditions: Sequence[Condition]) -> Vector:
        """Return each sample's distance from conditions on links, rotations by their arm [m]."""
        distances_m = np.zeros(SAMPLES)
        for condition in conditions:
            if isinstance(condition, JointCondition):
                continue
            if condition.link not in self._placements:
                self._placements[condition.link] = self.forward.placements(self._samples, condition.link)
            distances_m += condition.arm_m * condition.distances(self._placements[condition.link])
        return distances_m

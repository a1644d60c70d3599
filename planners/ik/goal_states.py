"""From a goal to configurations in which it holds, or the refusal that is true of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.budget import Budget
from planners.geometry.collision import CollisionModel
from planners.goals import AnyOf, AxisGoal, Constraints, Goal, JointGoal, PoseGoal, PositionGoal, SingleGoal
from planners.ik.constraints import Condition, ConditionSet, Joints, Wish, conditions, wish
from planners.ik.goal_refusals import TaskGoal, goal_in_collision, goal_violates, none_of, out_of_reach, out_of_time
from planners.ik.goal_search import MAX_SOLUTIONS, Found, GoalSearch
from planners.problem import Deviation, PlanningFailure
from robot.description.model import Group, RobotModel

Vector = NDArray[np.float64]

# A joint goal this near already holds: a servo's step is 1.5 mrad.
ALREADY_THERE_RAD = 1e-6


@dataclass(frozen=True)
class GoalState:
    """A configuration in which a goal holds.

    Attributes:
        q: the configuration, shape (n,) [rad].
        deviation: of what is there from what is asked.
        alternative: which of the goals it is, when there are several.
    """

    q: Vector
    deviation: Deviation
    alternative: int


@dataclass(frozen=True)
class Asker:
    """The caller that asks for configurations.

    Attributes:
        group: the joints that may move.
        start_q: where the robot stands.
        constraints: what must hold in them beside the goal.
        budget: ends the search.
        wanted: how many are wanted.
        avoid_collisions: whether configurations in which something touches are none.
        start_counts: whether the start is an answer even where something touches, as a motion may begin there.
    """

    group: Group
    start_q: Vector
    constraints: Constraints | None
    budget: Budget
    wanted: int = MAX_SOLUTIONS
    avoid_collisions: bool = True
    start_counts: bool = True


class GoalStates:
    """Answers for one robot.

    Args:
        robot: the arm.
        collision: its collisions with itself and the scene.
    """

    def __init__(self, robot: RobotModel, collision: CollisionModel) -> None:
        self._collision = collision
        self._search = GoalSearch(robot, collision)
        self._joints = Joints(collision.joint_names, collision.lower_rad, collision.upper_rad)
        self.forward = self._search.forward

    def condition_set(self, constraints: Constraints | None) -> ConditionSet:
        """Constraints as conditions that can be measured."""
        return ConditionSet(self.forward, conditions(constraints, self._joints))

    def projection(self, group: Group, constraints: Constraints, start_q: Vector) -> Callable[[Vector], Vector | None]:
        """As :meth:`GoalSearch.projection`, for constraints."""
        return self._search.projection(group, conditions(constraints, self._joints), start_q)

    def find(self, goal: Goal, asker: Asker) -> Sequence[GoalState] | PlanningFailure:
        """Configurations in which a goal holds, the soonest reached first; or why there is none.

        Args:
            goal: a checked goal.
            asker: who asks.
        """
        if not isinstance(goal, AnyOf):
            return self._single(goal, asker, 0)
        answers = [self._single(single, asker, index) for index, single in enumerate(goal.goals)]
        failures = [answer for answer in answers if isinstance(answer, PlanningFailure)]
        states = [state for answer in answers if not isinstance(answer, PlanningFailure) for state in answer]
        if not states:
            return failures[0] if len(failures) == 1 else none_of(failures)
        return sorted(states, key=lambda state: self._search.move_time_s(asker.start_q, state.q))

    def _single(self, goal: SingleGoal, asker: Asker, index: int) -> Sequence[GoalState] | PlanningFailure:
        if isinstance(goal, JointGoal):
            return self._joint_goal(goal, asker, index)
        also = conditions(asker.constraints, self._joints)
        wanted = wish(goal, self._joints)
        whole = ConditionSet(self.forward, (*wanted.required, *wanted.preferred, *also))
        if asker.start_counts and whole.holds(asker.start_q):
            return [GoalState(asker.start_q, whole.deviation(asker.start_q), index)]
        found = self._find(wanted.also(also), asker)
        if found.solutions:
            asked = ConditionSet(self.forward, (*wanted.required, *wanted.preferred))
            return [GoalState(q, asked.deviation(q), index) for q in found.solutions]
        return self._refusal(goal, wanted, also, found, asker)

    def _joint_goal(self, goal: JointGoal, asker: Asker, index: int) -> Sequence[GoalState] | PlanningFailure:
        goal_q = asker.start_q.copy()
        for name, value in goal.positions_rad.items():
            goal_q[self._joints.names.index(name)] = value
        goal_q = np.clip(goal_q, self._joints.lower_rad, self._joints.upper_rad)
        violations = self.condition_set(asker.constraints).violations(goal_q)
        if violations:
            return goal_violates(violations)
        if asker.start_counts and np.max(np.abs(goal_q - asker.start_q)) <= ALREADY_THERE_RAD:
            return [GoalState(asker.start_q, Deviation(), index)]
        pairs = self._collision.colliding_pairs(goal_q) if asker.avoid_collisions else []
        return goal_in_collision(pairs) if pairs else [GoalState(goal_q, Deviation(), index)]

    def _find(self, wanted: Wish, asker: Asker) -> Found:
        return self._search.find(
            asker.group,
            wanted,
            asker.start_q,
            asker.budget.used_up,
            wanted=asker.wanted,
            avoid_collisions=asker.avoid_collisions,
        )

    def _refusal(
        self, goal: TaskGoal, wanted: Wish, also: Sequence[Condition], found: Found, asker: Asker
    ) -> PlanningFailure:
        """Return the reason for which nothing was found."""
        if asker.budget.used_up():
            nearest_m = self._point_m(goal, found.nearest_q)
            failure = out_of_time(goal, asker.budget.failure(), nearest_m, found.nearest)
            return self._with_configuration(failure, found.nearest_q, asker.group)
        if found.colliding:
            return goal_in_collision(found.colliding)
        if also:
            alone = self._find(wanted, asker)
            if alone.solutions:
                return goal_violates(ConditionSet(self.forward, also).violations(alone.solutions[0]))
            found = alone
        return self._out_of_reach(goal, wanted, found, asker)

    def _out_of_reach(self, goal: TaskGoal, wanted: Wish, found: Found, asker: Asker) -> PlanningFailure:
        q = found.nearest_q
        if isinstance(goal, PoseGoal | AxisGoal):
            # The point with the nearest orientation there says more than a compromise between both.
            point, *turns = wanted.required
            if turns:
                found = self._find(Wish((point,), (*turns, *wanted.preferred)), asker)
            q = found.solutions[0] if found.solutions else found.nearest_q
        asked = ConditionSet(self.forward, (*wanted.required, *wanted.preferred))
        nearest = asked.deviation(q)
        failure = out_of_reach(goal, self._point_m(goal, q), nearest, asked.violations(q))
        return self._with_configuration(failure, q, asker.group)

    def _with_configuration(self, failure: PlanningFailure, q: Vector, group: Group) -> PlanningFailure:
        """Tell beside the nearest point, where there is one, the configuration that has it."""
        if "nearest_m" not in failure.details:
            return failure
        nearest_rad = {name: float(q[self._joints.names.index(name)]) for name in group.joints}
        return replace(failure, details={**failure.details, "nearest_rad": nearest_rad})

    def _point_m(self, goal: TaskGoal, q: Vector) -> list[float]:
        """Return the point of a goal's link [m]; the root link's origin for a goal of constraints."""
        self.forward.place(q)
        point_m = np.zeros(3)
        if isinstance(goal, PositionGoal):
            placement = self.forward.placement(goal.link)
            point_m = placement.translation + placement.rotation @ np.array(goal.offset_m)
        elif isinstance(goal, AxisGoal | PoseGoal):
            point_m = self.forward.placement(goal.link).translation
        return [float(value) for value in point_m]

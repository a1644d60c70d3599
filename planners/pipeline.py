"""Problem in, plan out: check, find goal configurations, search a path, time it, and check the timed curve."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planners import checks
from planners.budget import Budget
from planners.collision import CollisionModel
from planners.goals import JointGoal, PositionGoal
from planners.joint_space import JointSpace
from planners.kinematics import PositionSolver
from planners.motion import Task
from planners.problem import Plan, PlanningFailure, PlanningProblem
from planners.profile import RateLimits
from robot.model import Group, RobotModel

Vector = NDArray[np.float64]

# A joint goal this near already holds: a servo's step is 1.5 mrad.
ALREADY_THERE_RAD = 1e-6

NOTHING_TO_DO = "nothing to do"
STRAIGHT_LINE = "straight line"
RRT_CONNECT = "RRTConnect"


def never() -> bool:
    """Do not stop."""
    return False


class Planner:
    """Plans for one robot.

    Args:
        robot: the arm.
        clock: monotonic time [s].

    Raises:
        ShapeError: the robot's collision shapes cannot be used.
    """

    def __init__(self, robot: RobotModel, clock: Callable[[], float] = time.monotonic) -> None:
        self._robot = robot
        self._clock = clock
        self._collision = CollisionModel(robot)
        self._kinematics = PositionSolver(robot, self._collision)

    def plan(self, problem: PlanningProblem, should_stop: Callable[[], bool] = never) -> Plan | PlanningFailure:
        """Plan one motion.

        Args:
            problem: what is asked.
            should_stop: asked all the time; once true the answer is PREEMPTED.

        Returns:
            A plan that starts at the start, reaches the goal, keeps the limits and touches nothing, or why there
            is none.
        """
        budget = Budget(self._clock, problem.allowed_time_s, should_stop)
        refusal = checks.check_request(self._robot, problem) or checks.check_start(self._robot, problem.start_rad)
        if refusal is not None:
            return refusal
        names = self._collision.joint_names
        start_q = np.array([problem.start_rad[name] for name in names])
        start_q = np.clip(start_q, self._collision.lower_rad, self._collision.upper_rad)
        contacts = self._collision.colliding_pairs(start_q)
        refusal = checks.check_start_contact(contacts)
        if refusal is not None:
            return refusal
        goals = self._goal_configurations(problem, start_q, budget)
        if isinstance(goals, PlanningFailure):
            return goals
        allowed = {pair.links: pair.depth_m for pair in contacts}
        return self._move(problem, start_q, goals, allowed, budget)

    def _goal_configurations(
        self, problem: PlanningProblem, start_q: Vector, budget: Budget
    ) -> Sequence[Vector] | PlanningFailure:
        """Free configurations in which the goal holds, the soonest first."""
        if isinstance(problem.goal, JointGoal):
            return self._joint_goal(problem.goal, start_q)
        return self._position_goal(self._robot.groups[problem.group], problem.goal, start_q, budget)

    def _joint_goal(self, goal: JointGoal, start_q: Vector) -> Sequence[Vector] | PlanningFailure:
        goal_q = start_q.copy()
        for name, value in goal.positions_rad.items():
            goal_q[self._collision.joint_names.index(name)] = value
        goal_q = np.clip(goal_q, self._collision.lower_rad, self._collision.upper_rad)
        if np.max(np.abs(goal_q - start_q)) <= ALREADY_THERE_RAD:
            return [start_q]
        return checks.check_goal_contact(self._collision, goal_q) or [goal_q]

    def _position_goal(
        self, group: Group, goal: PositionGoal, start_q: Vector, budget: Budget
    ) -> Sequence[Vector] | PlanningFailure:
        target_m = np.asarray(goal.position_m)
        start_m = self._collision.tip_position(start_q, goal.link)
        if np.linalg.norm(start_m - target_m) <= goal.tolerance_m:
            return [start_q]
        found = self._kinematics.solve_position(group, target_m, goal.link, start_q, goal.tolerance_m, budget.used_up)
        if found.solutions:
            return found.solutions
        if budget.used_up():
            return budget.failure()
        if found.colliding:
            return checks.goal_in_collision(found.colliding)
        return checks.out_of_reach(goal, found)

    def _move(
        self,
        problem: PlanningProblem,
        start_q: Vector,
        goals: Sequence[Vector],
        allowed: Mapping[frozenset[str], float],
        budget: Budget,
    ) -> Plan | PlanningFailure:
        if budget.used_up():
            return budget.failure()
        group = self._robot.groups[problem.group]
        space = JointSpace(self._collision, group, start_q, allowed)
        task = Task(
            space,
            group.joints,
            self._rate_limits(group, problem),
            space.point(start_q),
            [space.point(goal_q) for goal_q in goals],
        )
        motion, method = task.straight_motion(), STRAIGHT_LINE
        if motion is None:
            motion, method = task.searched_motion(problem.seed, problem.attempts, budget.used_up), RRT_CONNECT
        if motion is None or budget.stopped:
            return budget.failure()
        method = method if motion.duration_s > 0.0 else NOTHING_TO_DO
        return Plan(motion, method, budget.spent_s)

    def _rate_limits(self, group: Group, problem: PlanningProblem) -> RateLimits:
        joints = [self._robot.joints[name] for name in group.joints]
        return RateLimits(
            problem.velocity_scaling * np.array([joint.max_velocity for joint in joints]),
            problem.acceleration_scaling * np.array([joint.max_acceleration for joint in joints]),
        )

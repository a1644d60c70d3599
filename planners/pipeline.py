"""Problem in, plan out: check, find goal configurations, find a certified motion to one of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planners import checks
from planners.budget import Budget
from planners.cartesian.planning import plan_cartesian
from planners.geometry.collision import CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.ik.goal_refusals import start_violates
from planners.ik.goal_states import Asker, GoalState, GoalStates
from planners.motions.motion import MotionTask, find_motion
from planners.problem import (
    Answer,
    CartesianProblem,
    IkQuestion,
    Plan,
    PlanningFailure,
    PlanningProblem,
    RecheckQuestion,
    Request,
    StateQuestion,
)
from planners.questions import answer_ik, answer_state
from planners.rates import RateLimits
from planners.recheck import recheck
from planners.scene import Scene
from planners.servo.question import ServoQuestion
from planners.servo.steering import answer_servo
from robot.description.model import RobotModel

Vector = NDArray[np.float64]

NOTHING_TO_DO = "nothing to do"


def never() -> bool:
    """Do not stop."""
    return False


class Planner:
    """Plans for one robot.

    Args:
        robot: the arm.
        clock: of allowed times: monotonic [s].

    Raises:
        ShapeError: the robot's collision shapes cannot be used.
    """

    def __init__(self, robot: RobotModel, clock: Callable[[], float] = time.monotonic) -> None:
        self._robot = robot
        self._clock = clock
        self._collision = CollisionModel(robot)
        self._states = GoalStates(robot, self._collision)

    def set_scene(self, scene: Scene) -> PlanningFailure | None:
        """Take over what stands around and what is held, for all that is asked from now on.

        Returns:
            What is wrong with the scene: then the one before stays.
        """
        return self._collision.set_scene(scene)

    def answer(self, request: Request, should_stop: Callable[[], bool] = never) -> Answer:
        """Answer any request.

        Args:
            request: what is asked.
            should_stop: asked all the time; once true the answer is PREEMPTED.
        """
        robot, collision = self._robot, self._collision
        match request:
            case PlanningProblem():
                return self.plan(request, should_stop)
            case CartesianProblem():
                budget = Budget(self._clock, request.allowed_time_s, should_stop)
                return plan_cartesian(request, robot, collision, self._states.forward, budget)
            case IkQuestion():
                budget = Budget(self._clock, request.allowed_time_s, should_stop)
                return answer_ik(request, robot, self._states, collision, budget)
            case StateQuestion():
                return answer_state(request, robot, self._states, collision)
            case RecheckQuestion():
                return recheck(request, robot, collision)
            case ServoQuestion():
                return answer_servo(request, robot, collision, self._states.forward)

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
        start_q = np.array([problem.start_rad[name] for name in self._collision.joint_names])
        start_q = np.clip(start_q, self._collision.lower_rad, self._collision.upper_rad)
        contacts = self._collision.colliding_pairs(start_q)
        violations = self._states.condition_set(problem.path_constraints).violations(start_q)
        refusal = checks.check_start_contact(contacts) or (start_violates(violations) if violations else None)
        if refusal is not None:
            return refusal
        group = self._robot.groups[problem.group]
        goals = self._states.find(problem.goal, Asker(group, start_q, problem.path_constraints, budget))
        if isinstance(goals, PlanningFailure):
            return goals
        return self._move(problem, start_q, goals, self._collision.overlaps_m(start_q), budget)

    def _move(
        self,
        problem: PlanningProblem,
        start_q: Vector,
        goals: Sequence[GoalState],
        allowed: Mapping[frozenset[str], float],
        budget: Budget,
    ) -> Plan | PlanningFailure:
        task = self._task(problem, start_q, goals, allowed)
        motion = find_motion(task, budget)
        if isinstance(motion, PlanningFailure) or budget.stopped:
            return motion if isinstance(motion, PlanningFailure) else budget.failure()
        method = motion.method if motion.trajectory.duration_s > 0.0 else NOTHING_TO_DO
        reached = goals[motion.goal]
        return Plan(motion.trajectory, method, budget.spent_s, reached.alternative, reached.deviation)

    def _task(
        self,
        problem: PlanningProblem,
        start_q: Vector,
        goals: Sequence[GoalState],
        allowed: Mapping[frozenset[str], float],
    ) -> MotionTask:
        group = self._robot.groups[problem.group]
        constraints = problem.path_constraints
        holds = project = None
        if constraints is not None and not constraints.empty:
            holds = self._states.condition_set(constraints).holds
            project = self._states.projection(group, constraints, start_q)
        configurations = [goal.q for goal in goals]
        space = JointSpace(self._collision, group, start_q, allowed, holds, configurations)
        return MotionTask(
            space,
            group.joints,
            self._rate_limits(problem),
            space.point(start_q),
            np.array([problem.start_velocity_rad_s.get(name, 0.0) for name in group.joints]),
            [space.point(q) for q in configurations],
            problem.seed,
            problem.attempts,
            problem.planner_id,
            problem.optimization_time_s,
            project,
        )

    def _rate_limits(self, problem: PlanningProblem) -> RateLimits:
        joints = [self._robot.joints[name] for name in self._robot.groups[problem.group].joints]
        jerks = np.array([problem.max_jerk_rad_s3.get(joint.name, np.inf) for joint in joints])
        return RateLimits(
            problem.velocity_scaling * np.array([joint.max_velocity for joint in joints]),
            problem.acceleration_scaling * np.array([joint.max_acceleration for joint in joints]),
            jerks if np.any(np.isfinite(jerks)) else None,
        )

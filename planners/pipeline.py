"""Planner of one robot: problem in, plan out; it also answers questions about states and rechecks motions."""

from __future__ import annotations

import contextlib
import functools
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from planners import checks
from planners.budget import Budget, never, preempted
from planners.cartesian.planning import plan_cartesian
from planners.errors import StoppedError
from planners.geometry.certificate import encounter
from planners.geometry.collision import CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.geometry.shapes import as_point
from planners.goals import JointGoal, PositionGoal
from planners.ik.goal_states import GoalQuery, GoalState, GoalStates, check_start_place
from planners.joint_path import contact_on, invalid_motion, plan_joint_path, touching
from planners.motions.motion import MotionTask, find_motion
from planners.nearest_goal import nearest_end, nearest_goal
from planners.problem import (
    Answer,
    CartesianProblem,
    ConcurrencyQuestion,
    IkAnswer,
    IkQuestion,
    JointPathProblem,
    Line,
    MoveItErrorCode,
    NearestGoalAnswer,
    NearestGoalQuestion,
    Plan,
    PlanningError,
    PlanningFailure,
    PlanningProblem,
    RateLimits,
    RecheckAnswer,
    RecheckQuestion,
    Request,
    StateAnswer,
    StateQuestion,
)
from planners.scene import Pose, Scene
from planners.servo.question import ServoQuestion
from planners.servo.steering import answer_servo
from robot.description.model import RobotModel
from robot.trajectory import Trajectory, Vector

log = logging.getLogger("armbridge.planner")

NOTHING_TO_DO = "nothing to do"

SOLUTIONS = 1  # the first solution is the nearest to the robot's configuration; a service's caller waits for no more
LIMIT_TOLERANCE_RAD = 1e-3  # measured positions of an arm that rests on a limit lie beyond it by noise
WARM_UP_RAD, WARM_UP_M = 0.2, 0.02  # travel of each joint [rad], and of the tip [m], in the first plans


class Planner:
    """Plans for one robot; ``clock`` is monotonic [s]. ShapeError: the collision shapes cannot be used."""

    def __init__(self, robot: RobotModel, clock: Callable[[], float] = time.monotonic) -> None:
        self._robot = robot
        self._clock = clock
        self._collision = CollisionModel(robot)
        self._states = GoalStates(robot, self._collision)

    def set_scene(self, scene: Scene) -> PlanningFailure | None:
        """Take over a scene for all further requests, as :meth:`CollisionModel.set_scene` does."""
        return self._collision.set_scene(scene)

    def warm_up(self) -> None:
        """Plan a joint goal, a goal of the tip and a path of the tip: first plans take longer than all that follow."""
        for request in self._first_requests():
            try:
                self.answer(request)
            except Exception:
                # A bug that shows here shows with the goals as well, which are answered with it.
                log.exception("the first plans failed on %r", request)

    def _first_requests(self) -> Iterator[Request]:
        robot = self._robot
        group = robot.groups[robot.default_group]
        start = {joint.name: min(max(0.0, joint.lower), joint.upper) for joint in robot.movable_joints}
        start |= next(iter(robot.named_states.get(group.name, {}).values()), {})
        end = {}
        for name in group.joints:
            joint = robot.joints[name]
            away = WARM_UP_RAD if joint.upper - start[name] > WARM_UP_RAD else -WARM_UP_RAD
            end[name] = float(np.clip(start[name] + away, joint.lower, joint.upper))
        yield PlanningProblem(group.name, start, JointGoal(end))
        if robot.tip_link:
            self._states.forward.place(self._collision.start(start, group.joints))
            x, y, z = as_point(self._states.forward.placement(robot.tip_link).translation)
            near = (x, y, z + WARM_UP_M)
            yield PlanningProblem(group.name, start, PositionGoal(robot.tip_link, near, WARM_UP_M / 4))
            yield CartesianProblem(group.name, start, robot.tip_link, (Line(Pose(near)),))

    def answer(self, request: Request, should_stop: Callable[[], bool] = never) -> Answer:
        """Answer any request; ``should_stop`` is called all the time: once true, the answer is PREEMPTED."""
        began_s = self._clock()
        try:
            return self._answer(request, should_stop)
        except PlanningError as error:
            return error.failure
        except StoppedError:
            return preempted(self._clock() - began_s)

    def _answer(self, request: Request, should_stop: Callable[[], bool]) -> Answer:
        robot, collision, states = self._robot, self._collision, self._states
        plan = functools.partial(self.plan, should_stop=should_stop)
        collision.count_all_contacts()

        def budget(allowed_time_s: float) -> Budget:
            return Budget(self._clock, allowed_time_s, should_stop)

        match request:
            case PlanningProblem():
                return plan(request)
            case CartesianProblem():
                return plan_cartesian(request, robot, collision, states.forward, budget(request.allowed_time_s))
            case JointPathProblem():
                return plan_joint_path(request, robot, collision, budget(request.allowed_time_s))
            case IkQuestion():
                return answer_ik(request, robot, states, collision, budget(request.allowed_time_s))
            case NearestGoalQuestion(problem):
                time = budget(request.allowed_time_s)
                with contextlib.suppress(PlanningError):
                    if isinstance(problem, CartesianProblem):
                        return NearestGoalAnswer(nearest_end(problem, robot, collision, states.forward, plan, time))
                    return NearestGoalAnswer(nearest_goal(problem, request.code, robot, states, collision, plan, time))
                return NearestGoalAnswer(None)
            case StateQuestion():
                return answer_state(request, robot, states, collision)
            case RecheckQuestion():
                return recheck(request, robot, collision, should_stop)
            case ConcurrencyQuestion():
                return check_concurrency(request, robot, collision)
            case ServoQuestion():
                return answer_servo(request, robot, collision, states.forward)

    def plan(self, problem: PlanningProblem, should_stop: Callable[[], bool] = never) -> Plan | PlanningFailure:
        """Plan a motion that starts at the start, reaches the goal, keeps the limits and touches nothing."""
        budget = Budget(self._clock, problem.allowed_time_s, should_stop)
        try:
            return self._plan(problem, budget)
        except PlanningError as error:
            return error.failure
        except StoppedError:
            return preempted(budget.spent_s)

    def _plan(self, problem: PlanningProblem, budget: Budget) -> Plan | PlanningFailure:
        checks.check_request(self._robot, problem)
        checks.check_start(self._robot, problem.start_rad)
        group = self._robot.groups[problem.group]
        start_q = self._collision.start(problem.start_rad, group.joints)
        contacts = self._collision.colliding_pairs(start_q)
        violations = self._states.condition_set(problem.path_constraints).violations(start_q)
        check_start_place(contacts, violations)
        goals = self._states.find(problem.goal, GoalQuery(group, start_q, problem.path_constraints, budget))
        if isinstance(goals, PlanningFailure):
            return goals
        motion = find_motion(self._task(problem, start_q, goals, budget.should_stop), budget)
        if isinstance(motion, PlanningFailure):
            return motion
        if budget.should_stop():
            return budget.failure()
        method = motion.method if motion.trajectory.duration_s > 0.0 else NOTHING_TO_DO
        return Plan(motion.trajectory, method, budget.spent_s, goals[motion.goal].deviation)

    def _task(
        self, problem: PlanningProblem, start_q: Vector, goals: Sequence[GoalState], should_stop: Callable[[], bool]
    ) -> MotionTask:
        group, constraints = self._robot.groups[problem.group], problem.path_constraints
        holds, project = self._states.within(group, constraints, start_q)
        goals_q, allowed = [goal.q for goal in goals], self._collision.overlaps_m(start_q)
        space = JointSpace(self._collision, group.joints, start_q, allowed, holds, goals_q, should_stop)
        joints = [self._robot.joints[name] for name in group.joints]
        return MotionTask(
            space,
            group.joints,
            RateLimits.of(joints, problem.velocity_scaling, problem.acceleration_scaling),
            space.point(start_q),
            np.array([problem.start_velocity_rad_s.get(name, 0.0) for name in group.joints]),
            [space.point(q) for q in goals_q],
            problem.seed,
            problem.attempts,
            problem.planner_id,
            problem.optimization_time_s if problem.optimization_time_s < problem.allowed_time_s else np.inf,
            project,
        )


def answer_ik(
    question: IkQuestion, robot: RobotModel, states: GoalStates, collision: CollisionModel, budget: Budget
) -> IkAnswer | PlanningFailure:
    """Find configurations in which a goal holds."""
    checks.check_ik_question(robot, question)
    checks.check_start(robot, question.start_rad)
    group = robot.groups[question.group]
    start_q, avoid = collision.start(question.start_rad, group.joints), question.avoid_collisions
    query = GoalQuery(
        group, start_q, question.constraints, budget, wanted=SOLUTIONS, avoid_collisions=avoid, accept_start=False
    )
    found = states.find(question.goal, query)
    if isinstance(found, PlanningFailure):
        return found
    return IkAnswer(
        tuple(dict(zip(collision.joint_names, state.q.tolist(), strict=True)) for state in found),
        tuple(state.deviation for state in found),
    )


def answer_state(
    question: StateQuestion, robot: RobotModel, states: GoalStates, collision: CollisionModel
) -> StateAnswer:
    """List the flaws of a state: limits, contacts, constraints."""
    checks.check_state_question(robot, question)
    positions_rad = question.positions_rad
    code = MoveItErrorCode.INVALID_ROBOT_STATE
    problems = list(checks.limit_flaws(robot, positions_rad, LIMIT_TOLERANCE_RAD, code))
    q = np.array([positions_rad[name] for name in collision.joint_names])
    pairs = collision.colliding_pairs(q)
    if pairs:
        problems.append(checks.contact_failure(MoveItErrorCode.START_STATE_IN_COLLISION, "these touch", pairs))
    problems += [
        PlanningFailure(MoveItErrorCode.GOAL_CONSTRAINTS_VIOLATED, violation.sentence, violation.details)
        for violation in states.condition_set(question.constraints).violations(q)
    ]
    return StateAnswer(not problems, tuple(problems))


def recheck(
    question: RecheckQuestion, robot: RobotModel, collision: CollisionModel, should_stop: Callable[[], bool] = never
) -> RecheckAnswer:
    """Check the rest of a motion, from its present place on, against the present scene, as plans are checked."""
    _check_question(question, robot)
    rest = _rest(question.trajectory, question.from_s)
    positions = dict(question.others_rad) | dict(zip(rest.joint_names, rest.positions_rad[0].tolist(), strict=True))
    checks.check_start(robot, positions)
    contact = contact_on(rest, question.others_rad, collision, should_stop)
    if contact is None:
        return RecheckAnswer(None)
    contact = replace(contact, time_s=question.from_s + contact.time_s)
    code = MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
    return RecheckAnswer(touching(contact, code), contact.time_s)


def check_concurrency(question: ConcurrencyQuestion, robot: RobotModel, collision: CollisionModel) -> RecheckAnswer:
    """Check if two motions may touch each other, wherever each is on its way."""
    first, second = question.first, question.second
    shared = set(first.joint_names) & set(second.joint_names)
    if shared:
        raise invalid_motion(f"both motions are of joint {min(shared)}")
    ends = [dict(zip(one.joint_names, one.positions_rad[-1].tolist(), strict=True)) for one in (first, second)]
    checks.check_start(robot, {**question.others_rad, **ends[0], **ends[1]})
    found = encounter(collision, first, second, question.others_rad)
    if found is None:
        return RecheckAnswer(None)
    touching = checks.describe_pairs(found.pairs) or "they come too near to tell them apart"
    text = f"the motions of {first.joint_names[0]} and of {second.joint_names[0]} may touch: {touching}"
    details = {"pairs": checks.pairs_as_data(found.pairs), "contact_s": found.time_s}
    failure = PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, text, details)
    return RecheckAnswer(failure, found.time_s)


def _check_question(question: RecheckQuestion, robot: RobotModel) -> None:
    motion = question.trajectory
    known = tuple(joint.name for joint in robot.movable_joints)
    if question.group:
        known = checks.check_group(robot, question.group).joints
    if not (motion.joint_names == known if question.group else set(motion.joint_names) <= set(known)):
        text = f"a motion of {', '.join(motion.joint_names)} is no motion of the joints {', '.join(known)}"
        raise invalid_motion(text)
    if not all(np.all(np.isfinite(part)) for part in (motion.time_s, motion.positions_rad, motion.velocities_rad_s)):
        raise invalid_motion("the motion has numbers that are not finite")
    if not 0.0 <= question.from_s <= motion.duration_s:
        lasts = f"the motion lasts from 0 to {motion.duration_s:.4g} s"
        raise invalid_motion(f"{lasts}, there is no time {question.from_s:.4g} s")


def _rest(motion: Trajectory, from_s: float) -> Trajectory:
    """The part of a motion after a time, with times that start at 0."""
    position, velocity, acceleration = motion.sample(from_s)
    after = motion.time_s > from_s
    return Trajectory(
        motion.joint_names,
        np.concatenate(([0.0], motion.time_s[after] - from_s)),
        np.vstack((position, motion.positions_rad[after])),
        np.vstack((velocity, motion.velocities_rad_s[after])),
        np.vstack((acceleration, motion.accelerations_rad_s2[after])),
    )

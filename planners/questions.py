"""Questions about single configurations: inverse kinematics, and whether a state is sound."""

from __future__ import annotations

import numpy as np

from planners import checks
from planners.budget import Budget
from planners.geometry.collision import CollisionModel
from planners.ik.goal_states import Asker, GoalStates
from planners.problem import IkAnswer, IkQuestion, MoveItErrorCode, PlanningFailure, StateAnswer, StateQuestion
from robot.description.model import RobotModel

# The first solution is the one nearest to where the robot stands; a service's caller waits for no more.
WANTED = 1

# Measured positions of an arm that rests on a limit lie beyond it by noise.
LIMIT_TOLERANCE_RAD = 1e-3


def answer_ik(
    question: IkQuestion, robot: RobotModel, states: GoalStates, collision: CollisionModel, budget: Budget
) -> IkAnswer | PlanningFailure:
    """Find configurations in which a goal holds.

    Args:
        question: what must hold.
        robot: the arm.
        states: finds configurations.
        collision: the joints of a configuration.
        budget: ends the search.
    """
    refusal = checks.check_ik_question(robot, question) or checks.check_start(robot, question.start_rad)
    if refusal is not None:
        return refusal
    start_q = np.array([question.start_rad[name] for name in collision.joint_names])
    start_q = np.clip(start_q, collision.lower_rad, collision.upper_rad)
    asker = Asker(
        robot.groups[question.group],
        start_q,
        question.constraints,
        budget,
        wanted=WANTED,
        avoid_collisions=question.avoid_collisions,
        start_counts=False,
    )
    found = states.find(question.goal, asker)
    if isinstance(found, PlanningFailure):
        return found
    return IkAnswer(
        tuple(dict(zip(collision.joint_names, state.q.tolist(), strict=True)) for state in found),
        tuple(state.deviation for state in found),
    )


def answer_state(
    question: StateQuestion, robot: RobotModel, states: GoalStates, collision: CollisionModel
) -> StateAnswer | PlanningFailure:
    """Say all that is wrong with a state: limits, contacts, constraints.

    Args:
        question: the state.
        robot: the arm.
        states: measures constraints.
        collision: its collisions with itself and the scene.
    """
    refusal = checks.check_state_question(robot, question)
    if refusal is not None:
        return refusal
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

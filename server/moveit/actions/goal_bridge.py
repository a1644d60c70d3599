"""Goal bridge: goals of actions on their way to the goal queue, and the queue's answers as feedback and results."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.description.model import RobotModel
from robot.trajectory import Trajectory
from server.goal_queue import Answer, GoalPolicy, GoalQueue, GoalState, Progress
from server.graph.actions import Goal, GoalStatus
from server.moveit.current_state import state_message
from server.moveit.motions import Motion
from server.moveit.requests.error_codes import error_code
from server.moveit.requests.trajectories import to_message

log = logging.getLogger("armbridge.actions")

Message: TypeAlias = Mapping[str, Any]

# MoveIt's names of states (MoveGroupState in move_group); a goal that waits in the queue has none.
MOVE_GROUP_STATES = {
    GoalState.PLANNING: "PLANNING",
    GoalState.EXECUTING: "MONITOR",
    GoalState.DONE: "IDLE",
}


def submit_goal(
    goal: Goal,
    queue: GoalQueue[Motion],
    request: Motion,
    feedback: Callable[[Progress], Message | None],
    result: Callable[[Answer], Message],
) -> None:
    """Submit the motion of a goal; it replaces the motion that the arm's group makes now.

    Args:
        goal: the goal; it ends with the queue's answer.
        queue: queue of the arm's goals.
        request: the motion.
        feedback: makes the feedback message of some progress, None for none.
        result: makes the result message of the answer.
    """

    def send_feedback(progress: Progress) -> None:
        message = feedback(progress)
        if message is not None:
            goal.feedback(message)

    def end(answer: Answer) -> None:
        send_feedback(Progress(GoalState.DONE, answer.message))
        finish_goal(goal, answer, result)

    number = queue.submit(goal.action, request, policy=GoalPolicy.PREEMPT, on_progress=send_feedback, on_answer=end)
    goal.when_canceled(lambda: queue.cancel(number, f"cancelled by a client of {goal.action}"))


def reject_goal(
    goal: Goal,
    queue: GoalQueue[Motion],
    failure: PlanningFailure,
    result: Callable[[Answer], Message],
) -> None:
    """End a goal that cannot be submitted; the arm's motion continues."""
    queue.refuse(goal.action, failure)
    finish_goal(goal, Answer.of(failure), result)


def finish_goal(goal: Goal, answer: Answer, result: Callable[[Answer], Message]) -> None:
    """End a goal with its result."""
    goal.finish(goal_status(answer.code), result(answer))


def goal_status(code: MoveItErrorCode) -> GoalStatus:
    """Return the value of action_msgs/GoalStatus for an error code."""
    if code is MoveItErrorCode.SUCCESS:
        return GoalStatus.SUCCEEDED
    return GoalStatus.CANCELED if code is MoveItErrorCode.PREEMPTED else GoalStatus.ABORTED


class MoveGroupFeedback:
    """Maker of move_group's feedback: the name of the state whenever it changes."""

    def __init__(self) -> None:
        self._state = ""

    def __call__(self, progress: Progress) -> Message | None:
        """Make the feedback message of some progress; None if the state is the same."""
        state = MOVE_GROUP_STATES.get(progress.state, "")
        if state in ("", self._state):
            return None
        self._state = state
        return {"state": state}


def code_message(answer: Answer) -> dict[str, Any]:
    """Write the moveit_msgs/MoveItErrorCodes of an answer."""
    return error_code(answer.code, answer.message)


def move_group_result(answer: Answer, robot: RobotModel) -> Message:
    """Write the result of moveit_msgs/MoveGroup."""
    planned = _planned_messages(answer, robot)
    executed = None if answer.performed is None else answer.performed.executed
    return {
        "error_code": code_message(answer),
        "trajectory_start": _start_message(answer, robot),
        "planned_trajectory": planned[0] if planned else _trajectory_message(None, robot),
        "executed_trajectory": _trajectory_message(executed, robot),
        "planning_time": _planning_time_s(answer),
    }


def sequence_result(answer: Answer, robot: RobotModel) -> Message:
    """Write the result of moveit_msgs/MoveGroupSequence."""
    response = {
        "error_code": code_message(answer),
        "sequence_start": _start_message(answer, robot),
        "planned_trajectories": _planned_messages(answer, robot),
        "planning_time": _planning_time_s(answer),
    }
    return {"response": response}


def _start_message(answer: Answer, robot: RobotModel) -> dict[str, Any]:
    """Write the moveit_msgs/RobotState at the start of an answer's motions; without joints if there are none."""
    start_rad = {} if answer.performed is None else dict(answer.performed.start_rad)
    return state_message(start_rad, robot.root_link, time.time())


def _trajectory_message(motion: Trajectory | None, robot: RobotModel) -> dict[str, Any]:
    """Write the moveit_msgs/RobotTrajectory of a motion; as in MoveIt, one of no duration has no points."""
    return to_message(None if motion is None or motion.duration_s == 0.0 else motion, robot.root_link)


def _planned_messages(answer: Answer, robot: RobotModel) -> list[dict[str, Any]]:
    """Write the moveit_msgs/RobotTrajectory of every planned motion."""
    planned = () if answer.performed is None else answer.performed.planned
    return [_trajectory_message(motion, robot) for motion in planned]


def _planning_time_s(answer: Answer) -> float:
    return 0.0 if answer.performed is None else answer.performed.planning_time_s

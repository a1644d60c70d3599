"""Goal bridge"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.model import RobotModel
from robot.trajectory import Trajectory
from server.action_goals import Goal, GoalStatus
from server.goal_queue import Answer, GoalPolicy, GoalQueue, GoalState, Progress
from server.moveit.current_state import state_message
from server.moveit.motions import Motion
from server.moveit.requests.error_codes import error_code
from server.moveit.requests.trajectories import to_message

log = logging.getLogger("armbridge.actions")

Message: TypeAlias = Mapping[str, Any]

# What MoveIt's actions call their states (move_group's MoveGroupState); a goal that waits has none yet.
MOVEIT_STATES = {
    GoalState.PLANNING: "PLANNING",
    GoalState.EXECUTING: "MONITOR",
    GoalState.DONE: "IDLE",
}


def carry_out(
    goal: Goal,
    queue: GoalQueue[Motion],
    request: Motion,
    feedback: Callable[[Progress], Message | None],
    result: Callable[[Answer], Message],
) -> None:
    """Have a goal of an action carried out, in place of whatever moves the arm's group now.

    Args:
        goal: the goal; it ends with the answer.
        queue: the one way to the arm.
        request: what the goal asks for.
        feedback: the feedback message for some news, None for none.
        result: the result message for the answer.
    """

    def tell(progress: Progress) -> None:
        message = feedback(progress)
        if message is not None:
            goal.feedback(message)

    def end(answer: Answer) -> None:
        tell(Progress(GoalState.DONE, answer.message))
        finish(goal, answer, result)

    number = queue.submit(goal.action, request, policy=GoalPolicy.PREEMPT, on_progress=tell, on_answer=end)
    goal.when_canceled(lambda: queue.cancel(number, f"cancelled by a client of {goal.action}"))


def refuse(
    goal: Goal,
    queue: GoalQueue[Motion],
    failure: PlanningFailure,
    result: Callable[[Answer], Message],
) -> None:
    """Answer a goal that cannot be asked for; what moves goes on."""
    queue.refuse(goal.action, failure)
    finish(goal, Answer.of(failure), result)


def finish(goal: Goal, answer: Answer, result: Callable[[Answer], Message]) -> None:
    """End a goal with its result."""
    goal.finish(status_of(answer.code), result(answer))


def status_of(code: MoveItErrorCode) -> GoalStatus:
    """How the end is called in action_msgs/GoalStatus."""
    if code is MoveItErrorCode.SUCCESS:
        return GoalStatus.SUCCEEDED
    return GoalStatus.CANCELED if code is MoveItErrorCode.PREEMPTED else GoalStatus.ABORTED


class StateFeedback:
    """MoveIt's feedback: the name of the state, whenever it is another."""

    def __init__(self) -> None:
        self._last = ""

    def __call__(self, progress: Progress) -> Message | None:
        """The feedback message for some news."""
        state = MOVEIT_STATES.get(progress.state, "")
        if state in ("", self._last):
            return None
        self._last = state
        return {"state": state}


def code_message(answer: Answer) -> dict[str, Any]:
    """The moveit_msgs/MoveItErrorCodes of an answer."""
    return error_code(answer.code, answer.message)


def start_message(answer: Answer, robot: RobotModel) -> dict[str, Any]:
    """The moveit_msgs/RobotState that the motions of an answer begin in; without joints when there are none."""
    start_rad = {} if answer.performed is None else dict(answer.performed.start_rad)
    return state_message(start_rad, robot.root_link, time.time())


def trajectory_message(motion: Trajectory | None, robot: RobotModel) -> dict[str, Any]:
    """The moveit_msgs/RobotTrajectory of a motion; one that goes nowhere has no points, as MoveIt's."""
    return to_message(None if motion is None or motion.duration_s == 0.0 else motion, robot.root_link)


def planned_messages(answer: Answer, robot: RobotModel) -> list[dict[str, Any]]:
    """The moveit_msgs/RobotTrajectory of every motion that was planned."""
    planned = () if answer.performed is None else answer.performed.planned
    return [trajectory_message(motion, robot) for motion in planned]


def planning_time_s(answer: Answer) -> float:
    """What planning took [s]."""
    return 0.0 if answer.performed is None else answer.performed.planning_time_s


def move_group_result(answer: Answer, robot: RobotModel) -> Mapping[str, Any]:
    """The result of moveit_msgs/MoveGroup."""
    planned = planned_messages(answer, robot)
    return {
        "error_code": code_message(answer),
        "trajectory_start": start_message(answer, robot),
        "planned_trajectory": planned[0] if planned else trajectory_message(None, robot),
        "executed_trajectory": trajectory_message(_executed(answer), robot),
        "planning_time": planning_time_s(answer),
    }


def sequence_result(answer: Answer, robot: RobotModel) -> Mapping[str, Any]:
    """The result of moveit_msgs/MoveGroupSequence."""
    response = {
        "error_code": code_message(answer),
        "sequence_start": start_message(answer, robot),
        "planned_trajectories": planned_messages(answer, robot),
        "planning_time": planning_time_s(answer),
    }
    return {"response": response}


def _executed(answer: Answer) -> Trajectory | None:
    return None if answer.performed is None else answer.performed.executed

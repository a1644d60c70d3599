"""Parts of results that several actions have."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from robot.description.model import RobotModel
from robot.trajectory import Trajectory
from server.execution.current_state import state_message
from server.execution.queue import Answer
from server.moveit.requests.codes import error_code
from server.moveit.requests.trajectories import to_message


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

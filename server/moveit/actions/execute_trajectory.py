"""The action ExecuteTrajectory: plays a motion that was planned before, by whomever."""

from __future__ import annotations

import logging

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.description.model import RobotModel
from server.execution.current_state import CurrentState
from server.execution.motions import Motion
from server.execution.queue import Answer, GoalQueue
from server.graph.actions import Goal
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.actions.carrying_out import Message, StateFeedback, carry_out, finish, refuse
from server.moveit.actions.given_motions import given_motion
from server.moveit.actions.messages import code_message

log = logging.getLogger("armbridge.actions")

EXECUTE_ACTION = "/execute_trajectory"


class ExecuteTrajectory:
    """Offers the action.

    Args:
        graph: where it is.
        robot: the arm.
        current: where the arm is.
        queue: the one way to the arm.
    """

    def __init__(self, graph: Graph, robot: RobotModel, current: CurrentState, queue: GoalQueue[Motion]) -> None:
        self._graph = graph
        self._robot = robot
        self._current = current
        self._queue = queue
        self._node = Node("execute trajectory")

    def open(self) -> None:
        """Offer it."""
        self._graph.actions.offer(self._node, EXECUTE_ACTION, "moveit_msgs/action/ExecuteTrajectory", self._start)

    def _start(self, goal: Goal) -> None:
        trajectory = goal.request["trajectory"]
        if trajectory["multi_dof_joint_trajectory"]["points"]:
            log.warning("%s: multi_dof_joint_trajectory is ignored: the arm has no such joint", goal.action)
        message = trajectory["joint_trajectory"]
        if not message["points"]:
            # As MoveIt: what a goal that holds already is answered with can be executed.
            finish(goal, Answer(MoveItErrorCode.SUCCESS, "the trajectory has no points: nothing to do"), _result)
            return
        motion = given_motion(message, self._robot)
        present_rad = self._current.positions_rad()
        # Only what can be asked for may take the place of what moves.
        refusal = None if present_rad is None else motion.trajectory(present_rad)
        if isinstance(refusal, PlanningFailure):
            refuse(goal, self._queue, refusal, _result)
        else:
            carry_out(goal, self._queue, motion, StateFeedback(), _result)


def _result(answer: Answer) -> Message:
    return {"error_code": code_message(answer)}

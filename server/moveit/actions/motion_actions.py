"""All actions that move the arm's group, and actionlib's topics before them and the gripper's."""

from __future__ import annotations

import time
from collections.abc import Iterable

from robot.arm import Arm
from robot.messages import ArmState
from server.actionlib import ActionlibBridge
from server.execution.current_state import CurrentState
from server.execution.motions import Motion
from server.execution.queue import GoalQueue
from server.graph.topics import Graph
from server.moveit.actions.controller_state import ControllerState
from server.moveit.actions.execute_trajectory import EXECUTE_ACTION, ExecuteTrajectory
from server.moveit.actions.follow_joint_trajectory import ArmController
from server.moveit.actions.planning_goals import MOVE_ACTIONS, SEQUENCE_ACTION, PlanningActions
from server.moveit.services.planning_context import PlanningContext
from server.timers import call_later


class MotionActions:
    """Offers them.

    Args:
        graph: where they are.
        context: what goals are read against and planned with.
        arm: the arm.
        queue: the one way to it.
    """

    def __init__(self, graph: Graph, context: PlanningContext, arm: Arm, queue: GoalQueue[Motion]) -> None:
        robot, current = context.robot, CurrentState(arm, context.robot)
        self._planning_actions = PlanningActions(graph, context, queue)
        self._execute = ExecuteTrajectory(graph, robot, current, queue)
        self._controller = ArmController(graph, robot, context.group(""), arm, current, queue)
        self._controller_state = ControllerState(graph, context.group(""))
        self._actionlib = ActionlibBridge(graph, time.monotonic, call_later)

    def open(self, further: Iterable[str]) -> None:
        """Offer the actions, and topics for them and for further actions of the server."""
        self._planning_actions.open()
        self._execute.open()
        self._controller.open()
        self._controller_state.open()
        self._actionlib.open((*MOVE_ACTIONS, SEQUENCE_ACTION, EXECUTE_ACTION, *self._controller.actions, *further))

    def take_state(self, state: ArmState) -> None:
        """Pass the arm's latest state on."""
        self._controller.take_state(state)
        self._controller_state.take_state(state)

"""The actions whose goals are planned: MoveGroup under MoveIt's two names, and MoveGroupSequence."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.description.model import RobotModel
from server.execution.motions import Motion
from server.execution.queue import Answer, GoalQueue
from server.graph.actions import Goal
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.actions.carrying_out import Message, StateFeedback, carry_out, finish, refuse
from server.moveit.actions.messages import move_group_result, sequence_result
from server.moveit.actions.planning_requests import Asked, Requests, asked_by, motion_of, planned_only
from server.moveit.requests.sequence import requests_of
from server.moveit.services.planning_context import PlanningContext

log = logging.getLogger("armbridge.actions")

# ROS 2's name, and ROS 1's.
MOVE_ACTIONS = ("/move_action", "/move_group")
SEQUENCE_ACTION = "/sequence_move_group"


@dataclass(frozen=True)
class Kind:
    """One of the actions.

    Attributes:
        type_name: its type.
        requests: the moveit_msgs/MotionPlanRequest in a goal, or why they cannot be had.
        result: the result message.
    """

    type_name: str
    requests: Requests
    result: Callable[[Answer, RobotModel], Message]


MOVE_GROUP = Kind("moveit_msgs/action/MoveGroup", lambda goal: [goal["request"]], move_group_result)
SEQUENCE = Kind("moveit_msgs/action/MoveGroupSequence", lambda goal: requests_of(goal["request"]), sequence_result)


class PlanningActions:
    """Offers the actions.

    Args:
        graph: where they are.
        context: what goals are read against and planned with.
        queue: the one way to the arm.
    """

    def __init__(self, graph: Graph, context: PlanningContext, queue: GoalQueue[Motion]) -> None:
        self._graph = graph
        self._context = context
        self._queue = queue
        self._node = Node("move group")
        self._tasks: set[asyncio.Task[Answer]] = set()

    def open(self) -> None:
        """Offer them."""
        for name in MOVE_ACTIONS:
            self._offer(name, MOVE_GROUP)
        self._offer(SEQUENCE_ACTION, SEQUENCE)

    def _offer(self, name: str, kind: Kind) -> None:
        def result(answer: Answer) -> Message:
            return kind.result(answer, self._context.robot)

        def start(goal: Goal) -> None:
            asked = asked_by(goal, kind.requests)
            if isinstance(asked, PlanningFailure):
                refuse(goal, self._queue, asked, result)
            elif asked.options.plan_only:
                self._plan_only(goal, asked, result)
            else:
                self._move(goal, asked, result)

        self._graph.actions.offer(self._node, name, kind.type_name, start)

    def _move(self, goal: Goal, asked: Asked, result: Callable[[Answer], Message]) -> None:
        motion = motion_of(asked, self._context)
        if isinstance(motion, PlanningFailure):
            refuse(goal, self._queue, motion, result)
            return
        for warning in motion.warnings:
            log.warning("%s: %s", goal.action, warning)
        carry_out(goal, self._queue, motion, StateFeedback(), result)

    def _plan_only(self, goal: Goal, asked: Asked, result: Callable[[Answer], Message]) -> None:
        def end(done: asyncio.Task[Answer]) -> None:
            # The event loop keeps no task alive.
            self._tasks.discard(done)
            goal.feedback({"state": "IDLE"})
            finish(goal, _outcome(done), result)

        goal.feedback({"state": "PLANNING"})
        task = asyncio.create_task(planned_only(goal, asked, self._context), name=f"plan for {goal.action}")
        self._tasks.add(task)
        task.add_done_callback(end)
        goal.when_canceled(lambda: _cancel(task))


def _cancel(task: asyncio.Task[Answer]) -> None:
    task.cancel()


def _outcome(done: asyncio.Task[Answer]) -> Answer:
    """What a finished task of planning answers."""
    if done.cancelled():
        return Answer(MoveItErrorCode.PREEMPTED, "cancelled while planning")
    error = done.exception()
    if error is not None:
        log.error("planning for an action failed", exc_info=error)
        return Answer(MoveItErrorCode.FAILURE, f"internal error: {type(error).__name__}: {error}")
    answer = done.result()
    if answer.code is not MoveItErrorCode.SUCCESS:
        log.warning("a plan was asked for: %s: %s", answer.code.name, answer.message)
    return answer

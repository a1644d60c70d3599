"""move_group"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Scene
from robot.arm import Arm
from robot.messages import ArmState
from robot.model import RobotModel
from server.action_goals import Goal
from server.actionlib import ActionlibBridge
from server.errors import RefusedError
from server.goal_queue import Answer, GoalQueue
from server.graph import Graph
from server.moveit.actions.goal_bridge import (
    StateFeedback,
    carry_out,
    code_message,
    finish,
    move_group_result,
    refuse,
    sequence_result,
)
from server.moveit.actions.joint_trajectory_controller import ArmController, ControllerState
from server.moveit.current_state import CurrentState
from server.moveit.motions import Motion, PlannedMotion, Positions
from server.moveit.requests.error_codes import refusals_as_data
from server.moveit.requests.motion_plan import requests_of
from server.moveit.requests.planning_context import PlanningContext, Situation, attached_diff
from server.moveit.requests.trajectories import given_motion
from server.moveit.step_planning import plan_steps
from server.node import Node
from server.timers import call_later

Message: TypeAlias = Mapping[str, Any]

# MoveIt's number of attempts when none is given.
DEFAULT_ATTEMPTS = 5

# Bounds, so that no goal goes on for ever.
MAX_ATTEMPTS = 100
MAX_DELAY_S = 10.0


@dataclass(frozen=True)
class Options:
    """What the options ask for.

    Attributes:
        plan_only: whether nothing is to move.
        attempts: how often is planned at most.
        delay_s: pause between attempts [s].
        scene_diff: moveit_msgs/PlanningScene to plan in on top of the present one; None for none.
        warnings: what was left out of account, a sentence each.
    """

    plan_only: bool
    attempts: int
    delay_s: float
    scene_diff: Message | None
    warnings: tuple[str, ...]


def options_of(message: Message) -> Options | PlanningFailure:
    """Read the options."""
    delay_s = float(message["replan_delay"])
    if not (math.isfinite(delay_s) and 0.0 <= delay_s <= MAX_DELAY_S):
        return PlanningFailure(
            MoveItErrorCode.FAILURE,
            f"planning_options.replan_delay must be from 0 to {MAX_DELAY_S:g} s, not {delay_s:g}",
            {"replan_delay": str(delay_s)},
        )
    attempts = message["replan_attempts"] if message["replan_attempts"] > 0 else DEFAULT_ATTEMPTS
    warnings = ("look_around is ignored: there is no sensor to look with",) if message["look_around"] else ()
    diff = message["planning_scene_diff"]
    return Options(
        plan_only=message["plan_only"],
        attempts=min(attempts, MAX_ATTEMPTS) if message["replan"] else 1,
        delay_s=delay_s,
        scene_diff={**diff, "is_diff": True} if changes_something(diff) else None,
        warnings=warnings,
    )


def changes_something(scene: Message) -> bool:
    """Whether a moveit_msgs/PlanningScene says anything of what a plan depends on.

    One that is left out has ``is_diff`` false, and must not be taken for an empty world.
    """
    return bool(
        scene["world"]["collision_objects"]
        or scene["robot_state"]["attached_collision_objects"]
        or scene["allowed_collision_matrix"]["entry_names"]
        or scene["allowed_collision_matrix"]["default_entry_names"]
        or scene["link_padding"]
        or scene["link_scale"]
        or scene["fixed_frame_transforms"]
    )


@dataclass(frozen=True)
class Asked:
    """What a goal asks for.

    Attributes:
        requests: moveit_msgs/MotionPlanRequest, the first to be carried out first.
        options: the rest.
    """

    requests: Sequence[Message]
    options: Options


Requests = Callable[[Message], Sequence[Message] | PlanningFailure]


def asked_by(goal: Goal, requests_of: Requests) -> Asked | PlanningFailure:
    """Read a goal.

    Args:
        goal: of an action whose goals have planning options.
        requests_of: finds the requests in its message.
    """
    options = options_of(goal.request["planning_options"])
    requests = requests_of(goal.request)
    if isinstance(options, PlanningFailure):
        return options
    return requests if isinstance(requests, PlanningFailure) else Asked(requests, options)


def motion_of(asked: Asked, context: PlanningContext) -> PlannedMotion | PlanningFailure:
    """The motion to plan and carry out; what cannot be asked for is refused before it takes any motion's place.

    Args:
        asked: what the goal asks for.
        context: what it is read against.
    """
    options, present_rad = asked.options, context.current.positions_rad()
    warnings = [*options.warnings, *_start_ignored(asked.requests)]
    if present_rad is not None:
        refusal = _refusal(asked.requests, present_rad, context, warnings)
        if refusal is not None:
            return refusal
    return PlannedMotion(
        steps=tuple(context.step(request) for request in asked.requests),
        scene=_scene_of(options.scene_diff, context),
        attempts=options.attempts,
        delay_s=options.delay_s,
        warnings=tuple(warnings),
    )


async def planned_only(goal: Goal, asked: Asked, context: PlanningContext) -> Answer:
    """Plan from the start that the first request names, whatever the arm does meanwhile.

    Args:
        goal: the goal; what its sender wants the state to be counts where the request says nothing.
        asked: what it asks for.
        context: what it is read against and planned with.
    """
    state, options = asked.requests[0]["start_state"], asked.options
    try:
        situation = context.situation(state, goal.sender)
        scene = _scene_from(situation, options.scene_diff, state, context)
    except RefusedError as refused:
        return Answer.of(refused.failure)
    warnings = [*situation.warnings, *options.warnings]
    refusal = _refusal(asked.requests, situation.start_rad, context, warnings)
    if refusal is not None:
        return Answer.of(refusal)
    planned = await plan_steps(
        tuple(context.step(request) for request in asked.requests), situation.start_rad, scene, context.pool.ask
    )
    if planned.failure is not None:
        context.display.contacts_of(planned.failure.details)
        return Answer.of(planned.failure, planned.performed)
    context.display.performed(planned.performed)
    message = "; ".join((planned.summary, *planned.notes, *warnings))
    return Answer(MoveItErrorCode.SUCCESS, message, performed=planned.performed)


def _refusal(
    requests: Sequence[Message], start_rad: Positions, context: PlanningContext, warnings: list[str]
) -> PlanningFailure | None:
    """Why the requests cannot be asked for; None when they can. Warnings are added to those given."""
    for request in requests:
        read = context.read(request, start_rad)
        if isinstance(read, PlanningFailure):
            return read
        warnings.extend(read.warnings)
    return None


def _scene_of(
    scene_diff: Message | None, context: PlanningContext
) -> Callable[[Positions], Scene | PlanningFailure] | None:
    """What scene a motion is planned in, None for the present one."""
    if scene_diff is None:
        return None
    return refusals_as_data(lambda present_rad: context.scene_state.with_diff(scene_diff, present_rad))


def _scene_from(situation: Situation, scene_diff: Message | None, state: Message, context: PlanningContext) -> Scene:
    """The scene of a start state, with what the options change in it."""
    if scene_diff is None:
        return situation.scene
    return context.scene_state.with_diff({**scene_diff, **(attached_diff(state) or {})}, situation.start_rad)


def _start_ignored(requests: Sequence[Message]) -> list[str]:
    """What MoveIt says too: a motion that is carried out begins where the arm is."""
    named = any(request["start_state"]["joint_state"]["name"] for request in requests)
    return ["start_state is ignored: the motion begins where the arm is"] if named else []


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

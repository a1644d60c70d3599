"""Actions of MoveIt's move_group: MoveGroup under its two names, MoveGroupSequence, and ExecuteTrajectory."""

import asyncio
import logging
import math
from collections.abc import Callable, Sequence
from typing import Any

from planners.problem import MoveItErrorCode
from robot.description.model import RobotModel
from robot.trajectory import Trajectory
from server.errors import RefusedError, refused
from server.execution.failures import with_nearest_goal
from server.execution.goal import Answer, GoalState, Progress
from server.execution.monitors import state_message
from server.execution.motions import Motion, MotionStep, PlannedMotion, plan_sequence
from server.execution.queue import GoalQueue
from server.graph.actions import ActionGoal
from server.graph.permissions import GOAL, PLANNING_GOAL, Node
from server.graph.providers import CompleteResponse
from server.graph.topics import Graph
from server.moveit.actions.goal_bridge import (
    cancel_with_goal,
    finish_goal,
    goal_status,
    plan_without_moving,
    reject_goal,
    submit_goal,
    work_on,
)
from server.moveit.actions.joint_trajectory_controller import checked_duration_s, checked_motion
from server.moveit.goals.goal_topics import with_suggestion
from server.moveit.messages import Message, error_code
from server.moveit.requests.planning_context import PlanningContext, attached_diff
from server.moveit.requests.planning_problems import PLANNING_LIMITS, TRAJECTORY_LIMITS, sequence_requests
from server.moveit.trajectories import is_long, to_message

log = logging.getLogger("armbridge.actions")

# ROS 2's name, and ROS 1's.
MOVE_ACTIONS = ("/move_action", "/move_group")
SEQUENCE_ACTION = "/sequence_move_group"
EXECUTE_ACTION = "/execute_trajectory"

# MoveIt's number of attempts for a goal that replans without giving one.
DEFAULT_ATTEMPTS = 5

# Bounds, so that every goal ends.
MAX_ATTEMPTS = 100
MAX_DELAY_S = 10.0

# MoveIt's names of states (MoveGroupState in move_group); a goal that waits in the queue has none.
PLANNING, IDLE = "PLANNING", "IDLE"
MOVE_GROUP_STATES = {GoalState.PLANNING: PLANNING, GoalState.EXECUTING: "MONITOR"}


def move_group_result(answer: Answer, robot: RobotModel) -> Message:
    performed = answer.performed
    return {
        "error_code": _explained_code(answer, robot),
        "trajectory_start": state_message(performed.start_rad, robot.root_link, 0.0),
        "planned_trajectory": _trajectory_message(next(iter(performed.planned), None), robot),
        # The arm's states are on /joint_states.
        "executed_trajectory": _trajectory_message(None, robot),
        "planning_time": performed.planning_time_s,
    }


def sequence_result(answer: Answer, robot: RobotModel) -> Message:
    performed = answer.performed
    response = {
        "error_code": _explained_code(answer, robot),
        "sequence_start": state_message(performed.start_rad, robot.root_link, 0.0),
        "planned_trajectories": [_trajectory_message(motion, robot) for motion in performed.planned],
        "planning_time": performed.planning_time_s,
    }
    return {"response": response}


def _explained_code(answer: Answer, robot: RobotModel) -> dict[str, Any]:
    return error_code(answer.code, with_suggestion(answer.message, answer.details, robot))


def _trajectory_message(motion: Trajectory | None, robot: RobotModel) -> dict[str, Any]:
    """Write the moveit_msgs/RobotTrajectory of a motion; as in MoveIt, one of no duration has no points."""
    return to_message(None if motion is None or motion.duration_s == 0.0 else motion, robot.root_link)


def offer_planning_actions(graph: Graph, context: PlanningContext, queue: GoalQueue) -> None:
    node = graph.node("move group")

    def offer(
        name: str,
        type_name: str,
        requests: Callable[[Message], Sequence[Message]],
        write_result: Callable[[Answer, RobotModel], Message],
    ) -> None:
        def result(answer: Answer) -> Message:
            return write_result(answer, context.robot)

        def start(goal: ActionGoal) -> None:
            try:
                asked, options = requests(goal.request), goal.request["planning_options"]
                if options["plan_only"]:
                    goal.feedback({"state": PLANNING})
                    work = plan_only(asked, goal.sender, context, options)
                    cancel = plan_without_moving(work, goal.action, lambda answer: _finish(goal, answer, result))
                    cancel_with_goal(goal, cancel)
                else:
                    motion = planned_motion(asked, options, context)
                    for warning in motion.warnings:
                        log.warning("%s: %s", goal.action, warning)
                    _execute(goal, queue, motion, result)
            except RefusedError as error:
                reject_goal(goal, queue, error.failure, result)

        node.offer_action(name, f"moveit_msgs/action/{type_name}", start, PLANNING_LIMITS, rule=PLANNING_GOAL)

    for name in MOVE_ACTIONS:
        offer(name, "MoveGroup", lambda goal: [goal["request"]], move_group_result)
    offer(SEQUENCE_ACTION, "MoveGroupSequence", lambda goal: sequence_requests(goal["request"]), sequence_result)


def _execute(goal: ActionGoal, queue: GoalQueue, motion: Motion, result: Callable[[Answer], Message]) -> None:
    """Submit the motion of a goal; its feedback is the name of the state, whenever that changes."""
    named = ""

    def send_feedback(progress: Progress) -> None:
        nonlocal named
        state = MOVE_GROUP_STATES.get(progress.state, named)
        if state != named:
            named = state
            goal.feedback({"state": state})

    submit_goal(goal, queue, motion, send_feedback, lambda answer: _finish(goal, answer, result))


def _finish(goal: ActionGoal, answer: Answer, result: Callable[[Answer], Message]) -> None:
    goal.feedback({"state": IDLE})
    if not is_long(answer.performed.planned):
        finish_goal(goal, answer, result)
        return

    async def write() -> None:
        goal.finish(goal_status(answer.code), CompleteResponse(await asyncio.to_thread(result, answer)))

    work_on(goal, write())


def scene_diff(options: Message) -> Message | None:
    """Return the moveit_msgs/PlanningScene to plan in of moveit_msgs/PlanningOptions; None for the present scene."""
    diff = options["planning_scene_diff"]
    return {**diff, "is_diff": True} if changes_scene(diff) else None


def ignored_options(options: Message) -> list[str]:
    return ["look_around is ignored: there is no sensor to look with"] if options["look_around"] else []


def replanning(options: Message) -> tuple[int, float]:
    """Read the attempts, and the delay between them [s], of moveit_msgs/PlanningOptions."""
    delay_s = float(options["replan_delay"])
    if not (math.isfinite(delay_s) and 0.0 <= delay_s <= MAX_DELAY_S):
        text = f"planning_options.replan_delay must be from 0 to {MAX_DELAY_S:g} s, not {delay_s:g}"
        raise refused(MoveItErrorCode.FAILURE, text, replan_delay=str(delay_s))
    for field in ("look_around_attempts", "replan_attempts"):
        if options[field] < 0:
            text = f"planning_options.{field} must be 0 or more, not {options[field]}"
            raise refused(MoveItErrorCode.FAILURE, text, field=field)
    attempts = options["replan_attempts"] if options["replan_attempts"] > 0 else DEFAULT_ATTEMPTS
    return min(attempts, MAX_ATTEMPTS) if options["replan"] else 1, delay_s


def changes_scene(scene: Message) -> bool:
    """Return True if a moveit_msgs/PlanningScene changes anything that plans depend on.

    A field that the client has left out has ``is_diff`` false, and must not empty the world.
    """
    world, attached = scene["world"]["collision_objects"], scene["robot_state"]["attached_collision_objects"]
    matrix, links = scene["allowed_collision_matrix"], scene["link_padding"] or scene["link_scale"]
    return bool(world or attached or matrix["entry_names"] or matrix["default_entry_names"] or links)


def planned_motion(requests: Sequence[Message], options: Message, context: PlanningContext) -> PlannedMotion:
    """Make the motion to plan and execute.

    Its problems are built once more when the goal's turn comes, for the start that the arm then has. They are built
    here for the present one, so that a goal that cannot be planned does not replace the motion of another.
    """
    diff, warnings, present_rad = scene_diff(options), ignored_options(options), context.current.positions_rad()
    attempts, delay_s = replanning(options)
    if any(request["start_state"]["joint_state"]["name"] for request in requests):
        # As in MoveIt.
        warnings.append("start_state is ignored: the motion begins where the arm is")
    if present_rad is not None:
        for request in requests:
            warnings += context.problems.motion_plan(request, present_rad).warnings
    return PlannedMotion(
        steps=tuple(map(context.problems.request_step, requests)),
        joints=context.problems.joints(requests),
        scene=None if diff is None else lambda now_rad: context.scene_state.with_diff(diff, now_rad),
        attempts=attempts,
        delay_s=delay_s,
        warnings=tuple(warnings),
    )


async def plan_only(
    requests: Sequence[Message], sender: Node, context: PlanningContext, options: Message | None = None
) -> Answer:
    """Plan moveit_msgs/MotionPlanRequests from the start state of the first, without moving; as :func:`plan_steps`."""
    warnings: list[str] = []
    steps = [context.problems.request_step(request, warnings) for request in requests]
    return await plan_steps(steps, requests[0]["start_state"], sender, context, options, warnings)


async def plan_steps(
    steps: Sequence[MotionStep],
    state: Message,
    sender: Node,
    context: PlanningContext,
    options: Message | None = None,
    warnings: Sequence[str] = (),
) -> Answer:
    """Plan motions one after the other, without moving, and show them.

    Positions that the sender assumes complete the start state. The steps may add warnings.
    """
    await context.scene_state.settled()
    ignored: list[str] = []
    try:
        start = context.start(state, sender)
        scene = start.scene
        if options is not None:
            replanning(options)
            ignored = ignored_options(options)
            if (diff := scene_diff(options)) is not None:
                scene = context.scene_state.with_diff({**diff, **(attached_diff(state) or {})}, start.start_rad)
    except RefusedError as error:
        return Answer.of(error.failure)
    planned = await plan_sequence(steps, start.start_rad, scene, context.pool)
    if planned.planned:
        context.display.performed(planned)
    if planned.failure is not None:
        context.display.contacts_of(planned.failure.details)
        failure = await with_nearest_goal(planned.failure, planned.problem, scene, context.pool)
        return Answer.of(failure, planned)
    sentences = (*start.warnings, *ignored, *warnings, *planned.notes)
    return Answer(MoveItErrorCode.SUCCESS, "; ".join(sentences), performed=planned)


def offer_execute_trajectory(graph: Graph, context: PlanningContext, queue: GoalQueue) -> None:
    def result(answer: Answer) -> Message:
        return {"error_code": error_code(answer.code, answer.message)}

    def start(goal: ActionGoal) -> None:
        trajectory = goal.request["trajectory"]
        if trajectory["multi_dof_joint_trajectory"]["points"]:
            log.warning("%s: multi_dof_joint_trajectory is ignored: the arm has no such joint", goal.action)
        message = trajectory["joint_trajectory"]
        if not message["points"]:
            # MoveIt's plan to a goal that is reached already has no points, and can be executed.
            finish_goal(goal, Answer(MoveItErrorCode.SUCCESS, "the trajectory has no points: nothing to do"), result)
            return
        try:
            # A trajectory that cannot be played does not replace the motion of another goal.
            checked_duration_s(message, context.time_limits)
            _execute(goal, queue, checked_motion(message, context), result)
        except RefusedError as error:
            reject_goal(goal, queue, error.failure, result)

    node, type_name = graph.node("execute trajectory"), "moveit_msgs/action/ExecuteTrajectory"
    node.offer_action(EXECUTE_ACTION, type_name, start, TRAJECTORY_LIMITS, rule=GOAL)

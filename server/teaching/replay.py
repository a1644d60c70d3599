"""Replay of taught motions: the action ``/replay_motion``.

A replay is a goal as others: the arm goes to the motion's start by a planned motion, then follows the motion as it was
taught, as fast as it was taught or slower where limits demand it, checked in the scene at that time.
"""

import functools
import logging
from dataclasses import replace
from typing import Any

from planners.goals import JointGoal
from planners.problem import MoveItErrorCode
from robot.description.model import RobotModel
from robot.description.srdf import Group
from server.errors import RefusedError, ServiceError, invalid
from server.execution.goal import Answer, GoalState, Progress
from server.execution.motions import MotionStep, PlannedMotion
from server.execution.queue import GoalQueue
from server.graph.actions import ActionGoal
from server.graph.permissions import GOAL
from server.graph.topics import Graph
from server.moveit.actions.goal_bridge import goal_status, reject_goal, submit_goal, work_on
from server.moveit.messages import error_code
from server.moveit.requests.planning_context import PlanningContext
from server.teaching.services import CHECK_TIME_S
from server.teaching.taught_motion import MotionFiles, TaughtMotion, read_speed

log = logging.getLogger("armbridge.teaching")

NAME = "/replay_motion"
TYPE = "armbridge_msgs/action/ReplayMotion"

# Each replay is planned before the first begins, and their durations together have a limit of their own.
MAX_REPEAT = 100


def offer_replay(graph: Graph, planning: PlanningContext, motions: MotionFiles, queue: GoalQueue) -> None:
    async def submit(goal: ActionGoal) -> None:
        name, repeat = goal.request["name"], goal.request["repeat"]
        try:
            speed = read_speed(goal.request["speed"])
            if repeat > MAX_REPEAT:
                raise invalid(f"repeat: must be 0 to {MAX_REPEAT}, not {repeat}", repeat=repeat)
            taught = await motions.load(name)
            if goal.request["reverse"]:
                taught = taught.reversed()
            motion = planned(taught, speed, repeat, planning)
        except RefusedError as error:
            reject_goal(goal, queue, error.failure, result)
        except ServiceError as error:
            reject_goal(goal, queue, invalid(str(error)).failure, result)
        else:

            def send_feedback(progress: Progress) -> None:
                fields = {"fraction": progress.fraction, "remaining_s": progress.remaining_s}
                goal.feedback({"state": progress.state.value, **fields})

            def end(answer: Answer) -> None:
                """End the goal, and log where the replay was slower than asked for."""
                made = answer.performed.planned
                slowed = taught.slowed(speed, made[-1], planning.robot) if made else ""
                if slowed:
                    log.info("the replay of %r took %s", name, slowed)
                send_feedback(Progress(GoalState.DONE, answer.message))
                goal.finish(goal_status(answer.code), result(answer, f"; it took {slowed}" if slowed else ""))

            if not goal.ended:
                submit_goal(goal, queue, motion, send_feedback, end)

    graph.node("replay").offer_action(NAME, TYPE, lambda goal: work_on(goal, submit(goal)), rule=GOAL)


def planned(taught: TaughtMotion, speed: float, repeat: int, planning: PlanningContext) -> PlannedMotion:
    """Return the motion to the start of a taught motion, and its replays."""
    joints = frozenset(taught.joint_names)
    to_start = [
        planning.problems.goal_step(group, JointGoal({name: taught.start_rad[name] for name in group.joints}))
        for group in groups_of(planning.robot, joints)
    ]
    replay: MotionStep = functools.partial(taught.problem, speed=speed, allowed_time_s=CHECK_TIME_S)
    return PlannedMotion((*to_start, replay) * (1 + repeat), joints)


def groups_of(robot: RobotModel, joints: frozenset[str]) -> list[Group]:
    """Return groups that have all of these joints and no other, the largest first, each joint in one of them."""
    chosen: list[Group] = []
    left = set(joints)
    for group in sorted(robot.groups.values(), key=lambda group: -len(group.joints)):
        if group.joints and set(group.joints) <= left:
            chosen.append(group)
            left -= set(group.joints)
    if left:
        raise invalid(f"the motion has joints that make no group without others: {', '.join(sorted(left))}")
    return chosen


def result(answer: Answer, note: str = "") -> dict[str, Any]:
    """Write the result of an answer; the note ends the sentence of a success."""
    item = answer.details.get("item")
    if isinstance(item, int):
        answer = replace(answer, message=answer.message.removeprefix(f"items[{item}]: "))
    followed = f"the arm has followed the motion{note}"
    message = followed if answer.code is MoveItErrorCode.SUCCESS else answer.message
    return {"error_code": error_code(answer.code, message), "message": message}

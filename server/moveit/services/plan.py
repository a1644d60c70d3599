"""``/plan_kinematic_path``: plans a motion and moves nothing."""

from __future__ import annotations

from typing import Any

from planners.problem import CartesianPlan, PlanningFailure
from server.errors import RefusedError
from server.execution.current_state import state_message
from server.graph.node import Node
from server.moveit.requests.codes import deviation_note, success
from server.moveit.requests.context import Message
from server.moveit.requests.refusals import required
from server.moveit.requests.trajectories import to_message
from server.moveit.services.planning_context import PlanningContext


async def plan_kinematic_path(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Plan; the response of moveit_msgs/GetMotionPlan.

    Raises:
        RefusedError: there is no such motion, and why.
    """
    asked = request["motion_plan_request"]
    situation = context.situation(asked["start_state"], caller)
    read = required(context.read(asked, situation.start_rad))
    plan = await context.pool.ask(read.problem, situation.scene)
    if isinstance(plan, PlanningFailure):
        raise RefusedError(plan)
    if isinstance(plan, CartesianPlan) and plan.stopped_by is not None:
        raise RefusedError(plan.stopped_by)
    context.display.planned((plan.trajectory,), situation.start_rad)
    notes = (*situation.warnings, *read.warnings, deviation_note(plan.deviation))
    root = context.robot.root_link
    response = {
        "trajectory_start": state_message(dict(situation.start_rad), root, 0.0),
        "group_name": read.problem.group,
        "trajectory": to_message(plan.trajectory, root),
        "planning_time": plan.planning_time_s,
        "error_code": success(*notes),
    }
    context.display.pipeline(asked, response)
    return {"motion_plan_response": response}

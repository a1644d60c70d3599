"""``/plan_sequence_path``: plans motions one after the other and moves nothing."""

from __future__ import annotations

from typing import Any

from server.execution.current_state import state_message
from server.execution.motions import plan_sequence
from server.graph.node import Node
from server.moveit.requests.codes import failure_code, success
from server.moveit.requests.context import Message
from server.moveit.requests.refusals import required
from server.moveit.requests.sequence import requests_of
from server.moveit.requests.trajectories import to_message
from server.moveit.services.planning_context import PlanningContext


async def plan_sequence_path(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Plan; the response of moveit_msgs/GetMotionSequence.

    A sequence that cannot be planned to its end is answered with the motions before the first that fails, and why.

    Raises:
        RefusedError: a sequence that cannot be, or a start that cannot.
    """
    asked = request["request"]
    requests = required(requests_of(asked))
    steps = [context.step(one) for one in requests]
    situation = context.situation(requests[0]["start_state"], caller)
    planned = await plan_sequence(steps, situation.start_rad, situation.scene, context.pool.ask)
    root, performed = context.robot.root_link, planned.performed
    context.display.planned(performed.planned, situation.start_rad)
    failure = planned.failure
    return {
        "response": {
            "error_code": success(*situation.warnings, *planned.notes) if failure is None else failure_code(failure),
            "sequence_start": state_message(dict(situation.start_rad), root, 0.0),
            "planned_trajectories": [to_message(motion, root) for motion in performed.planned],
            "planning_time": performed.planning_time_s,
        }
    }

"""Which of MoveIt's services are here, and how their calls are answered."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from server.errors import RefusedError, ServiceError
from server.graph.node import Node
from server.graph.services import Call, answer
from server.graph.topics import Graph
from server.moveit.parameters import MAX_ALLOWED_PLANNING_TIME_S
from server.moveit.requests.codes import failure_code
from server.moveit.requests.context import Message
from server.moveit.services.cartesian import compute_cartesian_path
from server.moveit.services.group_urdf import get_urdf
from server.moveit.services.kinematics import compute_fk, compute_ik
from server.moveit.services.plan import plan_kinematic_path
from server.moveit.services.planner_interface import get_planner_params, query_planner_interface, set_planner_params
from server.moveit.services.planning_context import PlanningContext
from server.moveit.services.sequence import plan_sequence_path
from server.moveit.services.validity import check_state_validity

log = logging.getLogger("armbridge.moveit")

# The planners' own deadline, and as long for what others ask before; then the caller is told.
TIMEOUT_S = 2.0 * MAX_ALLOWED_PLANNING_TIME_S

Answering: TypeAlias = Callable[[PlanningContext, Message, Node], Awaitable[dict[str, Any]] | dict[str, Any]]


def code_alone(failure: PlanningFailure) -> dict[str, Any]:
    """The response that says why there is none."""
    return {"error_code": failure_code(failure)}


def call_failed(failure: PlanningFailure) -> dict[str, Any]:
    """For responses that have no room for a reason: the call as such fails.

    Raises:
        ServiceError: always.
    """
    raise ServiceError(failure.message)


@dataclass(frozen=True)
class Offer:
    """One service.

    Attributes:
        type_name: its type.
        answering: makes the response; raises RefusedError with the reason when it cannot.
        refusal: the response for such a reason.
    """

    type_name: str
    answering: Answering
    refusal: Callable[[PlanningFailure], dict[str, Any]] = code_alone


OFFERS: Mapping[str, Offer] = {
    "/plan_kinematic_path": Offer(
        "moveit_msgs/srv/GetMotionPlan", plan_kinematic_path, lambda why: {"motion_plan_response": code_alone(why)}
    ),
    "/compute_ik": Offer("moveit_msgs/srv/GetPositionIK", compute_ik),
    "/compute_fk": Offer("moveit_msgs/srv/GetPositionFK", compute_fk),
    "/compute_cartesian_path": Offer("moveit_msgs/srv/GetCartesianPath", compute_cartesian_path),
    # The response has no code; the reason is in the log.
    "/check_state_validity": Offer(
        "moveit_msgs/srv/GetStateValidity", check_state_validity, lambda _why: {"valid": False}
    ),
    "/plan_sequence_path": Offer(
        "moveit_msgs/srv/GetMotionSequence", plan_sequence_path, lambda why: {"response": code_alone(why)}
    ),
    "/query_planner_interface": Offer("moveit_msgs/srv/QueryPlannerInterfaces", query_planner_interface, call_failed),
    "/get_planner_params": Offer("moveit_msgs/srv/GetPlannerParams", get_planner_params, call_failed),
    "/set_planner_params": Offer("moveit_msgs/srv/SetPlannerParams", set_planner_params, call_failed),
    "/get_urdf": Offer("moveit_msgs/srv/GetGroupUrdf", get_urdf),
}


def offer_services(graph: Graph, context: PlanningContext) -> None:
    """Offer them all.

    Args:
        graph: where they are.
        context: what they work with.
    """
    node = Node("moveit services")
    for name, offer in OFFERS.items():
        graph.services.offer_calls(node, name, offer.type_name, _starter(offer, context), TIMEOUT_S)


def _starter(offer: Offer, context: PlanningContext) -> Callable[[Call], None]:
    return lambda call: answer(call, lambda request: _answer(offer, context, call, request))


async def _answer(offer: Offer, context: PlanningContext, call: Call, request: Message) -> dict[str, Any]:
    try:
        made = offer.answering(context, request, call.caller)
        response = await made if inspect.isawaitable(made) else made
    except RefusedError as refusal:
        failure = refusal.failure
        log.warning("%s: %s: %s", call.service, failure.code.name, failure.message)
        context.display.contacts_of(failure.details)
        return offer.refusal(failure)
    _log_notes(call.service, response)
    return response


def _log_notes(service: str, response: Mapping[str, Any]) -> None:
    """Put what a response says beside its code into the log."""
    inner = next((response[name] for name in ("motion_plan_response", "response") if name in response), response)
    code = inner.get("error_code")
    if code is not None and code["message"]:
        name = MoveItErrorCode(code["val"]).name
        level = logging.INFO if code["val"] == MoveItErrorCode.SUCCESS else logging.WARNING
        log.log(level, "%s: %s: %s", service, name, code["message"])

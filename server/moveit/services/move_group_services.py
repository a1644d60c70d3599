"""MoveIt's services"""

from __future__ import annotations

import inspect
import logging
import xml.etree.ElementTree as ET
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from planners.problem import CartesianPlan, MoveItErrorCode, PlanningFailure
from robot.model import Group, RobotModel
from server.calls import Call, answer
from server.errors import RefusedError, ServiceError
from server.graph import Graph
from server.moveit.current_state import state_message
from server.moveit.parameters import MAX_ALLOWED_PLANNING_TIME_S
from server.moveit.planner_parameters import KNOWN_KEYS
from server.moveit.requests.context import Message
from server.moveit.requests.error_codes import deviation_note, failure_code, required, success
from server.moveit.requests.motion_plan import OMPL, PILZ, PIPELINES, check_pipeline, requests_of
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.requests.trajectories import to_message
from server.moveit.services.cartesian_path import compute_cartesian_path
from server.moveit.services.kinematics import check_state_validity, compute_fk, compute_ik
from server.moveit.step_planning import plan_steps
from server.node import Node


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
    planned = await plan_steps(steps, situation.start_rad, situation.scene, context.pool.ask)
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


# As MoveIt's planning plugins call themselves.
INTERFACE_NAMES = {OMPL: "OMPL", PILZ: "Pilz Industrial Motion Planner"}


def query_planner_interface(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - as every service
    """The planners by name; the response of moveit_msgs/QueryPlannerInterfaces."""
    interfaces = [
        {"name": INTERFACE_NAMES[pipeline], "pipeline_id": pipeline, "planner_ids": list(planners)}
        for pipeline, planners in PIPELINES.items()
    ]
    return {"planner_interfaces": interfaces}


def get_planner_params(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - as every service
    """Parameters of a planner; the response of moveit_msgs/GetPlannerParams.

    Raises:
        RefusedError: there is no such pipeline or group.
    """
    _check(context, request)
    texts = context.parameters.texts(request["group"], request["planner_config"])
    descriptions = ["" if key in KNOWN_KEYS else "kept, changes nothing" for key in texts]
    return {"params": {"keys": list(texts), "values": list(texts.values()), "descriptions": descriptions}}


def set_planner_params(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - as every service
    """Set parameters of a planner; the response of moveit_msgs/SetPlannerParams, which is empty.

    Raises:
        RefusedError: there is no such pipeline or group.
        ServiceError: a value that cannot be.
    """
    _check(context, request)
    keys, values = request["params"]["keys"], request["params"]["values"]
    if len(keys) != len(values):
        raise ServiceError(f"params.keys has {len(keys)} entries and params.values {len(values)}")
    replace = request["replace"]
    context.parameters.set(
        request["group"], request["planner_config"], dict(zip(keys, values, strict=True)), replace=replace
    )
    return {}


def _check(context: PlanningContext, request: Message) -> None:
    check_pipeline(request["pipeline_id"])
    if request["group"]:
        context.group(request["group"])


def get_urdf(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - as every service
    """The URDF of a group; the response of moveit_msgs/GetGroupUrdf.

    Raises:
        RefusedError: there is no such group.
    """
    group = context.group(request["group_name"])
    return {"error_code": success(), "urdf_string": group_urdf(context.robot, group)}


def group_urdf(robot: RobotModel, group: Group) -> str:
    """The links and joints from a group's base to its tip, as a URDF of their own."""
    by_child = {joint.child: joint for joint in robot.joints.values()}
    links, joints = {group.base_link}, set()
    for name in group.joints:
        joints.add(name)
        links |= {robot.joints[name].parent, robot.joints[name].child}
    link = group.tip_link
    while link != group.base_link and link in by_child:
        joints.add(by_child[link].name)
        links.add(link)
        link = by_child[link].parent
    # Our own file: model.parse has read it before.
    whole = ET.fromstring(robot.urdf)  # noqa: S314
    part = ET.Element("robot", {"name": group.name})
    for element in whole:
        wanted = {"link": links, "joint": joints}.get(element.tag)
        if wanted is None or element.get("name") in wanted:
            part.append(element)
    return ET.tostring(part, encoding="unicode")


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

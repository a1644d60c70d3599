"""Services of MoveIt's move_group: the list of all, and most of their functions.

These plan motions, describe planners and groups, and answer for kinematics and the validity of states.
Their functions raise RefusedError. Here it is caught, logged and written into the response.
"""

import asyncio
import functools
import inspect
import logging
import xml.etree.ElementTree as ET
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, cast

from planners.goals import Constraints
from planners.problem import MoveItErrorCode, PlanningFailure, StateQuestion
from planners.scene import Scene
from protocol.messages import Stamp
from robot.description.model import Group, RobotModel
from server.errors import RefusedError, ServiceError, UnsuccessfulError, required
from server.execution.monitors import state_message
from server.execution.motions import Performed, deviation_note
from server.graph.permissions import CONFIGURING, LOOKING, PLANNING, Node, Rule
from server.graph.providers import CompleteResponse
from server.graph.services import Answered, Call, answer
from server.graph.topics import Graph
from server.moveit.actions.move_group import move_group_result, plan_only, sequence_result
from server.moveit.messages import Message, error_code, success, write_pose
from server.moveit.parameters import KNOWN_KEYS, MAX_ALLOWED_PLANNING_TIME_S
from server.moveit.requests.constraints import known_link, read_path_constraints
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.requests.planning_problems import (
    OMPL,
    PILZ,
    PIPELINES,
    PLANNING_LIMITS,
    check_pipeline,
    sequence_requests,
)
from server.moveit.scene.frames import seen_from
from server.moveit.trajectories import to_messages, written

log = logging.getLogger("armbridge.moveit")

# moveit_msgs/ContactInformation's body types.
ROBOT_LINK, WORLD_OBJECT, ROBOT_ATTACHED = 0, 1, 2

# Computes the response to a request of a client.
Handler: TypeAlias = Callable[[PlanningContext, Message, Node], Awaitable[Message] | Message]

# Twice the planners' own deadline: a request may wait for another one first.
TIMEOUT_S = 2.0 * MAX_ALLOWED_PLANNING_TIME_S

# A waypoint in a frame takes 50 us to read.
MAX_WAYPOINTS_AT_ONCE = 50

# Names that MoveIt's planning plugins have.
INTERFACE_NAMES = {OMPL: "OMPL", PILZ: "Pilz Industrial Motion Planner"}


async def compute_ik(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Find joint positions for poses of links; returns the response of moveit_msgs/GetPositionIK."""
    ik_request = request["ik_request"]
    group = context.problems.group(ik_request["group_name"])
    seed_rad = within_limits(context.robot, context.positions_rad(ik_request["robot_state"], caller))
    scene = context.scene_of(ik_request["robot_state"], seed_rad)
    built = context.problems.ik(ik_request, group, seed_rad)
    found = await context.pool.ask(built.problem, scene)
    if isinstance(found, PlanningFailure) and found.code is MoveItErrorCode.GOAL_IN_COLLISION:
        # As MoveIt answers: clients that try one pose after the other go on where there is no solution.
        found = replace(found, code=MoveItErrorCode.NO_IK_SOLUTION)
    answer = required(found)
    solution = state_message(answer.positions_rad[0], context.robot.root_link, 0.0)
    return {"solution": solution, "error_code": success(*built.warnings, deviation_note(answer.deviations[0]))}


def compute_fk(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Compute poses of links, in the frame of the request's header; returns the response of moveit_msgs/GetPositionFK.

    Without names it computes the poses of all links.
    """
    positions_rad = context.positions_rad(request["robot_state"], caller)
    names = request["fk_link_names"] or list(context.robot.links)
    frame_id = request["header"]["frame_id"] or context.robot.root_link
    frame = context.frames.resolve(frame_id, positions_rad)
    links = context.scene_state.links(positions_rad)
    header = {"stamp": Stamp(0, 0).as_message(), "frame_id": frame_id}
    poses: dict[str, Message] = {}
    for name in dict.fromkeys(names):
        pose = links.pose(known_link(context.robot, name))
        poses[name] = {"header": header, "pose": write_pose(seen_from(frame, pose))}
    return {"pose_stamped": [poses[name] for name in names], "fk_link_names": names, "error_code": success()}


def within_limits(robot: RobotModel, positions_rad: Mapping[str, float]) -> dict[str, float]:
    """Clamp positions to the limits of their joints [rad]: IK starts from the nearest state within them."""
    joints = robot.joints
    return {name: min(max(value, joints[name].lower), joints[name].upper) for name, value in positions_rad.items()}


async def check_state_validity(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Return the response of moveit_msgs/GetStateValidity; raises UnsuccessfulError for an invalid state."""
    group = context.problems.group(request["group_name"])
    positions_rad = context.positions_rad(request["robot_state"], caller)
    scene = context.scene_of(request["robot_state"], positions_rad)
    constraints = read_path_constraints(
        request["constraints"], context.problems.context(group, positions_rad), "constraints"
    )
    state = required(await context.pool.ask(StateQuestion(group.name, positions_rad), scene))
    # Each constraint alone, in MoveIt's order of results.
    singles = [
        *(Constraints(joints=(each,)) for each in constraints.joints),
        *(Constraints(positions=(each,)) for each in constraints.positions),
        *(Constraints(orientations=(each,)) for each in constraints.orientations),
    ]
    unmet = []
    for single in singles:
        answered = required(await context.pool.ask(StateQuestion(group.name, positions_rad, single), scene))
        violated = (each for each in answered.problems if each.code is MoveItErrorCode.GOAL_CONSTRAINTS_VIOLATED)
        unmet.append(next(violated, None))
    pairs = [pair for problem in state.problems for pair in problem.details.get("pairs", ())]
    context.display.contacts(pairs)
    response = {
        "valid": state.valid and not any(unmet),
        "contacts": _contacts(pairs, context.robot, scene),
        "cost_sources": [],
        "constraint_result": [_constraint_result(problem) for problem in unmet],
    }
    if response["valid"]:
        return response
    reasons = [problem.message for problem in (*state.problems, *filter(None, unmet))]
    for reason in reasons:
        log.info("/check_state_validity: %s", reason)
    raise UnsuccessfulError(CompleteResponse(response), "; ".join(reasons))


def _constraint_result(unmet: PlanningFailure | None) -> dict[str, Any]:
    """Write a moveit_msgs/ConstraintEvalResult, with the distance beyond the tolerance [m], [rad]."""
    details = {} if unmet is None else unmet.details
    beyond = details.get("beyond_m", 0.0) or details.get("beyond_rad", 0.0)
    if "position_rad" in details:
        position = details["position_rad"]
        beyond = max(details["lower_rad"] - position, position - details["upper_rad"], 0.0)
    return {"result": unmet is None, "distance": float(beyond)}


def _contacts(pairs: Sequence[Mapping[str, Any]], robot: RobotModel, scene: Scene) -> list[dict[str, Any]]:
    attached = {each.object.name for each in scene.attached}

    def body_type(name: str) -> int:
        if name in robot.links:
            return ROBOT_LINK
        return ROBOT_ATTACHED if name in attached else WORLD_OBJECT

    header = {"stamp": Stamp(0, 0).as_message(), "frame_id": robot.root_link}
    return [
        {
            "header": header,
            "position": dict(zip("xyz", pair["point_m"], strict=True)),
            "normal": dict(zip("xyz", pair["normal"], strict=True)),
            "depth": pair["depth_m"],
            "contact_body_1": pair["first"],
            "body_type_1": body_type(pair["first"]),
            "contact_body_2": pair["second"],
            "body_type_2": body_type(pair["second"]),
        }
        for pair in pairs
    ]


async def plan_kinematic_path(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Plan a motion; returns the response of moveit_msgs/GetMotionPlan."""
    plan_request = request["motion_plan_request"]
    group = context.problems.group(plan_request["group_name"])
    answer = await plan_only([plan_request], caller, context)
    result = await written(answer.performed.planned, lambda: move_group_result(answer, context.robot))
    response = {
        "trajectory_start": result["trajectory_start"],
        "group_name": group.name,
        "trajectory": result["planned_trajectory"],
        "planning_time": result["planning_time"],
        "error_code": result["error_code"],
    }
    context.display.pipeline(plan_request, response)
    return {"motion_plan_response": response}


async def compute_cartesian_path(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Plan a path of the tip through waypoints; returns the response of moveit_msgs/GetCartesianPath.

    If only a part of the path can be followed, the response has that part and its fraction. The code is SUCCESS, as in
    MoveIt (cartesian_path_service_capability.cpp), and its message has the reason.
    """
    start = context.start(request["start_state"], caller)
    # A long path takes as long to read as everybody may be kept waiting.
    long = len(request["waypoints"]) > MAX_WAYPOINTS_AT_ONCE
    read = context.problems.cartesian_path
    built = await asyncio.to_thread(read, request, start.start_rad) if long else read(request, start.start_rad)
    plan = required(await context.pool.ask(built.problem, start.scene))
    root = context.robot.root_link
    [solution] = await to_messages([plan.trajectory], root)
    context.display.performed(Performed(start.start_rad, (plan.trajectory,)))
    if plan.stopped_by is not None:
        context.display.contacts_of(plan.stopped_by.details)
    return {
        "start_state": state_message(start.start_rad, root, 0.0),
        "solution": solution,
        "fraction": plan.fraction,
        "error_code": success(
            *start.warnings,
            *built.warnings,
            "" if plan.stopped_by is None else plan.stopped_by.message,
            deviation_note(plan.deviation),
        ),
    }


async def plan_sequence_path(context: PlanningContext, request: Message, caller: Node) -> Message:
    """Plan a sequence of motions; returns the response of moveit_msgs/GetMotionSequence.

    If an item cannot be planned, the response has the motions of the items before it, and the item's error code.
    """
    answer = await plan_only(sequence_requests(request["request"]), caller, context)
    return await written(answer.performed.planned, lambda: sequence_result(answer, context.robot))


def query_planner_interface(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - a Handler
    interfaces = [
        {"name": INTERFACE_NAMES[pipeline], "pipeline_id": pipeline, "planner_ids": list(planners)}
        for pipeline, planners in PIPELINES.items()
    ]
    return {"planner_interfaces": interfaces}


def get_planner_params(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - a Handler
    """Look parameters of a planner up; returns the response of moveit_msgs/GetPlannerParams."""
    _check_planner(context, request)
    texts = context.parameters.texts(request["group"], request["planner_config"])
    descriptions = ["" if key in KNOWN_KEYS else "kept, changes nothing" for key in texts]
    return {"params": {"keys": list(texts), "values": list(texts.values()), "descriptions": descriptions}}


def set_planner_params(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - a Handler
    """Set parameters of a planner; returns the empty response of moveit_msgs/SetPlannerParams."""
    _check_planner(context, request)
    keys, values = request["params"]["keys"], request["params"]["values"]
    if len(keys) != len(values):
        raise ServiceError(f"params.keys has {len(keys)} entries and params.values {len(values)}")
    scope, texts = (request["group"], request["planner_config"]), dict(zip(keys, values, strict=True))
    context.parameters.set(*scope, texts, replace=request["replace"])
    return {}


def _check_planner(context: PlanningContext, request: Message) -> None:
    check_pipeline(request["pipeline_id"])
    if request["group"]:
        context.problems.group(request["group"])


def get_urdf(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - a Handler
    """Write the URDF of a planning group; returns the response of moveit_msgs/GetGroupUrdf."""
    group = context.problems.group(request["group_name"])
    # Made once: it takes a millisecond, of a large description ten.
    response = context.urdf_responses.get(group.name)
    if response is None:
        response = {"error_code": success(), "urdf_string": group_urdf(context.robot, group)}
        context.urdf_responses[group.name] = response
    return response


def group_urdf(robot: RobotModel, group: Group) -> str:
    """Write the links and joints from a group's base to its tip as a URDF of their own."""
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
    # The server's own file, parsed once before: no hostile XML.
    whole = ET.fromstring(robot.urdf)  # noqa: S314
    part = ET.Element("robot", {"name": group.name})
    for element in whole:
        kept = {"link": links, "joint": joints}.get(element.tag)
        if kept is None or element.get("name") in kept:
            part.append(element)
    return ET.tostring(part, encoding="unicode")


def _error_response(failure: PlanningFailure) -> dict[str, Any]:
    return {"error_code": error_code(failure.code, failure.message)}


def _fail_call(failure: PlanningFailure) -> dict[str, Any]:
    """Make the call fail: its response has no field for the reason."""
    raise ServiceError(failure.message)


def _invalid_state(failure: PlanningFailure) -> dict[str, Any]:
    """Answer that a state is invalid; the response has no field for the reason."""
    raise UnsuccessfulError({"valid": False}, failure.message)


@dataclass(frozen=True)
class MoveGroupService:
    """Service of move_group, whose handler writes every field of the response."""

    type_name: str
    handler: Handler
    rejection: Callable[[PlanningFailure], dict[str, Any]] = _error_response
    rule: Rule = PLANNING


SERVICES: Mapping[str, MoveGroupService] = {
    "/plan_kinematic_path": MoveGroupService(
        "GetMotionPlan", plan_kinematic_path, lambda failure: {"motion_plan_response": _error_response(failure)}
    ),
    "/compute_ik": MoveGroupService("GetPositionIK", compute_ik),
    "/compute_fk": MoveGroupService("GetPositionFK", compute_fk, rule=LOOKING),
    "/compute_cartesian_path": MoveGroupService("GetCartesianPath", compute_cartesian_path),
    "/check_state_validity": MoveGroupService("GetStateValidity", check_state_validity, _invalid_state),
    "/plan_sequence_path": MoveGroupService(
        "GetMotionSequence", plan_sequence_path, lambda failure: {"response": _error_response(failure)}
    ),
    "/query_planner_interface": MoveGroupService(
        "QueryPlannerInterfaces", query_planner_interface, _fail_call, rule=LOOKING
    ),
    "/get_planner_params": MoveGroupService("GetPlannerParams", get_planner_params, _fail_call, rule=LOOKING),
    "/set_planner_params": MoveGroupService("SetPlannerParams", set_planner_params, _fail_call, rule=CONFIGURING),
    "/get_urdf": MoveGroupService("GetGroupUrdf", get_urdf, rule=LOOKING),
}


def offer_services(graph: Graph, context: PlanningContext) -> None:
    node = graph.node("moveit services")
    for name, service in SERVICES.items():
        type_name, start = f"moveit_msgs/srv/{service.type_name}", functools.partial(_start, service, context)
        node.offer_calls(name, type_name, start, TIMEOUT_S, PLANNING_LIMITS, rule=service.rule)


def _start(service: MoveGroupService, context: PlanningContext, call: Call) -> None:
    """Answer a call, at once where the service plans nothing: no more answers wait then than the caller reads."""
    later = inspect.iscoroutinefunction(service.handler) or context.scene_state.pending
    answer(call, lambda _request: (_respond_later if later else _respond)(service, context, call))


def _respond(service: MoveGroupService, context: PlanningContext, call: Call) -> Answered:
    try:
        return _response(call, cast(Message, service.handler(context, call.request, call.caller)))
    except RefusedError as error:
        return _rejection(service, context, call, error.failure)


async def _respond_later(service: MoveGroupService, context: PlanningContext, call: Call) -> Answered:
    # Requests are read one by one, and the event loop has its turns in between.
    async with context.turn:
        await asyncio.sleep(0)
    # After the changes of the scene that were sent before, also long ones.
    await context.scene_state.settled()
    try:
        handled = service.handler(context, call.request, call.caller)
        return _response(call, await handled if inspect.isawaitable(handled) else handled)
    except RefusedError as error:
        return _rejection(service, context, call, error.failure)


def _rejection(
    service: MoveGroupService, context: PlanningContext, call: Call, failure: PlanningFailure
) -> Mapping[str, Any]:
    log.warning("%s: %s: %s", call.service, failure.code.name, failure.message)
    context.display.contacts_of(failure.details)
    return service.rejection(failure)


def _response(call: Call, response: Message) -> CompleteResponse:
    # ROS 1 has no field for the message of an error code, so it is logged.
    inner = next((response[name] for name in ("motion_plan_response", "response") if name in response), response)
    code = inner.get("error_code")
    if code is not None and code["message"]:
        name = MoveItErrorCode(code["val"]).name
        level = logging.INFO if code["val"] == MoveItErrorCode.SUCCESS else logging.WARNING
        log.log(level, "%s: %s: %s", call.service, name, code["message"])
    return CompleteResponse(response)

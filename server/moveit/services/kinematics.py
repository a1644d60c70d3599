"""``/compute_ik``, ``/compute_fk`` and ``/check_state_validity``."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from typing import Any

from planners.goals import Constraints
from planners.problem import MoveItErrorCode, StateAnswer, StateQuestion
from planners.scene import Scene
from protocol.messages import Stamp
from robot.description.model import RobotModel
from server.graph.node import Node
from server.moveit.current_state import state_message
from server.moveit.poses import pose_of, write_pose
from server.moveit.requests.constraints import read_path_constraints
from server.moveit.requests.context import Message
from server.moveit.requests.error_codes import deviation_note, refused, required, success
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.requests.planning_problems import check_link_count
from server.moveit.scene.frames import seen_from

log = logging.getLogger("armbridge.moveit")

# moveit_msgs/ContactInformation's body types.
ROBOT_LINK, WORLD_OBJECT, ROBOT_ATTACHED = 0, 1, 2


async def compute_ik(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Find joint positions for poses of links; returns the response of moveit_msgs/GetPositionIK.

    Raises:
        RefusedError: there are none, or the request cannot be used.
    """
    ik_request = request["ik_request"]
    group = context.problems.group(ik_request["group_name"])
    seed_rad = within_limits(context.robot, context.positions_rad(ik_request["robot_state"], caller))
    scene = context.scene_of(ik_request["robot_state"], seed_rad)
    built = context.problems.ik(ik_request, group, seed_rad)
    answer = required(await context.pool.ask(built.problem, scene))
    solution = state_message(dict(answer.positions_rad[0]), context.robot.root_link, 0.0)
    return {"solution": solution, "error_code": success(*built.warnings, deviation_note(answer.deviations[0]))}


async def compute_fk(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Compute poses of links, in the frame of the request's header; returns the response of moveit_msgs/GetPositionFK.

    Without names it computes the poses of all links.

    Raises:
        RefusedError: an unknown link or frame, or a state that cannot be used.
    """
    check_link_count(request["fk_link_names"], "fk_link_names")
    positions_rad = context.positions_rad(request["robot_state"], caller)
    names = request["fk_link_names"] or list(context.robot.links)
    frame_id = request["header"]["frame_id"] or context.robot.root_link
    frame = required(context.frames.resolve(frame_id, positions_rad))
    transforms = context.forward.transforms(positions_rad)
    header = {"stamp": Stamp(0, 0).as_message(), "frame_id": frame_id}
    poses = []
    for name in names:
        if name not in transforms:
            known = ", ".join(context.robot.links)
            raise refused(
                MoveItErrorCode.INVALID_LINK_NAME, f"the robot has no link {name!r}; it has: {known}", link=name
            )
        poses.append({"header": header, "pose": write_pose(seen_from(frame, pose_of(transforms[name])))})
    return {"pose_stamped": poses, "fk_link_names": names, "error_code": success()}


def within_limits(robot: RobotModel, positions_rad: Mapping[str, float]) -> dict[str, float]:
    """Clamp positions to the limits of their joints [rad]: IK starts from the nearest state within them."""
    joints = robot.joints
    return {name: min(max(value, joints[name].lower), joints[name].upper) for name, value in positions_rad.items()}


async def check_state_validity(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Check a state for limits, collisions and constraints; returns the response of moveit_msgs/GetStateValidity.

    Raises:
        RefusedError: a state, group or constraint that cannot be used.
    """
    group = context.problems.group(request["group_name"])
    positions_rad = context.positions_rad(request["robot_state"], caller)
    scene = context.scene_of(request["robot_state"], positions_rad)
    constraints = read_path_constraints(
        request["constraints"], context.problems.context(group, positions_rad), "constraints"
    )
    state = required(await context.pool.ask(StateQuestion(group.name, positions_rad), scene))
    results = [
        _constraint_result(required(await context.pool.ask(StateQuestion(group.name, positions_rad, single), scene)))
        for single in _single_constraints(constraints)
    ]
    for problem in state.problems:
        log.info("/check_state_validity: %s", problem.message)
    pairs = [pair for problem in state.problems for pair in problem.details.get("pairs", ())]
    context.display.contacts(pairs)
    return {
        "valid": state.valid and all(result["result"] for result in results),
        "contacts": [_contact(pair, context.robot, scene) for pair in pairs],
        "constraint_result": results,
    }


def _single_constraints(constraints: Constraints) -> Iterator[Constraints]:
    """Yield each constraint alone, in MoveIt's order of results."""
    yield from (Constraints(joints=(one,)) for one in constraints.joints)
    yield from (Constraints(positions=(one,)) for one in constraints.positions)
    yield from (Constraints(orientations=(one,)) for one in constraints.orientations)


def _constraint_result(answer: StateAnswer) -> dict[str, Any]:
    """Write a moveit_msgs/ConstraintEvalResult; its distance is the one beyond the tolerance, 0 if it holds."""
    for problem in answer.problems:
        if problem.code is MoveItErrorCode.GOAL_CONSTRAINTS_VIOLATED:
            log.info("/check_state_validity: %s", problem.message)
            return {"result": False, "distance": _distance(problem.details)}
    return {"result": True, "distance": 0.0}


def _distance(details: Mapping[str, Any]) -> float:
    """Return the distance beyond a constraint's tolerance [m], [rad]."""
    if "beyond_m" in details or "beyond_rad" in details:
        return float(details.get("beyond_m", 0.0) or details.get("beyond_rad", 0.0))
    position = details["position_rad"]
    return float(max(details["lower_rad"] - position, position - details["upper_rad"], 0.0))


def _contact(pair: Mapping[str, Any], robot: RobotModel, scene: Scene) -> dict[str, Any]:
    """Write a moveit_msgs/ContactInformation."""
    attached = {each.object.name for each in scene.attached}

    def body_type(name: str) -> int:
        if name in robot.links:
            return ROBOT_LINK
        return ROBOT_ATTACHED if name in attached else WORLD_OBJECT

    return {
        "header": {"frame_id": robot.root_link},
        "position": dict(zip("xyz", pair["point_m"], strict=True)),
        "normal": dict(zip("xyz", pair["normal"], strict=True)),
        "depth": pair["depth_m"],
        "contact_body_1": pair["first"],
        "body_type_1": body_type(pair["first"]),
        "contact_body_2": pair["second"],
        "body_type_2": body_type(pair["second"]),
    }

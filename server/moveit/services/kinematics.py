"""``/compute_ik``, ``/compute_fk`` and ``/check_state_validity``."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from planners.goals import ConstraintGoal, Constraints, Goal, OrientationConstraint, PoseGoal, PositionConstraint
from planners.problem import IkQuestion, MoveItErrorCode, StateAnswer, StateQuestion
from planners.scene import Pose, Scene
from protocol.messages import Stamp
from robot.model import RobotModel
from server.moveit.current_state import state_message
from server.moveit.parameters import MAX_KINEMATICS_TIMEOUT_S, MoveItParameters
from server.moveit.poses import pose_of, write_pose
from server.moveit.requests.constraints import LEAST_ORIENTATION_TOLERANCE_RAD, LEAST_TOLERANCE_M, path_constraints_of
from server.moveit.requests.context import Message, RequestContext
from server.moveit.requests.error_codes import deviation_note, invalid, refused, required, success
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.scene.frames import seen_from
from server.node import Node

NANOSECONDS_PER_S = 1e9

# Named in one call; a robot has a few dozen, and each costs time that all clients wait for.
MAX_LINKS = 1000


async def compute_ik(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Find joint positions for poses of links; the response of moveit_msgs/GetPositionIK.

    Raises:
        RefusedError: there are none, and why.
    """
    asked = request["ik_request"]
    group = context.group(asked["group_name"])
    seed_rad = within_limits(context.robot, context.positions_rad(asked["robot_state"], caller))
    scene = context.scene_of(asked["robot_state"], seed_rad)
    reading = context.request_context(group, seed_rad)
    constraints = required(path_constraints_of(asked["constraints"], reading, "ik_request.constraints"))
    question = IkQuestion(
        group=group.name,
        start_rad=seed_rad,
        goal=_ik_goal(asked, reading),
        avoid_collisions=asked["avoid_collisions"],
        constraints=None if constraints.empty else constraints,
        allowed_time_s=_timeout_s(asked["timeout"], reading.parameters),
    )
    answer = required(await context.pool.ask(question, scene))
    solution = state_message(dict(answer.positions_rad[0]), context.robot.root_link, 0.0)
    notes = (*reading.warnings, deviation_note(answer.deviations[0]))
    return {"solution": solution, "error_code": success(*notes)}


async def compute_fk(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Tell where links are; the response of moveit_msgs/GetPositionFK.

    Without names every link is told. Poses are in the frame of the request's header.

    Raises:
        RefusedError: an unknown link or frame, or a state that cannot be.
    """
    _check_count(request["fk_link_names"], "fk_link_names")
    positions_rad = context.positions_rad(request["robot_state"], caller)
    names = request["fk_link_names"] or list(context.robot.links)
    frame_id = request["header"]["frame_id"] or context.robot.root_link
    frame = required(context.frames.resolve(frame_id, positions_rad))
    placed = context.forward.transforms(positions_rad)
    header = {"stamp": Stamp(0, 0).as_message(), "frame_id": frame_id}
    poses = []
    for name in names:
        if name not in placed:
            known = ", ".join(context.robot.links)
            raise refused(
                MoveItErrorCode.INVALID_LINK_NAME, f"the robot has no link {name!r}; it has: {known}", link=name
            )
        poses.append({"header": header, "pose": write_pose(seen_from(frame, pose_of(placed[name])))})
    return {"pose_stamped": poses, "fk_link_names": names, "error_code": success()}


def within_limits(robot: RobotModel, positions_rad: Mapping[str, float]) -> dict[str, float]:
    """The nearest state within the limits: a search may begin anywhere [rad]."""
    joints = robot.joints
    return {name: min(max(value, joints[name].lower), joints[name].upper) for name, value in positions_rad.items()}


def _ik_goal(asked: Message, reading: RequestContext) -> Goal:
    """The poses that are asked for."""
    links, poses = asked["ik_link_names"], asked["pose_stamped_vector"]
    _check_count(links, "ik_link_names")
    if len(poses) > 1 or len(links) > 1:
        if len(links) != len(poses):
            raise invalid(f"ik_link_names has {len(links)} entries and pose_stamped_vector {len(poses)}")
        return _several(links, poses, reading)
    link = asked["ik_link_name"] or (links[0] if links else "")
    pose = _pose(poses[0] if poses else asked["pose_stamped"], reading)
    return PoseGoal(
        reading.link(link),
        pose,
        LEAST_TOLERANCE_M,
        (LEAST_ORIENTATION_TOLERANCE_RAD,) * 3,
        strict=reading.chooses_orientation,
    )


def _check_count(links: Sequence[str], field: str) -> None:
    if len(links) > MAX_LINKS:
        raise invalid(f"{field} has {len(links)} entries, the limit is {MAX_LINKS}")


def _several(links: Sequence[str], poses: Sequence[Message], reading: RequestContext) -> ConstraintGoal:
    """Poses of several links at once: of an arm with few joints their positions alone."""
    placed = [(reading.link(link), _pose(pose, reading)) for link, pose in zip(links, poses, strict=True)]
    positions = tuple(PositionConstraint(link, pose, radius_m=LEAST_TOLERANCE_M) for link, pose in placed)
    if not reading.chooses_orientation:
        reading.warnings.append("the orientations of several links are not heeded")
        return ConstraintGoal(Constraints(positions=positions))
    turned = tuple(
        OrientationConstraint(link, pose.orientation, (LEAST_ORIENTATION_TOLERANCE_RAD,) * 3) for link, pose in placed
    )
    return ConstraintGoal(Constraints(positions=positions, orientations=turned))


def _pose(stamped: Message, reading: RequestContext) -> Pose:
    return reading.placed(stamped["header"]["frame_id"], stamped["pose"], "pose_stamped.pose")


def _timeout_s(duration: Message, parameters: MoveItParameters) -> float:
    timeout_s = duration["sec"] + duration["nanosec"] / NANOSECONDS_PER_S
    return min(timeout_s, MAX_KINEMATICS_TIMEOUT_S) if timeout_s > 0.0 else parameters.kinematics_solver_timeout


log = logging.getLogger("armbridge.moveit")

# moveit_msgs/ContactInformation's body types.
ROBOT_LINK, WORLD_OBJECT, ROBOT_ATTACHED = 0, 1, 2


async def check_state_validity(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Tell all that is wrong with a state; the response of moveit_msgs/GetStateValidity.

    Raises:
        RefusedError: a state, group or constraint that cannot be asked about.
    """
    group = context.group(request["group_name"])
    positions_rad = context.positions_rad(request["robot_state"], caller)
    scene = context.scene_of(request["robot_state"], positions_rad)
    reading = context.request_context(group, positions_rad)
    constraints = required(path_constraints_of(request["constraints"], reading, "constraints"))
    state = required(await context.pool.ask(StateQuestion(group.name, positions_rad), scene))
    results = [
        _result(required(await context.pool.ask(StateQuestion(group.name, positions_rad, one), scene)))
        for one in _singly(constraints)
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


def _singly(constraints: Constraints) -> Iterator[Constraints]:
    """Each constraint alone, in MoveIt's order of results."""
    yield from (Constraints(joints=(one,)) for one in constraints.joints)
    yield from (Constraints(positions=(one,)) for one in constraints.positions)
    yield from (Constraints(orientations=(one,)) for one in constraints.orientations)


def _result(answer: StateAnswer) -> dict[str, Any]:
    """The moveit_msgs/ConstraintEvalResult: how far beyond its tolerance a constraint is, 0 where it holds."""
    for problem in answer.problems:
        if problem.code is MoveItErrorCode.GOAL_CONSTRAINTS_VIOLATED:
            log.info("/check_state_validity: %s", problem.message)
            return {"result": False, "distance": _distance(problem.details)}
    return {"result": True, "distance": 0.0}


def _distance(details: Mapping[str, Any]) -> float:
    """By how much a constraint does not hold [m], [rad]."""
    if "beyond_m" in details or "beyond_rad" in details:
        return float(details.get("beyond_m", 0.0) or details.get("beyond_rad", 0.0))
    position = details["position_rad"]
    return float(max(details["lower_rad"] - position, position - details["upper_rad"], 0.0))


def _contact(pair: Mapping[str, Any], robot: RobotModel, scene: Scene) -> dict[str, Any]:
    held = {attached.object.name for attached in scene.attached}

    def body_type(name: str) -> int:
        if name in robot.links:
            return ROBOT_LINK
        return ROBOT_ATTACHED if name in held else WORLD_OBJECT

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

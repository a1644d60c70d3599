"""moveit_msgs/MotionPlanRequest and MotionSequenceRequest as problems for the planners."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planners.goals import Constraints, JointGoal, PoseGoal, PositionGoal
from planners.problem import (
    PLANNER_IDS,
    Arc,
    CartesianProblem,
    Line,
    MoveItErrorCode,
    PlanningFailure,
    PlanningProblem,
    planner_name,
)
from planners.scene import Point, Pose
from robot.model import RobotModel
from robot.trajectory import Vector
from server.errors import RefusedError
from server.moveit.parameters import MAX_ALLOWED_PLANNING_TIME_S, MAX_PLANNING_ATTEMPTS, MoveItParameters
from server.moveit.requests.constraints import goal_of, path_constraints_of
from server.moveit.requests.context import FrameResolver, Message, RequestContext, group_of
from server.moveit.requests.error_codes import invalid, refusals_as_data, refused, required

POINT_TO_POINT, STRAIGHT, CIRCULAR = "PTP", "LIN", "CIRC"

INTERIM, CENTER = "interim", "center"

# Unit vectors whose sum is shorter point in opposite directions: their mean says nothing.
OPPOSITE = 1e-6


def names_arc(constraints: Message) -> bool:
    """Whether a moveit_msgs/Constraints is the point of a circle."""
    return constraints["name"] in (INTERIM, CENTER)


def tip_problem(
    planner: str, problem: PlanningProblem, arc: Message, tip_speed: float, context: RequestContext
) -> CartesianProblem:
    """The path of the tip that a request for `STRAIGHT` or `CIRCULAR` asks for.

    Args:
        planner: which of them.
        problem: the same request as a motion between its ends.
        arc: the request's path constraints, which name a point of a circle.
        tip_speed: its ``max_cartesian_speed`` [m/s].
        context: what the request is read against.

    Raises:
        RefusedError: a goal that is no single pose, or a circle that is none.
    """
    link, end, tolerance_rad = _end(problem, context)
    segment = Line(end) if planner == STRAIGHT else Arc(_via_m(arc, link, end, context), end)
    return CartesianProblem(
        group=problem.group,
        start_rad=problem.start_rad,
        link=link,
        segments=(segment,),
        keep_orientation=tolerance_rad is not None,
        orientation_tolerance_rad=tolerance_rad or math.pi,
        tip_speed_m_s=tip_speed if tip_speed > 0.0 else None,
        velocity_scaling=problem.velocity_scaling,
        acceleration_scaling=problem.acceleration_scaling,
        allowed_time_s=problem.allowed_time_s,
        path_constraints=problem.path_constraints,
    )


def _end(problem: PlanningProblem, context: RequestContext) -> tuple[str, Pose, float | None]:
    """Link, end, and the rotation from the asked orientation that may be on the way; None for any [rad]."""
    match problem.goal:
        case PositionGoal(link, position_m, _, offset_m) if not any(offset_m):
            return link, Pose(position_m, _pose(link, problem.start_rad, context).orientation), None
        case PoseGoal() as goal:
            return goal.link, goal.pose, max(goal.orientation_tolerance_rad) if goal.strict else None
        case JointGoal(positions_rad):
            link = context.link("")
            return link, _pose(link, {**problem.start_rad, **positions_rad}, context), None
    raise invalid("goal_constraints must be one pose of one link, or joint positions, for a path of the tip")


def _pose(link: str, positions_rad: Mapping[str, float], context: RequestContext) -> Pose:
    return required(context.frames.resolve(link, positions_rad))


def _via_m(arc: Message, link: str, end: Pose, context: RequestContext) -> Point:
    """A point of the circle between its ends, in the robot's root link [m]."""
    if not names_arc(arc) or len(arc["position_constraints"]) != 1:
        raise invalid(
            f"path_constraints must have one position constraint, and the name {INTERIM!r} or {CENTER!r}, for"
            f" {CIRCULAR}"
        )
    constraint = arc["position_constraints"][0]
    poses = constraint["constraint_region"]["primitive_poses"]
    if not poses:
        raise invalid("path_constraints.position_constraints[0].constraint_region.primitive_poses is empty")
    where = "path_constraints.position_constraints[0].constraint_region.primitive_poses[0]"
    point = context.placed(constraint["header"]["frame_id"], poses[0], where).position_m
    if arc["name"] == INTERIM:
        return point
    start = np.array(_pose(link, context.start_rad, context).position_m)
    return _beyond_center(np.array(point), start, np.array(end.position_m))


def _beyond_center(center: Vector, start: Vector, end: Vector) -> Point:
    """The middle of the shorter arc around a point [m]."""
    to_start, to_end = start - center, end - center
    radius = float(np.linalg.norm(to_start))
    across = to_start + to_end
    length = float(np.linalg.norm(across))
    if radius == 0.0 or length <= OPPOSITE * radius:
        raise invalid("path_constraints: start and end are opposite each other: name a point on the way instead")
    x, y, z = (center + radius / length * across).tolist()
    return x, y, z


# MoveIt's names of the pipelines whose planners are here, the default first, each with its planners.
OMPL, PILZ = "ompl", "pilz_industrial_motion_planner"
PIPELINES: Mapping[str, tuple[str, ...]] = {OMPL: PLANNER_IDS, PILZ: (POINT_TO_POINT, STRAIGHT, CIRCULAR)}


@dataclass(frozen=True)
class PlanRequest:
    """A motion to plan, and what of the request is left out of account, a sentence each."""

    problem: PlanningProblem | CartesianProblem
    warnings: tuple[str, ...] = ()


@refusals_as_data
def problem_of(
    request: Message,
    start_rad: Mapping[str, float],
    frames: FrameResolver,
    robot: RobotModel,
    parameters: MoveItParameters,
) -> PlanRequest:
    """Read what is to be planned.

    Args:
        request: a moveit_msgs/MotionPlanRequest; its start state is read by
            :func:`server.moveit.requests.robot_state.start_positions`.
        start_rad: position of every movable joint at the start [rad].
        frames: where frames are.
        robot: the arm.
        parameters: what counts where the request says nothing.
    """
    pipeline = check_pipeline(request["pipeline_id"])
    group = group_of(robot, request["group_name"], parameters)
    context = RequestContext(robot, group, frames, start_rad, parameters)
    arc = request["path_constraints"]
    constraints = Constraints() if names_arc(arc) else required(path_constraints_of(arc, context))
    goal = goal_of(request["goal_constraints"], context)
    if isinstance(goal, PlanningFailure):
        raise RefusedError(goal)
    warnings = context.warnings
    problem = PlanningProblem(
        group=group.name,
        start_rad=start_rad,
        goal=goal,
        velocity_scaling=scaling(request, "max_velocity_scaling_factor", warnings),
        acceleration_scaling=scaling(request, "max_acceleration_scaling_factor", warnings),
        allowed_time_s=_allowed_time_s(request["allowed_planning_time"], parameters, warnings),
        attempts=_attempts(request["num_planning_attempts"], parameters, warnings),
        path_constraints=None if constraints.empty else constraints,
        planner_id=_planner_id(request["planner_id"], parameters, warnings) if pipeline == OMPL else "",
        optimization_time_s=parameters.optimization_time,
    )
    motion = _pilz_motion(request["planner_id"], warnings) if pipeline == PILZ else POINT_TO_POINT
    warnings += _ignored(request, motion)
    if motion == POINT_TO_POINT:
        return PlanRequest(problem, tuple(warnings))
    speed_m_s = request["max_cartesian_speed"]
    return PlanRequest(tip_problem(motion, problem, arc, speed_m_s, context), tuple(warnings))


def check_pipeline(pipeline_id: str) -> str:
    """The pipeline that is meant: the default one for none.

    Raises:
        RefusedError: there is no such pipeline.
    """
    pipeline = pipeline_id or OMPL
    if pipeline not in PIPELINES:
        raise refused(
            MoveItErrorCode.FAILURE,
            f"pipeline_id: there is no planning pipeline {pipeline_id!r}; there are: {', '.join(PIPELINES)}",
            pipeline_id=pipeline_id,
        )
    return pipeline


def scaling(request: Message, field: str, warnings: list[str]) -> float:
    """A share of the limits: 0, the message's default, is all of them, and so is more than 1.

    A negative one, which MoveIt takes as full speed too, is refused: it was not meant so.

    Args:
        request: the message that has it.
        field: its name there.
        warnings: gets a sentence when it is changed.

    Raises:
        RefusedError: it is negative or not a number.
    """
    value = float(request[field])
    if math.isnan(value) or value < 0.0:
        raise invalid(f"{field} must be from 0 to 1, 0 for full speed, not {value:g}", value=value)
    if value > 1.0:
        warnings.append(f"{field} {value:g} is taken as 1, the most there is")
    return min(value, 1.0) or 1.0


def _allowed_time_s(asked_s: float, parameters: MoveItParameters, warnings: list[str]) -> float:
    if math.isnan(asked_s):
        raise invalid("allowed_planning_time must be a number of seconds, not nan")
    if asked_s > MAX_ALLOWED_PLANNING_TIME_S:
        warnings.append(f"allowed_planning_time {asked_s:g} s is taken as {MAX_ALLOWED_PLANNING_TIME_S:g} s, the limit")
    return min(asked_s, MAX_ALLOWED_PLANNING_TIME_S) if asked_s > 0.0 else parameters.allowed_planning_time


def _attempts(asked: int, parameters: MoveItParameters, warnings: list[str]) -> int:
    if asked > MAX_PLANNING_ATTEMPTS:
        warnings.append(f"num_planning_attempts {asked} is taken as {MAX_PLANNING_ATTEMPTS}, the limit")
    return min(asked, MAX_PLANNING_ATTEMPTS) if asked > 0 else parameters.num_planning_attempts


def _planner_id(asked: str, parameters: MoveItParameters, warnings: list[str]) -> str:
    if not asked:
        return parameters.planner_id
    name = planner_name(asked)
    if name is None:
        instead = planner_name(parameters.planner_id)
        warnings.append(f"there is no planner {asked!r}: {instead} is used; there are: {', '.join(PLANNER_IDS)}")
        return parameters.planner_id
    return name


def _pilz_motion(asked: str, warnings: list[str]) -> str:
    name = asked.upper()
    if name in PIPELINES[PILZ]:
        return name
    if asked:
        warnings.append(
            f"there is no planner {asked!r}: {POINT_TO_POINT} is used; there are: {', '.join(PIPELINES[PILZ])}"
        )
    return POINT_TO_POINT


def _ignored(request: Message, motion: str) -> list[str]:
    """What is asked for and not heeded."""
    ignored = []
    if request["trajectory_constraints"]["constraints"]:
        ignored.append("trajectory_constraints is ignored")
    if request["reference_trajectories"]:
        ignored.append("reference_trajectories is ignored")
    if request["max_cartesian_speed"] > 0.0 and motion == POINT_TO_POINT:
        ignored.append("max_cartesian_speed is ignored: scale the velocity, or plan a path of the tip")
    return ignored


# Each item is planned on its own, in milliseconds mostly, in seconds at worst.
MAX_ITEMS = 50


@refusals_as_data
def requests_of(sequence: Message) -> list[Message]:
    """The moveit_msgs/MotionPlanRequest of a sequence's items, in their order.

    The arm comes to rest after each, so a blend radius is refused. Only the first item may say where it starts.

    Args:
        sequence: a moveit_msgs/MotionSequenceRequest.
    """
    items = sequence["items"]
    if not 1 <= len(items) <= MAX_ITEMS:
        raise _invalid(f"items has {len(items)} entries; 1 to {MAX_ITEMS} are allowed")
    for index, item in enumerate(items):
        if item["blend_radius"] != 0.0:
            raise _invalid(
                f"items[{index}].blend_radius must be 0 m, not {item['blend_radius']:g}: corners are not rounded, the"
                " arm comes to rest at the end of each item",
                index,
            )
        if index > 0 and item["req"]["start_state"]["joint_state"]["name"]:
            raise _invalid(
                f"items[{index}].req.start_state must be empty: the item begins where the one before ends", index
            )
    return [item["req"] for item in items]


def _invalid(message: str, index: int | None = None) -> Exception:
    details = {} if index is None else {"item": index}
    return refused(MoveItErrorCode.INVALID_MOTION_PLAN, message, **details)

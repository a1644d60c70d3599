"""Requests of MoveIt's clients as problems for the planners: the one place where problems are built.

A moveit_msgs/MotionPlanRequest names one of OMPL's planners or of Pilz's. Pilz's ``LIN`` and ``CIRC`` have the goal
of any request; the path constraint of ``CIRC`` is no constraint but names a point on the circle (``interim``) or
its center (``center``):
https://moveit.picknik.ai/main/doc/how_to_guides/pilz_industrial_motion_planner
"""

import functools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from planners.goals import AnyGoal, Constraints, JointGoal, PoseGoal, PositionGoal
from planners.problem import (
    PLANNER_IDS,
    Arc,
    CartesianProblem,
    IkQuestion,
    Line,
    MoveItErrorCode,
    PlanningProblem,
    planner_name,
)
from planners.scene import Point, Pose
from protocol.messages import ListLimits
from robot.description.model import Group, RobotModel
from server.errors import invalid, invalid_plan, refused
from server.execution.monitors import CurrentState
from server.execution.motions import Joints, MotionStep, Positions
from server.moveit.messages import Message, check_finite, composed
from server.moveit.parameters import (
    MAX_ALLOWED_PLANNING_TIME_S,
    MAX_KINEMATICS_TIMEOUT_S,
    MAX_PLANNING_ATTEMPTS,
    MoveItParameters,
    PlannerParameters,
)
from server.moveit.requests.constraints import (
    LEAST_ORIENTATION_TOLERANCE_RAD,
    LEAST_TOLERANCE_M,
    RequestContext,
    chooses_orientation,
    planning_group,
    read_goal,
    read_path_constraints,
)
from server.moveit.scene.frames import Frames
from server.moveit.trajectories import MAX_POINTS, read_seconds

AnyProblem = TypeVar("AnyProblem", bound=PlanningProblem | CartesianProblem | IkQuestion, covariant=True)

POINT_TO_POINT, STRAIGHT, CIRCULAR = "PTP", "LIN", "CIRC"

INTERIM, CENTER = "interim", "center"

# MoveIt's names of the pipelines whose planners are here, the default first, each with its planners.
OMPL, PILZ = "ompl", "pilz_industrial_motion_planner"
PIPELINES: Mapping[str, tuple[str, ...]] = {OMPL: PLANNER_IDS, PILZ: (POINT_TO_POINT, STRAIGHT, CIRCULAR)}

# Unit vectors with a shorter sum point in opposite directions, so that their mean has no direction.
OPPOSITE = 1e-6

# Each item is planned on its own, in milliseconds mostly, in seconds at worst.
MAX_ITEMS = 50

# A robot has a few dozen links, and each costs time of the planner that all clients share.
MAX_LINKS = 200


@dataclass(frozen=True)
class BuiltProblem(Generic[AnyProblem]):
    """Problem for the planners, and a sentence for each part of the request that it does not follow."""

    problem: AnyProblem
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class ProblemBuilder:
    """Builder of planning problems for one robot, at the present speed limit: a share of the velocity limits."""

    robot: RobotModel
    frames: Frames
    parameters: PlannerParameters
    current: CurrentState

    def group(self, name: str) -> Group:
        """Return a planning group; the configured one for an empty name."""
        return planning_group(self.robot, name, self.parameters.configured)

    def context(self, group: Group, start_rad: Positions, planner: str = "") -> RequestContext:
        return RequestContext(self.robot, group, self.frames, start_rad, self.parameters.of(group.name, planner))

    def goal_step(
        self, group: Group, goal: AnyGoal, parameters: MoveItParameters | None = None, frame: str | None = None
    ) -> Callable[[Positions], PlanningProblem]:
        """Return the step to a goal in the root link, or in a frame that may move with the arm.

        Parameters of its own take the place of the configured ones.
        """
        return functools.partial(self._goal, group, goal, parameters or self.parameters.configured, frame)

    def _goal(
        self, group: Group, goal: AnyGoal, parameters: MoveItParameters, frame: str | None, start_rad: Positions
    ) -> PlanningProblem:
        return PlanningProblem(
            group=group.name,
            start_rad=start_rad,
            goal=goal if frame is None else self.placed(goal, frame, start_rad),
            velocity_scaling=min(parameters.max_velocity_scaling, self.current.speed_limit(group.joints)),
            acceleration_scaling=parameters.max_acceleration_scaling,
            allowed_time_s=parameters.allowed_planning_time,
            attempts=parameters.num_planning_attempts,
            planner_id=parameters.planner_id,
            optimization_time_s=parameters.shortening_time_s(parameters.allowed_planning_time),
        )

    def request_step(self, request: Message, warnings: list[str] | None = None) -> MotionStep:
        """Return the step of a moveit_msgs/MotionPlanRequest; its warnings are added to a list."""

        def step(start_rad: Positions) -> PlanningProblem | CartesianProblem:
            built = self.motion_plan(request, start_rad)
            if warnings is not None:
                warnings.extend(built.warnings)
            return built.problem

        return step

    def motion_plan(self, request: Message, start_rad: Positions) -> BuiltProblem[PlanningProblem | CartesianProblem]:
        """Build the problem of a moveit_msgs/MotionPlanRequest; its start state is read before."""
        pipeline = check_pipeline(request["pipeline_id"])
        # Values that are no numbers are refused also in fields that have no effect, or not always one.
        tip_speed_m_s = _tip_speed_m_s(request)
        for corner in ("min_corner", "max_corner"):
            check_finite(request["workspace_parameters"][corner], f"workspace_parameters.{corner}")
        context = self.context(self.group(request["group_name"]), start_rad, request["planner_id"])
        parameters, warnings = context.parameters, context.warnings
        arc = request["path_constraints"]
        constraints = Constraints() if _names_arc(arc) else read_path_constraints(arc, context)
        velocity_scaling, acceleration_scaling = self._scalings(request, context)
        time, attempts = parameters.allowed_planning_time, parameters.num_planning_attempts
        allowed_time_s = _limited(request, "allowed_planning_time", MAX_ALLOWED_PLANNING_TIME_S, time, " s", warnings)
        problem = PlanningProblem(
            group=context.group.name,
            start_rad=start_rad,
            goal=read_goal(request["goal_constraints"], context),
            velocity_scaling=velocity_scaling,
            acceleration_scaling=acceleration_scaling,
            allowed_time_s=allowed_time_s,
            attempts=int(_limited(request, "num_planning_attempts", MAX_PLANNING_ATTEMPTS, attempts, "", warnings)),
            path_constraints=None if constraints.empty else constraints,
            planner_id=_planner_id(request["planner_id"], parameters, warnings) if pipeline == OMPL else "",
            optimization_time_s=parameters.shortening_time_s(allowed_time_s),
        )
        planner = _pilz_planner(request["planner_id"]) if pipeline == PILZ else POINT_TO_POINT
        warnings += _ignored_fields(request, tip_speed_m_s, planner)
        if planner == POINT_TO_POINT:
            return BuiltProblem(problem, tuple(warnings))
        tip = tip_problem(planner, problem, arc, tip_speed_m_s, context)
        return BuiltProblem(tip, tuple(warnings))

    def _scalings(self, request: Message, context: RequestContext) -> tuple[float, float]:
        """Read a request's shares of the velocity limits, lowered to the arm's speed limit, and of the others."""
        field, parameters = "max_velocity_scaling_factor", context.parameters
        velocity = _scaling(request, field, parameters.max_velocity_scaling, context)
        limit = self.current.speed_limit(context.group.joints)
        if velocity > limit and request[field] > 0.0:
            context.warnings.append(f"{field} {velocity:g} is lowered to {limit:g}, the arm's speed limit")
        acceleration = _scaling(
            request, "max_acceleration_scaling_factor", parameters.max_acceleration_scaling, context
        )
        return min(velocity, limit), acceleration

    def joints(self, requests: Iterable[Message]) -> Joints:
        """Return the joints of all groups of some moveit_msgs/MotionPlanRequest."""
        return frozenset().union(*(self.group(request["group_name"]).joints for request in requests))

    def placed(self, goal: AnyGoal, frame: str, start_rad: Positions) -> AnyGoal:
        """Return a pose or position goal in a frame, which may move with the arm, as a goal in the root link."""
        transform = self.frames.resolve(frame, start_rad)
        match goal:
            case PoseGoal():
                return replace(goal, pose=composed(transform, goal.pose))
            case PositionGoal():
                return replace(goal, position_m=composed(transform, Pose(goal.position_m)).position_m)
        raise AssertionError(f"a goal in a frame is {goal}")

    def cartesian_path(self, request: Message, start_rad: Positions) -> BuiltProblem[CartesianProblem]:
        """Build the problem of a moveit_msgs/GetCartesianPath request."""
        context = self.context(self.group(request["group_name"]), start_rad)
        max_step_m = request["max_step"]
        if not (math.isfinite(max_step_m) and max_step_m > 0.0):
            raise refused(MoveItErrorCode.FAILURE, f"max_step must be a finite number above 0 m, not {max_step_m:g}")
        frame = request["header"]["frame_id"]
        ends = [context.placed(frame, pose, f"waypoints[{i}]") for i, pose in enumerate(request["waypoints"])]
        constraints = read_path_constraints(request["path_constraints"], context)
        velocity_scaling, acceleration_scaling = self._scalings(request, context)
        link, tip_speed_m_s = context.link(request["link_name"]), _tip_speed_m_s(request)
        limited = request["cartesian_speed_limited_link"]
        if tip_speed_m_s is not None and limited not in ("", link):
            context.warnings.append(f"max_cartesian_speed is kept by the link that follows the path, not by {limited}")
        problem = CartesianProblem(
            group=context.group.name,
            start_rad=start_rad,
            link=link,
            segments=tuple(Line(end) for end in ends),
            keep_orientation=chooses_orientation(context.group),
            max_step_m=max_step_m,
            # As in MoveIt, a threshold below 0 is none; the planners refuse NaN.
            max_joint_step_rad=max(request["revolute_jump_threshold"], 0.0),
            tip_speed_m_s=tip_speed_m_s,
            avoid_collisions=request["avoid_collisions"],
            velocity_scaling=velocity_scaling,
            acceleration_scaling=acceleration_scaling,
            allowed_time_s=context.parameters.allowed_planning_time,
            path_constraints=None if constraints.empty else constraints,
        )
        return BuiltProblem(problem, tuple(context.warnings))

    def ik(self, request: Message, group: Group, seed_rad: Positions) -> BuiltProblem[IkQuestion]:
        context = self.context(group, seed_rad)
        constraints = read_path_constraints(request["constraints"], context, "ik_request.constraints")
        timeout_s = max(read_seconds(request["timeout"], "ik_request.timeout"), 0.0)
        question = IkQuestion(
            group=context.group.name,
            start_rad=seed_rad,
            goal=_ik_goal(request, context),
            avoid_collisions=request["avoid_collisions"],
            constraints=None if constraints.empty else constraints,
            allowed_time_s=min(timeout_s or context.parameters.kinematics_solver_timeout, MAX_KINEMATICS_TIMEOUT_S),
        )
        return BuiltProblem(question, tuple(context.warnings))


def sequence_requests(sequence: Message) -> list[Message]:
    """Return the moveit_msgs/MotionPlanRequest of a sequence's items, in their order.

    The arm comes to rest after each, so a blend radius is rejected. Only the first item may have a start state.
    """
    items = sequence["items"]
    if not 1 <= len(items) <= MAX_ITEMS:
        raise invalid_plan(f"items has {len(items)} entries; 1 to {MAX_ITEMS} are allowed")
    for index, item in enumerate(items):
        if item["blend_radius"] != 0.0:
            raise invalid_plan(
                f"items[{index}].blend_radius must be 0 m, not {item['blend_radius']:g}: corners are not rounded, the"
                " arm comes to rest at the end of each item",
                item=index,
            )
        if index > 0 and item["req"]["start_state"]["joint_state"]["name"]:
            raise invalid_plan(
                f"items[{index}].req.start_state must be empty: the item begins where the one before ends", item=index
            )
    return [item["req"] for item in items]


def check_pipeline(pipeline_id: str) -> str:
    """Return the planning pipeline of a name: the default one for an empty name."""
    pipeline = pipeline_id or OMPL
    if pipeline not in PIPELINES:
        raise refused(
            MoveItErrorCode.FAILURE,
            f"pipeline_id: there is no planning pipeline {pipeline_id!r}; there are: {', '.join(PIPELINES)}",
            pipeline_id=pipeline_id,
        )
    return pipeline


# With this factor a radian takes days; with far smaller ones a motion has no finite duration.
MIN_SCALING = 1e-6


def _scaling(request: Message, field: str, default: float, context: RequestContext) -> float:
    """Read a scaling factor of the limits: 0 is the configured one, a value above 1 full speed.

    MoveIt takes 0, the message's default, and a negative factor as full speed. A message that leaves the field out does
    not ask for full speed, and no client means it by a negative one, which is rejected.
    """
    value = float(request[field])
    if not (value == 0.0 or value >= MIN_SCALING):
        limits = f"must be from {MIN_SCALING:g} to 1, or 0 for the default of {default:g}"
        raise invalid(f"{field} {limits}, not {value:g}", value=value)
    if value > 1.0:
        context.warnings.append(f"{field} {value:g} is taken as 1, the most there is")
    return min(value, 1.0) or default


def tip_problem(
    planner: str, problem: PlanningProblem, arc: Message, tip_speed_m_s: float | None, context: RequestContext
) -> CartesianProblem:
    """Build the problem of a request for Pilz's ``LIN`` or ``CIRC``."""
    link, end, tolerance_rad = _tip_end(problem, context)
    segment = Line(end) if planner == STRAIGHT else Arc(_via_m(arc, link, end, context), end)
    return CartesianProblem(
        group=problem.group,
        start_rad=problem.start_rad,
        link=link,
        segments=(segment,),
        keep_orientation=tolerance_rad is not None,
        orientation_tolerance_rad=tolerance_rad or math.pi,
        tip_speed_m_s=tip_speed_m_s,
        velocity_scaling=problem.velocity_scaling,
        acceleration_scaling=problem.acceleration_scaling,
        allowed_time_s=problem.allowed_time_s,
        path_constraints=problem.path_constraints,
    )


def _tip_end(problem: PlanningProblem, context: RequestContext) -> tuple[str, Pose, float | None]:
    """Return link, end, and tolerance of the orientation on the way [rad], None for a free orientation."""
    match problem.goal:
        case PositionGoal(link, position_m, _, offset_m) if not any(offset_m):
            return link, Pose(position_m, context.frames.resolve(link, problem.start_rad).orientation), None
        case PoseGoal() as goal:
            return goal.link, goal.pose, max(goal.orientation_tolerance_rad) if goal.strict else None
        case JointGoal(positions_rad):
            link = context.link("")
            return link, context.frames.resolve(link, {**problem.start_rad, **positions_rad}), None
    raise invalid("goal_constraints must be one pose of one link, or joint positions, for a path of the tip")


def _via_m(arc: Message, link: str, end: Pose, context: RequestContext) -> Point:
    if not _names_arc(arc) or len(arc["position_constraints"]) != 1:
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
    start = np.array(context.frames.resolve(link, context.start_rad).position_m)
    # The middle of the shorter arc around the center [m].
    center = np.array(point)
    to_start, to_end = start - center, np.array(end.position_m) - center
    radius = float(np.linalg.norm(to_start))
    across = to_start + to_end
    length = float(np.linalg.norm(across))
    if radius == 0.0 or length <= OPPOSITE * radius:
        raise invalid("path_constraints: start and end are opposite each other: name a point on the way instead")
    x, y, z = (center + radius / length * across).tolist()
    return x, y, z


def _names_arc(constraints: Message) -> bool:
    return constraints["name"] in (INTERIM, CENTER)


def _limited(request: Message, field: str, most: float, configured: float, unit: str, warnings: list[str]) -> float:
    """Read a number that is limited; 0 is the configured one."""
    value = request[field]
    if math.isnan(value) or value < 0:
        raise invalid(f"{field} must be 0{unit} or more, 0 for the configured one, not {value:g}")
    if value > most:
        warnings.append(f"{field} {value:g}{unit} is taken as {most:g}{unit}, the limit")
    return min(value, most) if value > 0 else configured


def _planner_id(requested: str, parameters: MoveItParameters, warnings: list[str]) -> str:
    if not requested:
        return parameters.planner_id
    name = planner_name(requested)
    if name is None:
        instead = planner_name(parameters.planner_id)
        warnings.append(f"there is no planner {requested!r}: {instead} is used; there are: {', '.join(PLANNER_IDS)}")
        return parameters.planner_id
    return name


def _pilz_planner(requested: str) -> str:
    """Return one of Pilz's planners; MoveIt fails likewise for another one (planning_pipeline.cpp)."""
    name = requested.upper() or POINT_TO_POINT
    if name not in PIPELINES[PILZ]:
        problem = f"planner_id: {PILZ} has no planner {requested!r} here; there are: {', '.join(PIPELINES[PILZ])}"
        raise refused(MoveItErrorCode.PLANNING_FAILED, problem, planner_id=requested)
    return name


def _ignored_fields(request: Message, tip_speed_m_s: float | None, planner: str) -> list[str]:
    ignored = []
    if request["trajectory_constraints"]["constraints"]:
        ignored.append("trajectory_constraints is ignored")
    if request["reference_trajectories"]:
        ignored.append("reference_trajectories is ignored")
    if tip_speed_m_s is not None and planner == POINT_TO_POINT:
        ignored.append("max_cartesian_speed is ignored: scale the velocity, or plan a path of the tip")
    return ignored


def _tip_speed_m_s(request: Message) -> float | None:
    """Read the greatest speed of the tip [m/s]; None for as fast as the joints allow."""
    value = float(request["max_cartesian_speed"])
    if math.isnan(value):
        raise invalid("max_cartesian_speed must be a number, not nan")
    return value if value > 0.0 else None


def _ik_goal(request: Message, context: RequestContext) -> PoseGoal:
    links, poses = request["ik_link_names"], request["pose_stamped_vector"]
    if len(poses) > 1 or len(links) > 1:
        raise invalid(
            f"ik_link_names and pose_stamped_vector must have one entry at most, not {len(links)} and {len(poses)}: for"
            " several links at once, plan to a position constraint of each"
        )
    link = request["ik_link_name"] or (links[0] if links else "")
    stamped = poses[0] if poses else request["pose_stamped"]
    return PoseGoal(
        context.link(link),
        context.placed(stamped["header"]["frame_id"], stamped["pose"], "pose_stamped.pose"),
        LEAST_TOLERANCE_M,
        (LEAST_ORIENTATION_TOLERANCE_RAD,) * 3,
        strict=chooses_orientation(context.group),
    )


# Of all motions of a sequence together: for each item of the longest one, two constraints on poses and ten on joints.
MAX_POSE_CONSTRAINTS = 2 * MAX_ITEMS
MAX_JOINT_CONSTRAINTS = 10 * MAX_ITEMS

# Of attached objects, which come with every request of some clients. A tool's mesh for collisions has some thousands.
MAX_ATTACHED_TRIANGLES = 10_000

# Longer paths are planned in parts; this one takes the planners a second.
MAX_WAYPOINTS = 1_000

_POSE_LISTS = (
    "Constraints.position_constraints",
    "Constraints.orientation_constraints",
    "Constraints.visibility_constraints",
    "BoundingVolume.primitives",
    "BoundingVolume.primitive_poses",
    "BoundingVolume.meshes",
    "BoundingVolume.mesh_poses",
    "MotionPlanRequest.goal_constraints",
    "PositionIKRequest.pose_stamped_vector",
)

PLANNING_LIMITS = ListLimits(
    {
        **{f"moveit_msgs/msg/{name}": MAX_POSE_CONSTRAINTS for name in _POSE_LISTS},
        "moveit_msgs/msg/Constraints.joint_constraints": MAX_JOINT_CONSTRAINTS,
        "moveit_msgs/msg/MotionSequenceRequest.items": MAX_ITEMS,
        "moveit_msgs/msg/PositionIKRequest.ik_link_names": MAX_LINKS,
        "moveit_msgs/srv/GetCartesianPath_Request.waypoints": MAX_WAYPOINTS,
        "moveit_msgs/srv/GetPositionFK_Request.fk_link_names": MAX_LINKS,
        "shape_msgs/msg/Mesh.triangles": MAX_ATTACHED_TRIANGLES,
        "shape_msgs/msg/Mesh.vertices": 3 * MAX_ATTACHED_TRIANGLES,
    }
)

# Positions, velocities and accelerations of eight joints.
TRAJECTORY_LIMITS = ListLimits({"trajectory_msgs/msg/JointTrajectory.points": MAX_POINTS}, 24 * MAX_POINTS)

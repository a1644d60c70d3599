"""moveit_msgs/MotionPlanRequest as a problem for the planners."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from planners.goals import Constraints
from planners.problem import (
    PLANNER_IDS,
    CartesianProblem,
    MoveItErrorCode,
    PlanningFailure,
    PlanningProblem,
    planner_name,
)
from robot.description.model import RobotModel
from server.errors import RefusedError
from server.moveit.parameters import MAX_ALLOWED_PLANNING_TIME_S, MAX_PLANNING_ATTEMPTS, MoveItParameters
from server.moveit.requests.constraints import goal_of, path_constraints_of
from server.moveit.requests.context import FrameResolver, Message, RequestContext, group_of
from server.moveit.requests.refusals import invalid, refusals_as_data, refused, required
from server.moveit.requests.tip_motions import CIRCULAR, POINT_TO_POINT, STRAIGHT, names_arc, tip_problem

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

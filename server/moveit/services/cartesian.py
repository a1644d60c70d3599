"""``/compute_cartesian_path``: the tip along straight lines, as far as it goes."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any

from planners.problem import CartesianPlan, CartesianProblem, Line, MoveItErrorCode, PlanningFailure
from planners.scene import Scene
from server.execution.current_state import state_message
from server.graph.node import Node
from server.moveit.poses import pose_of
from server.moveit.requests.codes import deviation_note, failure_code, success
from server.moveit.requests.constraints import path_constraints_of
from server.moveit.requests.context import Message, RequestContext
from server.moveit.requests.motion_plan import scaling
from server.moveit.requests.refusals import refused, required
from server.moveit.requests.trajectories import to_message
from server.moveit.services.cut_path import cut_lines, length_m
from server.moveit.services.jumps import Jump, Thresholds, first_jump
from server.moveit.services.planning_context import PlanningContext

# MoveIt's clients take a path for the whole from here on.
WHOLE_FRACTION = 0.99


async def compute_cartesian_path(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Plan a path of the tip through waypoints; the response of moveit_msgs/GetCartesianPath.

    A path that can be followed in part only is answered with that part, its fraction, and the code of what is in the
    way.

    Raises:
        RefusedError: no path is asked for, or none can be begun.
    """
    situation = context.situation(request["start_state"], caller)
    group = context.group(request["group_name"])
    reading = context.request_context(group, situation.start_rad)
    problem, thresholds = _problem(request, reading), _thresholds(request)
    plan = required(await context.pool.ask(problem, situation.scene))
    if thresholds.any:
        plan = await _without_jumps(plan, problem, thresholds, situation.scene, context)
    context.display.planned((plan.trajectory,), situation.start_rad)
    if plan.stopped_by is not None:
        context.display.contacts_of(plan.stopped_by.details)
    root = context.robot.root_link
    return {
        "start_state": state_message(dict(situation.start_rad), root, 0.0),
        "solution": to_message(plan.trajectory, root),
        "fraction": plan.fraction,
        "error_code": _code(plan, (*situation.warnings, *reading.warnings)),
    }


def _code(plan: CartesianPlan, notes: tuple[str, ...]) -> dict[str, Any]:
    if plan.stopped_by is not None and plan.fraction < WHOLE_FRACTION:
        return failure_code(plan.stopped_by)
    why = "" if plan.stopped_by is None else plan.stopped_by.message
    return success(*notes, why, deviation_note(plan.deviation))


def _problem(request: Message, reading: RequestContext) -> CartesianProblem:
    if not (math.isfinite(request["max_step"]) and request["max_step"] > 0.0):
        raise refused(
            MoveItErrorCode.FAILURE, f"max_step must be a finite number above 0 m, not {request['max_step']:g}"
        )
    frame = request["header"]["frame_id"]
    ends = [reading.placed(frame, pose, f"waypoints[{index}]") for index, pose in enumerate(request["waypoints"])]
    constraints = required(path_constraints_of(request["path_constraints"], reading))
    return CartesianProblem(
        group=reading.group.name,
        start_rad=reading.start_rad,
        link=reading.link(request["link_name"]),
        segments=tuple(Line(end) for end in ends),
        keep_orientation=reading.chooses_orientation,
        max_step_m=request["max_step"],
        tip_speed_m_s=_tip_speed_m_s(request, reading),
        avoid_collisions=request["avoid_collisions"],
        velocity_scaling=scaling(request, "max_velocity_scaling_factor", reading.warnings),
        acceleration_scaling=scaling(request, "max_acceleration_scaling_factor", reading.warnings),
        allowed_time_s=reading.parameters.allowed_planning_time,
        path_constraints=None if constraints.empty else constraints,
    )


async def _without_jumps(
    plan: CartesianPlan, problem: CartesianProblem, thresholds: Thresholds, scene: Scene, context: PlanningContext
) -> CartesianPlan:
    """The part of a path before its first jump, or the plan as it is.

    Raises:
        RefusedError: the part cannot be planned on its own.
    """
    tip = context.forward, problem.link
    jump = first_jump(plan.trajectory, tip, problem.start_rad, problem.max_step_m, thresholds)
    if jump is None:
        return plan
    start = pose_of(context.forward.transforms(problem.start_rad)[problem.link])
    lines = [segment for segment in problem.segments if isinstance(segment, Line)]
    whole_m = length_m(start, lines)
    part = replace(problem, segments=cut_lines(start, lines, jump.along_m))
    plan = required(await context.pool.ask(part, scene))
    # The part may in turn end before its end, but not after.
    stopped_by = plan.stopped_by or _stopped_by(jump, problem.max_step_m, whole_m)
    return replace(plan, fraction=plan.fraction * jump.along_m / whole_m, stopped_by=stopped_by)


def _stopped_by(jump: Jump, step_m: float, whole_m: float) -> PlanningFailure:
    return PlanningFailure(
        MoveItErrorCode.PLANNING_FAILED,
        f"the path can be followed for {100.0 * jump.along_m:.1f} of {100.0 * whole_m:.1f} cm: joint {jump.joint!r}"
        f" would jump by {jump.step_rad:.3g} rad in the next step of {1000.0 * step_m:g} mm"
        f" (threshold {jump.limit_rad:.3g} rad)",
        asdict(jump),
    )


def _thresholds(request: Message) -> Thresholds:
    return Thresholds(_threshold(request, "revolute_jump_threshold"), _threshold(request, "jump_threshold"))


def _threshold(request: Message, field: str) -> float:
    """A threshold, 0 for none; below 0 counts as none, as with MoveIt."""
    value = float(request[field])
    if not math.isfinite(value):
        raise refused(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, f"{field} must be a finite number, not {value}")
    return max(0.0, value)


def _tip_speed_m_s(request: Message, reading: RequestContext) -> float | None:
    """The greatest speed of the tip; None for as fast as the joints allow."""
    value, link = float(request["max_cartesian_speed"]), request["cartesian_speed_limited_link"]
    if math.isnan(value):
        raise refused(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "max_cartesian_speed must be a number, not nan")
    if value <= 0.0:
        return None
    if link and link != reading.link(request["link_name"]):
        reading.warnings.append(f"max_cartesian_speed is kept by the link that follows the path, not by {link}")
    return value

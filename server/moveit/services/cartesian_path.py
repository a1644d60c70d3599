"""``/compute_cartesian_path``: the tip along straight lines, as far as it goes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from planners.problem import CartesianPlan, CartesianProblem, Line, MoveItErrorCode, PlanningFailure
from planners.scene import Pose, Scene
from robot.forward import ForwardPlacements
from robot.trajectory import Trajectory, Vector
from server.moveit.current_state import state_message
from server.moveit.poses import pose_of
from server.moveit.requests.constraints import path_constraints_of
from server.moveit.requests.context import Message, RequestContext
from server.moveit.requests.error_codes import deviation_note, failure_code, refused, required, success
from server.moveit.requests.motion_plan import scaling
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.requests.trajectories import to_message
from server.node import Node

# Steps up to this exceed no factor: a flip of an elbow or a wrist goes further at once, and where a path begins, five
# joints that turn towards the orientation they are asked for move far above the mean.
LEAST_JUMP_RAD = 1.0

# Where the tip is looked at on the way: often enough that it moves by less than a usual step in between.
SAMPLE_S = 0.02

# Placing the links takes some 0.1 ms; a slow path is looked at more coarsely in time.
MAX_SAMPLES = 500


@dataclass(frozen=True)
class Thresholds:
    """What a step is a jump from.

    Attributes:
        step_rad: of any joint; 0 for none [rad].
        factor: times the mean of the steps; 0 for none.
    """

    step_rad: float
    factor: float

    @property
    def any(self) -> bool:
        """Whether there is one."""
        return self.step_rad > 0.0 or self.factor > 0.0

    def limit_rad(self, steps_rad: Vector) -> float:
        """The greatest step that is none, for the greatest step of any joint at each place, shape (steps,) [rad]."""
        limits = [np.inf]
        if self.step_rad > 0.0:
            limits.append(self.step_rad)
        if self.factor > 0.0:
            limits.append(max(self.factor * float(np.mean(steps_rad)), LEAST_JUMP_RAD))
        return min(limits)


@dataclass(frozen=True)
class Jump:
    """The first step that is too great.

    Attributes:
        along_m: length of the tip's path before it [m].
        joint: which joint.
        step_rad: how far it goes [rad].
        limit_rad: how far it may [rad].
    """

    along_m: float
    joint: str
    step_rad: float
    limit_rad: float


def first_jump(
    motion: Trajectory,
    tip: tuple[ForwardPlacements, str],
    others_rad: Mapping[str, float],
    step_m: float,
    thresholds: Thresholds,
) -> Jump | None:
    """The first jump on a path; None for none.

    Args:
        motion: the motion along the path.
        tip: places the links; the one that follows the path.
        others_rad: position of every joint; that of the motion's does not count [rad].
        step_m: length of a step of the tip [m].
        thresholds: what a jump is.
    """
    configurations = _sampled(motion)
    along_m = _along_m(configurations, motion.joint_names, tip, others_rad)
    places_m = np.append(np.arange(0.0, along_m[-1], step_m), along_m[-1])
    at = np.column_stack([np.interp(places_m, along_m, column) for column in configurations.T])
    steps = np.abs(np.diff(at, axis=0))
    greatest = steps.max(axis=1, initial=0.0)
    if not greatest.size:
        return None
    limit_rad = thresholds.limit_rad(greatest)
    beyond = np.flatnonzero(greatest > limit_rad)
    if not beyond.size:
        return None
    first = int(beyond[0])
    joint = int(np.argmax(steps[first]))
    return Jump(float(places_m[first]), motion.joint_names[joint], float(steps[first, joint]), limit_rad)


def _sampled(motion: Trajectory) -> Vector:
    """Configurations on the way, shape (n, joints) [rad]."""
    count = min(max(2, int(np.ceil(motion.duration_s / SAMPLE_S)) + 1), MAX_SAMPLES)
    return np.array([motion.sample(float(time_s))[0] for time_s in np.linspace(0.0, motion.duration_s, count)])


def _along_m(
    configurations: Vector,
    joint_names: tuple[str, ...],
    tip: tuple[ForwardPlacements, str],
    others_rad: Mapping[str, float],
) -> Vector:
    """Length of the tip's path up to each configuration, shape (n,) [m]."""
    forward, link = tip
    positions = [{**others_rad, **dict(zip(joint_names, q, strict=True))} for q in configurations.tolist()]
    places_m = np.array([forward.transforms(one)[link][:3, 3] for one in positions])
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(places_m, axis=0), axis=1))))


# Quaternions so nearly alike that the arc between them has no direction.
ALIKE = 1.0 - 1e-9


def length_m(start: Pose, lines: Sequence[Line]) -> float:
    """Length of a path of straight lines [m]."""
    points = np.array([start.position_m, *(line.end.position_m for line in lines)])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def cut_lines(start: Pose, lines: Sequence[Line], along_m: float) -> tuple[Line, ...]:
    """The lines up to a length, the last of them shortened.

    Args:
        start: where the first one begins.
        lines: the path.
        along_m: how much of it is wanted [m].
    """
    kept: list[Line] = []
    before, left_m = start, along_m
    for line in lines:
        this_m = length_m(before, [line])
        if left_m <= this_m:
            share = left_m / this_m if this_m > 0.0 else 1.0
            return (*kept, Line(_between(before, line.end, share)))
        kept.append(line)
        before, left_m = line.end, left_m - this_m
    return tuple(kept)


def _between(first: Pose, second: Pose, share: float) -> Pose:
    a, b = np.array(first.position_m), np.array(second.position_m)
    x, y, z = (a + share * (b - a)).tolist()
    turned = _slerp(np.array(first.orientation), np.array(second.orientation), share)
    qx, qy, qz, qw = turned.tolist()
    return Pose((x, y, z), (qx, qy, qz, qw))


def _slerp(first: Vector, second: Vector, share: float) -> Vector:
    """The unit quaternion between two others, on the shorter arc."""
    cosine = float(first @ second)
    if cosine < 0.0:
        second, cosine = -second, -cosine
    if cosine > ALIKE:
        return second
    angle = float(np.arccos(cosine))
    turned: Vector = (np.sin((1.0 - share) * angle) * first + np.sin(share * angle) * second) / np.sin(angle)
    return turned


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

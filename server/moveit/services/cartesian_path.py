"""``/compute_cartesian_path``: paths of the tip along straight lines.

MoveIt's jump thresholds bound the motion of the joints between points a step apart. The planners' paths have no gaps,
so a jump found here is no flip between two points but a place where joints race, as near a singularity.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from planners.problem import CartesianPlan, CartesianProblem, Line, MoveItErrorCode, PlanningFailure
from planners.scene import Pose, Scene
from robot.description.forward_kinematics import ForwardPlacements
from robot.trajectory import Trajectory
from server.errors import invalid, required
from server.execution.monitors import state_message
from server.execution.motions import deviation_note
from server.graph.permissions import Node
from server.moveit.messages import Message, pose_of, success
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.trajectories import to_messages

# Steps up to this exceed no factor: a flip of an elbow or a wrist is larger, and at the start of a path five joints
# that turn towards the requested orientation move far more than the mean.
LEAST_JUMP_RAD = 1.0

# Between samples the tip moves less than a usual step.
SAMPLE_S = 0.02

# Forward kinematics take some 0.1 ms; a slow path is sampled less often.
MAX_SAMPLES = 500

# A waypoint in a frame takes 50 us to read.
MAX_WAYPOINTS_AT_ONCE = 50


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
    thresholds = _threshold(request, "revolute_jump_threshold"), _threshold(request, "jump_threshold")
    plan = required(await context.pool.ask(built.problem, start.scene))
    if any(thresholds):
        plan = await _without_jumps(plan, built.problem, thresholds, start.scene, context)
    root = context.robot.root_link
    start_state = state_message(dict(start.start_rad), root, 0.0)
    [solution] = await to_messages([plan.trajectory], root)
    context.display.trajectories([solution], start_state)
    if plan.stopped_by is not None:
        context.display.contacts_of(plan.stopped_by.details)
    return {
        "start_state": start_state,
        "solution": solution,
        "fraction": plan.fraction,
        "error_code": success(
            *start.warnings,
            *built.warnings,
            "" if plan.stopped_by is None else plan.stopped_by.message,
            deviation_note(plan.deviation),
        ),
    }


async def _without_jumps(
    plan: CartesianPlan, problem: CartesianProblem, thresholds: Thresholds, scene: Scene, context: PlanningContext
) -> CartesianPlan:
    """Return the plan of the part before the first jump; the same plan if there is no jump."""
    tip = context.forward, problem.link
    # Up to half a second of forward kinematics on a slow machine.
    jump = await asyncio.to_thread(first_jump, plan.trajectory, tip, problem.start_rad, problem.max_step_m, thresholds)
    if jump is None:
        return plan
    start = pose_of(context.forward.transforms(problem.start_rad)[problem.link])
    lines = [segment for segment in problem.segments if isinstance(segment, Line)]
    whole_m = length_m(start, lines)
    part = replace(problem, segments=await asyncio.to_thread(cut_lines, start, lines, jump.along_m))
    plan = required(await context.pool.ask(part, scene))
    # The part itself may be followed only partly.
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


def _threshold(request: Message, field: str) -> float:
    """Read a threshold, 0 for none; as in MoveIt, one below 0 is none."""
    value = float(request[field])
    if not math.isfinite(value):
        raise invalid(f"{field} must be a finite number, not {value}")
    return max(0.0, value)


# Greatest step of any joint [rad], and greatest multiple of the mean step, that are no jumps; 0 for none.
Thresholds: TypeAlias = tuple[float, float]


@dataclass(frozen=True)
class Jump:
    """First step beyond the thresholds."""

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
    """Find the first jump on a path; None if there is none."""
    count = min(max(2, int(np.ceil(motion.duration_s / SAMPLE_S)) + 1), MAX_SAMPLES)
    configurations = np.array([motion.sample(time_s)[0] for time_s in np.linspace(0.0, motion.duration_s, count)])
    # Length of the tip's path up to each configuration, shape (count,) [m].
    forward, link = tip
    positions = [{**others_rad, **dict(zip(motion.joint_names, q, strict=True))} for q in configurations.tolist()]
    tip_m = np.array([forward.transforms(each)[link][:3, 3] for each in positions])
    along_m = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(tip_m, axis=0), axis=1))))
    places_m = np.append(np.arange(0.0, along_m[-1], step_m), along_m[-1])
    at = np.column_stack([np.interp(places_m, along_m, column) for column in configurations.T])
    steps = np.abs(np.diff(at, axis=0))
    greatest = steps.max(axis=1, initial=0.0)
    if not greatest.size:
        return None
    step_rad, factor = thresholds
    by_mean_rad = max(factor * float(np.mean(greatest)), LEAST_JUMP_RAD) if factor else math.inf
    limit_rad = min(step_rad or math.inf, by_mean_rad)
    beyond = np.flatnonzero(greatest > limit_rad)
    if not beyond.size:
        return None
    first = int(beyond[0])
    joint = int(np.argmax(steps[first]))
    return Jump(float(places_m[first]), motion.joint_names[joint], float(steps[first, joint]), limit_rad)


def length_m(start: Pose, lines: Sequence[Line]) -> float:
    points = np.array([start.position_m, *(line.end.position_m for line in lines)])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def cut_lines(start: Pose, lines: Sequence[Line], along_m: float) -> tuple[Line, ...]:
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
    # Imported when a path is cut: few servers need it, and it takes a tenth of a second.
    from scipy.spatial.transform import Rotation, Slerp

    a, b = np.array(first.position_m), np.array(second.position_m)
    x, y, z = (a + share * (b - a)).tolist()
    qx, qy, qz, qw = Slerp([0.0, 1.0], Rotation.from_quat([first.orientation, second.orientation]))(share).as_quat()
    return Pose((x, y, z), (qx, qy, qz, qw))

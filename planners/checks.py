"""Checks of requests before any search: each failure has the code that is true of the case, with its figures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from planners.geometry.collision import CollidingPair
from planners.goals import (
    AnyOf,
    AxisGoal,
    ConstraintGoal,
    Constraints,
    Goal,
    JointConstraint,
    JointGoal,
    OrientationConstraint,
    PoseGoal,
    PositionConstraint,
    PositionGoal,
    SingleGoal,
)
from planners.ik.kinematics import MAX_POINTS
from planners.problem import (
    PLANNER_IDS,
    CartesianProblem,
    IkQuestion,
    MoveItErrorCode,
    PlanningFailure,
    PlanningProblem,
    StateQuestion,
    planner_name,
)
from robot.description.model import Group, RobotModel

# Quaternions and directions from single precision are off by less; longer and shorter ones are mistakes.
LENGTH_TOLERANCE = 1e-3

MAX_ALTERNATIVES = 64  # each alternative takes milliseconds to solve
MAX_CONSTRAINTS = 64  # each constraint is checked in every configuration of a search


def check_goal(robot: RobotModel, group: Group, goal: Goal) -> PlanningFailure | None:
    """Names and numbers of a goal, of every alternative if there are several."""
    if not isinstance(goal, AnyOf):
        return next(_goal_flaws(robot, group, goal), None)
    if not 0 < len(goal.goals) <= MAX_ALTERNATIVES:
        return invalid_goal(
            f"a goal has 1 to {MAX_ALTERNATIVES} alternatives, not {len(goal.goals)}", count=len(goal.goals)
        )
    return next((flaw for single in goal.goals for flaw in _goal_flaws(robot, group, single)), None)


def check_constraints(robot: RobotModel, constraints: Constraints | None) -> PlanningFailure | None:
    """Names and numbers of constraints."""
    return None if constraints is None else next(_constraint_flaws(robot, constraints), None)


def invalid_goal(message: str, **details: str | float) -> PlanningFailure:
    """Return the failure of an invalid goal."""
    return PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, details)


def in_words(point: Sequence[float]) -> str:
    """A point or direction as text."""
    return "(" + ", ".join(f"{value:.4g}" for value in point) + ")"


def _goal_flaws(robot: RobotModel, group: Group, goal: SingleGoal) -> Iterator[PlanningFailure]:
    if isinstance(goal, JointGoal):
        yield from _joint_goal_flaws(robot, group, goal)
        return
    if isinstance(goal, ConstraintGoal):
        if goal.constraints.empty:
            yield invalid_goal("the goal has no constraint")
        yield from _constraint_flaws(robot, goal.constraints)
        return
    yield from _link_flaws(robot, goal.link)
    yield from point_flaws(goal.position_m, "goal position", "m")
    yield from _tolerance_flaws("position", goal.tolerance_m, "m")
    match goal:
        case PositionGoal():
            yield from point_flaws(goal.offset_m, "offset of the point", "m")
        case AxisGoal():
            yield from length_flaws(goal.axis, "axis")
            yield from length_flaws(goal.direction, "direction")
            yield from _tolerance_flaws("axis", goal.axis_tolerance_rad, "rad")
        case PoseGoal():
            yield from length_flaws(goal.pose.orientation, "orientation")
            for tolerance_rad in goal.orientation_tolerance_rad:
                yield from _tolerance_flaws("orientation", tolerance_rad, "rad")


def _joint_goal_flaws(robot: RobotModel, group: Group, goal: JointGoal) -> Iterator[PlanningFailure]:
    if not (math.isfinite(goal.tolerance_rad) and goal.tolerance_rad >= 0.0):
        yield invalid_goal(f"the joint tolerance must be a finite number of 0 rad or more, not {goal.tolerance_rad:g}")
    for name, value in goal.positions_rad.items():
        if name not in group.joints:
            known = ", ".join(group.joints)
            yield invalid_goal(f"group {group.name!r} has no joint {name!r}; it has: {known}", joint=name)
            return
        if not math.isfinite(value):
            yield invalid_goal(f"the goal of joint {name!r} is {value}, not a finite number", joint=name)
        joint = robot.joints[name]
        if not joint.lower - goal.tolerance_rad <= value <= joint.upper + goal.tolerance_rad:
            yield _beyond_limits(f"the goal of joint {name!r}, {value:.4g} {joint.unit}, is", robot, name, value)


def _constraint_flaws(robot: RobotModel, constraints: Constraints) -> Iterator[PlanningFailure]:
    every: tuple[JointConstraint | PositionConstraint | OrientationConstraint, ...]
    every = (*constraints.joints, *constraints.positions, *constraints.orientations)
    if len(every) > MAX_CONSTRAINTS:
        yield invalid_goal(f"there may be {MAX_CONSTRAINTS} constraints, not {len(every)}", count=len(every))
    if len(constraints.positions) > MAX_POINTS:
        count = len(constraints.positions)
        yield invalid_goal(f"there may be {MAX_POINTS} position constraints, not {count}", count=count)
    for constraint in every:
        if not (math.isfinite(constraint.weight) and constraint.weight >= 0.0):
            yield invalid_goal(
                f"the weight of a constraint must be a finite number of 0 or more, not {constraint.weight:g}"
            )
    for joint in constraints.joints:
        yield from _joint_constraint_flaws(robot, joint)
    yield from _contradictions(constraints.joints)
    for position in constraints.positions:
        yield from _position_constraint_flaws(robot, position)
    for orientation in constraints.orientations:
        yield from _link_flaws(robot, orientation.link)
        yield from length_flaws(orientation.orientation, "orientation")
        for tolerance_rad in orientation.tolerance_rad:
            yield from _tolerance_flaws("orientation", tolerance_rad, "rad")


def _joint_constraint_flaws(robot: RobotModel, constraint: JointConstraint) -> Iterator[PlanningFailure]:
    name, value = constraint.joint, constraint.position_rad
    if name not in robot.joints or not robot.joints[name].movable:
        known = ", ".join(joint.name for joint in robot.movable_joints)
        yield invalid_goal(
            f"a constraint names the joint {name!r}, which does not exist; there are: {known}", joint=name
        )
        return
    if not math.isfinite(value):
        yield invalid_goal(f"the constraint on joint {name!r} is at {value}, not a finite number", joint=name)
    yield from _tolerance_flaws(f"upper {name}", constraint.above_rad, "rad", least=0.0)
    yield from _tolerance_flaws(f"lower {name}", constraint.below_rad, "rad", least=0.0)
    joint = robot.joints[name]
    if value - constraint.below_rad > joint.upper or value + constraint.above_rad < joint.lower:
        yield _beyond_limits(
            f"the range of the constraint on joint {name!r} around {value:.4g} rad is", robot, name, value
        )


def _contradictions(constraints: Sequence[JointConstraint]) -> Iterator[PlanningFailure]:
    """Ranges of one joint that have nothing in common."""
    ranges: dict[str, tuple[float, float]] = {}
    for constraint in constraints:
        lower, upper = ranges.get(constraint.joint, (-math.inf, math.inf))
        lower = max(lower, constraint.position_rad - constraint.below_rad)
        upper = min(upper, constraint.position_rad + constraint.above_rad)
        if lower > upper:
            yield invalid_goal(
                f"the constraints on joint {constraint.joint!r} leave it no position", joint=constraint.joint
            )
        ranges[constraint.joint] = lower, upper


def _position_constraint_flaws(robot: RobotModel, constraint: PositionConstraint) -> Iterator[PlanningFailure]:
    yield from _link_flaws(robot, constraint.link)
    yield from point_flaws(constraint.region.position_m, "region of a position constraint", "m")
    yield from length_flaws(constraint.region.orientation, "orientation of a region")
    yield from point_flaws(constraint.offset_m, "offset of the point", "m")
    if (constraint.half_size_m is None) == (constraint.radius_m is None):
        yield invalid_goal(f"the region for {constraint.link!r} must be either a box or a sphere", link=constraint.link)
    for size_m in (*(constraint.half_size_m or ()), *(() if constraint.radius_m is None else (constraint.radius_m,))):
        yield from _tolerance_flaws("position", size_m, "m")


def check_link(robot: RobotModel, link: str) -> PlanningFailure | None:
    """Tell whether there is a link of this name, and a name: a group whose joints are not one chain has no tip."""
    if link in robot.links:
        return None
    known = ", ".join(robot.links)
    message = f"the robot has no link {link!r}; it has: {known}"
    if not link:
        message = (
            f"the robot has no link '': a group whose joints are not one chain has no tip, so name one of: {known}"
        )
    return PlanningFailure(MoveItErrorCode.INVALID_LINK_NAME, message, {"link": link})


def _link_flaws(robot: RobotModel, link: str) -> Iterator[PlanningFailure]:
    flaw = check_link(robot, link)
    if flaw is not None:
        yield flaw


def point_flaws(point: Sequence[float], what: str, unit: str) -> Iterator[PlanningFailure]:
    """Yield the failure of a point that is not of three finite numbers."""
    if len(point) != 3 or not all(math.isfinite(value) for value in point):
        yield invalid_goal(f"the {what} {in_words(point)} {unit} is not finite")


def length_flaws(vector: Sequence[float], what: str) -> Iterator[PlanningFailure]:
    """Yield the failure of a vector or quaternion whose length is not 1."""
    length = math.hypot(*vector)
    if not abs(length - 1.0) <= LENGTH_TOLERANCE:
        yield invalid_goal(f"the {what} {in_words(vector)} has the length {length:.4g}, not 1", length=length)


def _tolerance_flaws(what: str, value: float, unit: str, least: float | None = None) -> Iterator[PlanningFailure]:
    if not (math.isfinite(value) and (value > 0.0 if least is None else value >= least)):
        bound = "above 0" if least is None else f"{least:g} or more"
        yield invalid_goal(f"the {what} tolerance must be {bound} {unit}, not {value:g}", value=value)


def _beyond_limits(what: str, robot: RobotModel, name: str, value: float) -> PlanningFailure:
    joint = robot.joints[name]
    return invalid_goal(
        f"{what} beyond its limits {joint.lower:.4g} to {joint.upper:.4g} {joint.unit}{joint.degrees_hint(value)}",
        joint=name,
        position_rad=value,
        lower_rad=joint.lower,
        upper_rad=joint.upper,
    )


# A relaxed arm may hang this far beyond a soft limit, and a servo's zero is set by hand.
START_LIMIT_TOLERANCE_RAD = 0.05

# The hulls reach up to 20 mm beyond the links: a folded arm touches itself in the hulls only, and must get out.
START_CONTACT_DEPTH_M = 0.01

# Searches and time to improve are bounded, since a request occupies a planner.
MAX_ATTEMPTS = 1000
MAX_PLANNING_TIME_S = 3600.0

# Pairs in contact that an answer names; a scene of 1000 shapes has thousands where the arm is amid them.
MAX_PAIRS = 100

SPEED_TOLERANCE = 1e-6  # a joint that is measured while it moves at its limit may be reported a little faster


def check_request(robot: RobotModel, problem: PlanningProblem) -> PlanningFailure | None:
    """Check names and numbers of a problem."""
    refusal = check_group(robot, problem.group)
    if refusal is not None:
        return refusal
    group = robot.groups[problem.group]
    return (
        next(_number_flaws(problem), None)
        or next(_moving_start_flaws(robot, group, problem), None)
        or check_goal(robot, group, problem.goal)
        or check_constraints(robot, problem.path_constraints)
    )


def check_ik_question(robot: RobotModel, question: IkQuestion) -> PlanningFailure | None:
    """Check names and numbers of a question for configurations."""
    return (
        check_group(robot, question.group)
        or next(_time_flaws(question.allowed_time_s), None)
        or check_goal(robot, robot.groups[question.group], question.goal)
        or check_constraints(robot, question.constraints)
    )


def check_state_question(robot: RobotModel, question: StateQuestion) -> PlanningFailure | None:
    """Check names and numbers of a question about a state; whether it is within limits is the question itself."""
    return (
        check_group(robot, question.group)
        or next(_position_flaws(robot, question.positions_rad), None)
        or check_constraints(robot, question.constraints)
    )


def check_group(robot: RobotModel, name: str) -> PlanningFailure | None:
    """Tell whether there is a planning group of this name."""
    if name in robot.groups:
        return None
    known = ", ".join(sorted(robot.groups))
    return PlanningFailure(
        MoveItErrorCode.INVALID_GROUP_NAME, f"there is no planning group {name!r}; there are: {known}", {"group": name}
    )


def check_start(robot: RobotModel, start_rad: Mapping[str, float]) -> PlanningFailure | None:
    """Check the positions of all joints at the start."""
    return next(_position_flaws(robot, start_rad), None) or next(
        limit_flaws(robot, start_rad, START_LIMIT_TOLERANCE_RAD, MoveItErrorCode.START_STATE_INVALID), None
    )


def limit_flaws(
    robot: RobotModel, positions_rad: Mapping[str, float], tolerance_rad: float, code: MoveItErrorCode
) -> Iterator[PlanningFailure]:
    """Yield a failure for each joint beyond its limits by more than a tolerance."""
    for joint in robot.movable_joints:
        value = positions_rad[joint.name]
        if not joint.lower - tolerance_rad <= value <= joint.upper + tolerance_rad:
            yield PlanningFailure(
                code,
                f"the arm stands with joint {joint.name!r} at {value:.4g} {joint.unit}, beyond its limits"
                f" {joint.lower:.4g} to {joint.upper:.4g} {joint.unit}",
                {"joint": joint.name, "position_rad": value, "lower_rad": joint.lower, "upper_rad": joint.upper},
            )


def check_start_contact(pairs: Sequence[CollidingPair]) -> PlanningFailure | None:
    """Check for contact at the start; shallow contacts may be left and are no failure."""
    if all(pair.depth_m <= START_CONTACT_DEPTH_M for pair in pairs):
        return None
    return contact_failure(MoveItErrorCode.START_STATE_IN_COLLISION, "the arm stands in collision", pairs)


def contact_failure(code: MoveItErrorCode, what: str, pairs: Sequence[CollidingPair]) -> PlanningFailure:
    """Return the failure that names the pairs in contact."""
    return PlanningFailure(code, f"{what}: {describe_pairs(pairs)}", {"pairs": pairs_as_data(pairs)})


def describe_pairs(pairs: Sequence[CollidingPair]) -> str:
    """The pairs in words, with depths in millimetres."""
    return ", ".join(f"{pair.first} and {pair.second} by {1000.0 * pair.depth_m:.1f} mm" for pair in pairs)


def pairs_as_data(pairs: Sequence[CollidingPair]) -> list[dict[str, Any]]:
    """The pairs as plain values, `MAX_PAIRS` of them at most."""
    return [asdict(pair) for pair in pairs[:MAX_PAIRS]]


def rate_flaws(problem: PlanningProblem | CartesianProblem) -> Iterator[PlanningFailure]:
    """Yield a failure for each share of the limits, and for a time, that cannot be."""
    scalings = {
        "velocity scaling": problem.velocity_scaling,
        "acceleration scaling": problem.acceleration_scaling,
    }
    for name, value in scalings.items():
        if not 0.0 < value <= 1.0:
            yield invalid_goal(f"the {name} must be above 0 and at most 1, not {value:g}", value=value)
    yield from _time_flaws(problem.allowed_time_s)


def _number_flaws(problem: PlanningProblem) -> Iterator[PlanningFailure]:
    yield from rate_flaws(problem)
    if not 0.0 <= problem.optimization_time_s <= MAX_PLANNING_TIME_S:
        value = problem.optimization_time_s
        yield invalid_goal(f"the optimization time must be 0 to {MAX_PLANNING_TIME_S:g} s, not {value:g}", value=value)
    if not 1 <= problem.attempts <= MAX_ATTEMPTS:
        yield invalid_goal(f"the attempts must be 1 to {MAX_ATTEMPTS}, not {problem.attempts}", value=problem.attempts)
    if planner_name(problem.planner_id) is None:
        known = ", ".join(PLANNER_IDS)
        yield invalid_goal(
            f"there is no planner {problem.planner_id!r}; there are: {known}", planner_id=problem.planner_id
        )


def _time_flaws(allowed_time_s: float) -> Iterator[PlanningFailure]:
    if not (math.isfinite(allowed_time_s) and allowed_time_s > 0.0):
        yield invalid_goal(f"the allowed planning time must be a finite number above 0 s, not {allowed_time_s:g}")


def _moving_start_flaws(robot: RobotModel, group: Group, problem: PlanningProblem) -> Iterator[PlanningFailure]:
    for name, value in problem.start_velocity_rad_s.items():
        if name not in group.joints:
            yield _start_invalid(f"the start has a velocity of {name!r}, no joint of group {group.name!r}", joint=name)
            return
        limit = problem.velocity_scaling * robot.joints[name].max_velocity
        if not abs(value) <= limit * (1.0 + SPEED_TOLERANCE):
            yield _start_invalid(
                f"the start velocity of joint {name!r}, {value:.4g} rad/s, is beyond its limit {limit:.4g} rad/s"
                f" at a velocity scaling of {problem.velocity_scaling:g}",
                joint=name,
                velocity_rad_s=value,
                limit_rad_s=limit,
            )


def _position_flaws(robot: RobotModel, positions_rad: Mapping[str, float]) -> Iterator[PlanningFailure]:
    for joint in robot.movable_joints:
        value = positions_rad.get(joint.name)
        if value is None or not math.isfinite(value):
            said = "is missing" if value is None else f"is {value}"
            yield _start_invalid(f"the start position of joint {joint.name!r} {said}", joint=joint.name)


def _start_invalid(message: str, **details: str | float) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.START_STATE_INVALID, message, details)

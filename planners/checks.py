"""Checks of requests before any search: each error has the code that is true of the case, with its figures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from planners.geometry.collision import CollidingPair
from planners.goals import (
    AnyGoal,
    AnyOf,
    AxisGoal,
    ConstraintGoal,
    Constraints,
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
    PlanningError,
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


def check_request(robot: RobotModel, problem: PlanningProblem) -> None:
    """Check names and numbers of a problem; every check raises a PlanningError."""
    group = check_group(robot, problem.group)
    check_rates(problem)
    if not 0.0 <= problem.optimization_time_s <= MAX_PLANNING_TIME_S:
        value = problem.optimization_time_s
        raise invalid_goal(f"the optimization time must be 0 to {MAX_PLANNING_TIME_S:g} s, not {value:g}", value=value)
    if not 1 <= problem.attempts <= MAX_ATTEMPTS:
        raise invalid_goal(f"the attempts must be 1 to {MAX_ATTEMPTS}, not {problem.attempts}", value=problem.attempts)
    if planner_name(problem.planner_id) is None:
        text = f"there is no planner {problem.planner_id!r}; there are: {', '.join(PLANNER_IDS)}"
        raise invalid_goal(text, planner_id=problem.planner_id)
    _check_start_velocity(robot, group, problem)
    check_goal(robot, group, problem.goal)
    check_constraints(robot, problem.path_constraints)


def check_ik_question(robot: RobotModel, question: IkQuestion) -> None:
    """Check names and numbers of a question for configurations."""
    group = check_group(robot, question.group)
    _check_time(question.allowed_time_s)
    check_goal(robot, group, question.goal)
    check_constraints(robot, question.constraints)


def check_state_question(robot: RobotModel, question: StateQuestion) -> None:
    """Check names and numbers of a question about a state; whether it is within limits is the question itself."""
    check_group(robot, question.group)
    _check_positions(robot, question.positions_rad)
    check_constraints(robot, question.constraints)


def check_group(robot: RobotModel, name: str) -> Group:
    """Return the planning group of a name."""
    if name not in robot.groups:
        text = f"there is no planning group {name!r}; there are: {', '.join(sorted(robot.groups))}"
        raise PlanningError(PlanningFailure(MoveItErrorCode.INVALID_GROUP_NAME, text, {"group": name}))
    return robot.groups[name]


def check_start(robot: RobotModel, start_rad: Mapping[str, float]) -> None:
    """Check the positions of all joints at the start."""
    _check_positions(robot, start_rad)
    for failure in limit_flaws(robot, start_rad, START_LIMIT_TOLERANCE_RAD, MoveItErrorCode.START_STATE_INVALID):
        raise PlanningError(failure)


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


def check_start_contact(pairs: Sequence[CollidingPair]) -> None:
    """Check for contact at the start; shallow contacts may be left and are no failure."""
    if any(pair.depth_m > START_CONTACT_DEPTH_M for pair in pairs):
        code = MoveItErrorCode.START_STATE_IN_COLLISION
        raise PlanningError(contact_failure(code, "the arm stands in collision", pairs))


def contact_failure(code: MoveItErrorCode, what: str, pairs: Sequence[CollidingPair]) -> PlanningFailure:
    """Return the failure that names the pairs in contact."""
    return PlanningFailure(code, f"{what}: {describe_pairs(pairs)}", {"pairs": pairs_as_data(pairs)})


def describe_pairs(pairs: Sequence[CollidingPair]) -> str:
    """The pairs in words, with depths in millimetres."""
    return ", ".join(f"{pair.first} and {pair.second} by {1000.0 * pair.depth_m:.1f} mm" for pair in pairs)


def pairs_as_data(pairs: Sequence[CollidingPair]) -> list[dict[str, Any]]:
    """The pairs as plain values, `MAX_PAIRS` of them at most."""
    return [asdict(pair) for pair in pairs[:MAX_PAIRS]]


def check_rates(problem: PlanningProblem | CartesianProblem) -> None:
    """Check the shares of the limits and the allowed time."""
    for name in ("velocity", "acceleration"):
        value = getattr(problem, f"{name}_scaling")
        if not 0.0 < value <= 1.0:
            raise invalid_goal(f"the {name} scaling must be above 0 and at most 1, not {value:g}", value=value)
    _check_time(problem.allowed_time_s)


def check_goal(robot: RobotModel, group: Group, goal: AnyGoal) -> None:
    """Check names and numbers of a goal, of every alternative if there are several."""
    goals = goal.goals if isinstance(goal, AnyOf) else (goal,)
    if not 0 < len(goals) <= MAX_ALTERNATIVES:
        raise invalid_goal(f"a goal has 1 to {MAX_ALTERNATIVES} alternatives, not {len(goals)}", count=len(goals))
    for single in goals:
        _check_single_goal(robot, group, single)


def check_constraints(robot: RobotModel, constraints: Constraints | None) -> None:
    """Check names and numbers of constraints."""
    if constraints is None:
        return
    every: tuple[JointConstraint | PositionConstraint | OrientationConstraint, ...]
    every = (*constraints.joints, *constraints.positions, *constraints.orientations)
    if len(every) > MAX_CONSTRAINTS:
        raise invalid_goal(f"there may be {MAX_CONSTRAINTS} constraints, not {len(every)}", count=len(every))
    if len(constraints.positions) > MAX_POINTS:
        count = len(constraints.positions)
        raise invalid_goal(f"there may be {MAX_POINTS} position constraints, not {count}", count=count)
    for weight in (constraint.weight for constraint in every):
        if not (math.isfinite(weight) and weight >= 0.0):
            raise invalid_goal(f"the weight of a constraint must be a finite number of 0 or more, not {weight:g}")
    for joint in constraints.joints:
        _check_joint_constraint(robot, joint)
    _check_contradictions(constraints.joints)
    for position in constraints.positions:
        _check_position_constraint(robot, position)
    for orientation in constraints.orientations:
        check_link(robot, orientation.link)
        check_length(orientation.orientation, "orientation")
        _check_tolerances("orientation", "rad", *orientation.tolerance_rad)


def check_link(robot: RobotModel, link: str) -> None:
    """Check that there is a link of this name, and a name: a group whose joints are not one chain has no tip."""
    if link in robot.links:
        return
    known = ", ".join(robot.links)
    text = f"the robot has no link {link!r}; it has: {known}"
    if not link:
        text = f"the robot has no link '': a group whose joints are not one chain has no tip, so name one of: {known}"
    raise PlanningError(PlanningFailure(MoveItErrorCode.INVALID_LINK_NAME, text, {"link": link}))


def check_point(point: Sequence[float], what: str) -> None:
    """Check that a point is of three finite numbers [m]."""
    if len(point) != 3 or not all(math.isfinite(value) for value in point):
        raise invalid_goal(f"the {what} {in_words(point)} m is not finite")


def check_length(vector: Sequence[float], what: str) -> None:
    """Check that the length of a vector or quaternion is 1."""
    length = math.hypot(*vector)
    if not abs(length - 1.0) <= LENGTH_TOLERANCE:
        raise invalid_goal(f"the {what} {in_words(vector)} has the length {length:.4g}, not 1", length=length)


def invalid_goal(message: str, **details: str | float) -> PlanningError:
    """Return the error of an invalid goal."""
    return PlanningError(PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, details))


def in_words(point: Sequence[float]) -> str:
    """A point or direction as text."""
    return "(" + ", ".join(f"{value:.4g}" for value in point) + ")"


def _check_single_goal(robot: RobotModel, group: Group, goal: SingleGoal) -> None:
    if isinstance(goal, JointGoal):
        _check_joint_goal(robot, group, goal)
        return
    if isinstance(goal, ConstraintGoal):
        if goal.constraints.empty:
            raise invalid_goal("the goal has no constraint")
        check_constraints(robot, goal.constraints)
        return
    check_link(robot, goal.link)
    check_point(goal.position_m, "goal position")
    _check_tolerances("position", "m", goal.tolerance_m)
    match goal:
        case PositionGoal():
            check_point(goal.offset_m, "offset of the point")
        case AxisGoal():
            check_length(goal.axis, "axis")
            check_length(goal.direction, "direction")
            _check_tolerances("axis", "rad", goal.axis_tolerance_rad)
        case PoseGoal():
            check_length(goal.pose.orientation, "orientation")
            _check_tolerances("orientation", "rad", *goal.orientation_tolerance_rad)


def _check_joint_goal(robot: RobotModel, group: Group, goal: JointGoal) -> None:
    if not (math.isfinite(goal.tolerance_rad) and goal.tolerance_rad >= 0.0):
        raise invalid_goal(f"the joint tolerance must be a finite number of 0 rad or more, not {goal.tolerance_rad:g}")
    for name, value in goal.positions_rad.items():
        if name not in group.joints:
            known = ", ".join(group.joints)
            raise invalid_goal(f"group {group.name!r} has no joint {name!r}; it has: {known}", joint=name)
        if not math.isfinite(value):
            raise invalid_goal(f"the goal of joint {name!r} is {value}, not a finite number", joint=name)
        joint = robot.joints[name]
        if not joint.lower - goal.tolerance_rad <= value <= joint.upper + goal.tolerance_rad:
            raise _beyond_limits(f"the goal of joint {name!r}, {value:.4g} {joint.unit}, is", robot, name, value)


def _check_joint_constraint(robot: RobotModel, constraint: JointConstraint) -> None:
    name, value = constraint.joint, constraint.position_rad
    if name not in robot.joints or not robot.joints[name].movable:
        known = ", ".join(joint.name for joint in robot.movable_joints)
        text = f"a constraint names the joint {name!r}, which does not exist; there are: {known}"
        raise invalid_goal(text, joint=name)
    if not math.isfinite(value):
        raise invalid_goal(f"the constraint on joint {name!r} is at {value}, not a finite number", joint=name)
    _check_tolerances(f"upper {name}", "rad", constraint.above_rad, least=0.0)
    _check_tolerances(f"lower {name}", "rad", constraint.below_rad, least=0.0)
    joint = robot.joints[name]
    if value - constraint.below_rad > joint.upper or value + constraint.above_rad < joint.lower:
        text = f"the range of the constraint on joint {name!r} around {value:.4g} rad is"
        raise _beyond_limits(text, robot, name, value)


def _check_contradictions(constraints: Sequence[JointConstraint]) -> None:
    """Check that ranges of one joint have something in common."""
    ranges: dict[str, tuple[float, float]] = {}
    for constraint in constraints:
        name = constraint.joint
        lower, upper = ranges.get(name, (-math.inf, math.inf))
        lower = max(lower, constraint.position_rad - constraint.below_rad)
        upper = min(upper, constraint.position_rad + constraint.above_rad)
        if lower > upper:
            raise invalid_goal(f"the constraints on joint {name!r} leave it no position", joint=name)
        ranges[name] = lower, upper


def _check_position_constraint(robot: RobotModel, constraint: PositionConstraint) -> None:
    check_link(robot, constraint.link)
    check_point(constraint.region.position_m, "region of a position constraint")
    check_length(constraint.region.orientation, "orientation of a region")
    check_point(constraint.offset_m, "offset of the point")
    half_size_m, radius_m = constraint.half_size_m, constraint.radius_m
    if (half_size_m is None) == (radius_m is None):
        raise invalid_goal(f"the region for {constraint.link!r} must be either a box or a sphere", link=constraint.link)
    _check_tolerances("position", "m", *(half_size_m or ()), *(() if radius_m is None else (radius_m,)))


def _check_tolerances(what: str, unit: str, *values: float, least: float | None = None) -> None:
    for value in values:
        if not (math.isfinite(value) and (value > 0.0 if least is None else value >= least)):
            bound = "above 0" if least is None else f"{least:g} or more"
            raise invalid_goal(f"the {what} tolerance must be {bound} {unit}, not {value:g}", value=value)


def _beyond_limits(what: str, robot: RobotModel, name: str, value: float) -> PlanningError:
    joint = robot.joints[name]
    text = f"{what} beyond its limits {joint.lower:.4g} to {joint.upper:.4g} {joint.unit}{joint.degrees_hint(value)}"
    return invalid_goal(text, joint=name, position_rad=value, lower_rad=joint.lower, upper_rad=joint.upper)


def _check_time(allowed_time_s: float) -> None:
    if not (math.isfinite(allowed_time_s) and allowed_time_s > 0.0):
        raise invalid_goal(f"the allowed planning time must be a finite number above 0 s, not {allowed_time_s:g}")


def _check_start_velocity(robot: RobotModel, group: Group, problem: PlanningProblem) -> None:
    for name, value in problem.start_velocity_rad_s.items():
        if name not in group.joints:
            raise _start_invalid(f"the start has a velocity of {name!r}, no joint of group {group.name!r}", joint=name)
        limit = problem.velocity_scaling * robot.joints[name].max_velocity
        if not abs(value) <= limit * (1.0 + SPEED_TOLERANCE):
            text = f"the start velocity of joint {name!r}, {value:.4g} rad/s, is beyond its limit {limit:.4g} rad/s"
            text += f" at a velocity scaling of {problem.velocity_scaling:g}"
            raise _start_invalid(text, joint=name, velocity_rad_s=value, limit_rad_s=limit)


def _check_positions(robot: RobotModel, positions_rad: Mapping[str, float]) -> None:
    for joint in robot.movable_joints:
        value = positions_rad.get(joint.name)
        if value is None or not math.isfinite(value):
            state = "is missing" if value is None else f"is {value}"
            raise _start_invalid(f"the start position of joint {joint.name!r} {state}", joint=joint.name)


def _start_invalid(message: str, **details: str | float) -> PlanningError:
    return PlanningError(PlanningFailure(MoveItErrorCode.START_STATE_INVALID, message, details))

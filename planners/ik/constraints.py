"""Goals and constraints as sets of conditions on one configuration, which can be measured and solved for.

A condition measures its error as a vector, and the violation, the part of the error that exceeds its tolerance: a
vector of zeros once the condition holds. Poses of links are in the robot's root link.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics, Placements
from planners.goals import (
    AxisGoal,
    ConstraintGoal,
    Constraints,
    JointConstraint,
    PoseGoal,
    PositionConstraint,
    PositionGoal,
)
from planners.problem import Deviation
from planners.scene import Quaternion
from robot.trajectory import Vector

ROTATION_ARM_M = 0.1  # rotations count as the motion of a point this far away: half the length of a small gripper
PARALLEL = 1e-9  # sine below which unit vectors span no plane
ROUNDING = 1e-9  # rounding in the placement of a link must not break a condition that was met to its very edge

# Messages without weights carry 0; MoveIt gives such constraints full weight.
LEAST_WEIGHT = 1e-6
DEFAULT_WEIGHT = 1.0


class _LinkCondition(ABC):
    """Condition on the pose of a link: a measured error of 0, or up to a tolerance."""

    link: str
    tolerance: float | Vector  # radius of a ball around no error, or half the edges of a box, shape (3,) [m or rad]
    weight: float  # its share where not all conditions can hold
    arm_m: float  # length by which errors count as distances [m or m/rad]

    @abstractmethod
    def error(self, placement: pin.SE3) -> Vector:
        """Return the error at a pose of the link, shape (3,) [m or rad]."""

    @abstractmethod
    def distances(self, placements: Placements) -> Vector:
        """Return the length of the error in each of many placements, shape (m,) [m or rad]."""

    def violation(self, error: Vector, share: float = 1.0) -> Vector:
        """Return the part of an error outside a share of the tolerance, shape (3,); zeros once the condition holds."""
        if isinstance(self.tolerance, float):
            length, inside = norm(error), share * self.tolerance + ROUNDING
            return error * (1.0 - inside / length) if length > inside else np.zeros_like(error)
        half = share * self.tolerance + ROUNDING
        return np.asarray(error - np.minimum(np.maximum(error, -half), half))


@dataclass(frozen=True, eq=False)
class PointCondition(_LinkCondition):
    """A point of a link is in a region."""

    link: str
    offset_m: Vector  # the point in the link's frame, shape (3,) [m]
    center_m: Vector  # middle of the region, shape (3,) [m]
    axes: Vector  # axes of the region in its columns, shape (3, 3)
    tolerance: float | Vector
    weight: float = 1.0

    arm_m = 1.0

    def point(self, placement: pin.SE3) -> Vector:
        """Return the point's position, shape (3,) [m]."""
        return np.asarray(placement.translation + placement.rotation @ self.offset_m)

    def error(self, placement: pin.SE3) -> Vector:
        """From the point to the middle of its region, along the region's axes [m]."""
        return np.asarray((self.center_m - self.point(placement)) @ self.axes)

    def distances(self, placements: Placements) -> Vector:
        """Distance of the point from the middle [m]."""
        # One product of a matrix takes a tenth of the time of thousands of small ones.
        turned_m = (placements.rotations.reshape(-1, 3) @ self.offset_m).reshape(-1, 3)
        away_m = placements.positions_m + turned_m - self.center_m
        return np.asarray(np.sqrt(np.einsum("mi,mi->m", away_m, away_m)))


@dataclass(frozen=True, eq=False)
class TurnCondition(_LinkCondition):
    """A link has an orientation."""

    link: str
    rotation: Vector  # the orientation, shape (3, 3)
    tolerance: Vector
    weight: float = 1.0

    arm_m = ROTATION_ARM_M

    def error(self, placement: pin.SE3) -> Vector:
        """Rotation vector to the orientation, along the link's axes [rad]."""
        return np.asarray(pin.log3(placement.rotation.T @ self.rotation))

    def distances(self, placements: Placements) -> Vector:
        """Angle to the orientation [rad]."""
        traces = np.einsum("mij,ij->m", placements.rotations, self.rotation)
        return np.asarray(np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0)))


@dataclass(frozen=True, eq=False)
class AxisCondition(_LinkCondition):
    """An axis of a link has a direction, however the link turns about it."""

    link: str
    axis: Vector  # unit vector in the link's frame, shape (3,)
    direction: Vector  # unit vector, shape (3,)
    tolerance: float | Vector
    weight: float = 1.0

    arm_m = ROTATION_ARM_M

    @cached_property
    def crossing(self) -> Vector:
        """Cross-product matrix of the axis, shape (3, 3)."""
        return np.asarray(np.cross(self.axis, np.eye(3)).T)

    def error(self, placement: pin.SE3) -> Vector:
        """Shortest rotation vector that brings the axis into the direction, along the link's axes [rad]."""
        wanted = self.direction @ placement.rotation
        normal = self.crossing @ wanted
        sine, cosine = norm(normal), float(self.axis @ wanted)
        if sine < PARALLEL:
            return np.zeros(3) if cosine > 0.0 else np.pi * frame_along(self.axis)[:, 0]
        return np.asarray(normal * (math.atan2(sine, cosine) / sine))

    def distances(self, placements: Placements) -> Vector:
        """Angle between axis and direction [rad]."""
        return np.asarray(np.arccos(np.clip(placements.rotations @ self.axis @ self.direction, -1.0, 1.0)))


@dataclass(frozen=True)
class JointCondition:
    """A joint is in a range."""

    joint: str  # its name
    column: int  # its place in a configuration
    position_rad: float  # desired position within its limits [rad]
    lower_rad: float  # lower end of the range [rad]
    upper_rad: float  # upper end [rad]
    weight: float = 1.0  # its share where not all can hold

    arm_m = ROTATION_ARM_M

    def violation_rad(self, value: float, share: float = 1.0) -> float:
        """Return the way from a position of the joint to a share of its range; 0 inside [rad]."""
        lower_rad = self.position_rad - share * (self.position_rad - self.lower_rad) - ROUNDING
        upper_rad = self.position_rad + share * (self.upper_rad - self.position_rad) + ROUNDING
        return min(max(value, lower_rad), upper_rad) - value

    def holds(self, q: Vector) -> bool:
        """Return true if the joint is in its range in a configuration, shape (n,) [rad]."""
        return self.violation_rad(q[self.column]) == 0.0


TaskGoal = PositionGoal | AxisGoal | PoseGoal | ConstraintGoal
LinkCondition = PointCondition | TurnCondition | AxisCondition
Condition = LinkCondition | JointCondition


def norm(vector: Vector) -> float:
    """Return the length of a short vector, in a quarter of the time that numpy takes."""
    return math.sqrt(float(vector @ vector))


def frame_along(axis: Vector) -> Vector:
    """Return a rotation whose third column is a unit vector, shape (3, 3)."""
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    return np.column_stack((np.cross(across, axis), across, axis))


@dataclass(frozen=True)
class Violation:
    """A condition that does not hold, as a sentence and as plain values."""

    sentence: str
    details: Mapping[str, str | float]


@dataclass(frozen=True)
class GoalConditions:
    """Conditions of a goal: some must hold, and others are to hold as nearly as possible."""

    required: tuple[Condition, ...]
    preferred: tuple[Condition, ...] = ()

    def also(self, conditions: Sequence[Condition]) -> GoalConditions:
        """Return the same with further conditions that must hold."""
        return GoalConditions((*self.required, *conditions), self.preferred)


def goal_conditions(goal: TaskGoal, collision: CollisionModel) -> GoalConditions:
    """Return the conditions of a goal; it must have passed the checks."""
    match goal:
        case PositionGoal():
            return GoalConditions((_ball(goal.link, goal.position_m, goal.tolerance_m, goal.offset_m),))
        case AxisGoal():
            axis, direction = _unit(goal.axis), _unit(goal.direction)
            aligned = AxisCondition(goal.link, axis, direction, float(goal.axis_tolerance_rad))
            return GoalConditions((_ball(goal.link, goal.position_m, goal.tolerance_m), aligned))
        case PoseGoal():
            at = _ball(goal.link, goal.pose.position_m, goal.position_tolerance_m)
            turned = tuple(_turned(goal.link, goal.pose.orientation, goal.orientation_tolerance_rad, DEFAULT_WEIGHT))
            return GoalConditions((at, *turned)) if goal.strict else GoalConditions((at,), turned)
        case ConstraintGoal():
            return GoalConditions(conditions(goal.constraints, collision))


def conditions(constraints: Constraints | None, collision: CollisionModel) -> tuple[Condition, ...]:
    """Return the conditions of constraints; they must have passed the checks."""
    if constraints is None:
        return ()
    found: list[Condition] = [_in_range(constraint, collision) for constraint in constraints.joints]
    found += [_in_region(constraint) for constraint in constraints.positions]
    for constraint in constraints.orientations:
        found += _turned(constraint.link, constraint.orientation, constraint.tolerance_rad, constraint.weight)
    return tuple(found)


class ConditionSet:
    """Conditions that hold together, measured in configurations ``q`` of shape (n,) [rad]."""

    def __init__(self, forward: ForwardKinematics, conditions: Sequence[Condition]) -> None:
        self._forward = forward
        self._of_joints = [condition for condition in conditions if isinstance(condition, JointCondition)]
        self._of_links = [condition for condition in conditions if not isinstance(condition, JointCondition)]

    def holds(self, q: Vector) -> bool:
        """Tell whether all conditions hold."""
        if not all(condition.holds(q) for condition in self._of_joints):
            return False
        return not any(violation.any() for _, _, violation in self._measured(q))

    def violation_m(self, q: Vector) -> float:
        """Return the length of all violations, 0 when the conditions hold; rotations count by their arm [m]."""
        turned = [condition.arm_m * condition.violation_rad(q[condition.column]) for condition in self._of_joints]
        moved = [condition.arm_m * norm(violation) for condition, _, violation in self._measured(q)]
        return math.hypot(*turned, *moved)

    def violations(self, q: Vector) -> list[Violation]:
        """Return the violated conditions."""
        found = [_joint_violation(joint, float(q[joint.column])) for joint in self._of_joints if not joint.holds(q)]
        found += [
            _link_violation(condition, norm(error), norm(violation))
            for condition, error, violation in self._measured(q)
            if violation.any()
        ]
        return found

    def deviation(self, q: Vector) -> Deviation:
        """Return the greatest distance of a point from the middle of its region, and of a link from its orientation."""
        position_m, orientation_rad = 0.0, 0.0
        for condition, error, _ in self._measured(q):
            if isinstance(condition, PointCondition):
                position_m = max(position_m, norm(error))
            else:
                orientation_rad = max(orientation_rad, norm(error))
        return Deviation(position_m, orientation_rad)

    def _measured(self, q: Vector) -> Iterator[tuple[LinkCondition, Vector, Vector]]:
        """Measure each condition on a link: its error and its violation."""
        if self._of_links:
            self._forward.place(q)
        for condition in self._of_links:
            error = condition.error(self._forward.placement(condition.link))
            yield condition, error, condition.violation(error)


def rotation(orientation: Quaternion) -> Vector:
    """Return the rotation matrix of a quaternion x, y, z, w of any length above 0, shape (3, 3)."""
    return np.asarray(pin.XYZQUATToSE3(np.array([0.0, 0.0, 0.0, *_unit(orientation)])).rotation)


def _ball(
    link: str, center_m: Sequence[float], radius_m: float, offset_m: Sequence[float] = (0.0, 0.0, 0.0)
) -> PointCondition:
    return PointCondition(link, np.array(offset_m, float), np.array(center_m, float), np.eye(3), float(radius_m))


def _in_region(constraint: PositionConstraint) -> PointCondition:
    half, radius_m = constraint.half_size_m, constraint.radius_m
    return PointCondition(
        constraint.link,
        np.array(constraint.offset_m, float),
        np.array(constraint.region.position_m, float),
        rotation(constraint.region.orientation),
        float(radius_m) if radius_m is not None else np.array(half, float),
        _weight(constraint.weight),
    )


def _turned(
    link: str, orientation: Quaternion, tolerance_rad: Sequence[float], weight: float
) -> Iterator[TurnCondition | AxisCondition]:
    """Yield the condition of an orientation: of an axis alone where the turn about it is free, none where all are."""
    tolerance = np.array(tolerance_rad, float)
    free = np.flatnonzero(tolerance >= math.pi)
    wanted = rotation(orientation)
    if len(free) == 0:
        yield TurnCondition(link, wanted, tolerance, _weight(weight))
    elif len(free) == 1:
        axis = np.eye(3)[free[0]]
        yield AxisCondition(link, axis, wanted @ axis, tolerance, _weight(weight))
    elif len(free) == 2:
        yield TurnCondition(link, wanted, tolerance, _weight(weight))


def _in_range(constraint: JointConstraint, collision: CollisionModel) -> JointCondition:
    column = collision.joint_names.index(constraint.joint)
    limits = float(collision.lower_rad[column]), float(collision.upper_rad[column])
    lower = max(constraint.position_rad - constraint.below_rad, limits[0])
    upper = min(constraint.position_rad + constraint.above_rad, limits[1])
    wanted = min(max(constraint.position_rad, lower), upper)
    return JointCondition(constraint.joint, column, wanted, lower, upper, _weight(constraint.weight))


def _weight(weight: float) -> float:
    return weight if weight >= LEAST_WEIGHT else DEFAULT_WEIGHT


def _unit(vector: Sequence[float]) -> Vector:
    values = np.array(vector, float)
    return np.asarray(values / np.linalg.norm(values))


def _joint_violation(condition: JointCondition, value: float) -> Violation:
    lower, upper = condition.lower_rad, condition.upper_rad
    text = f"joint {condition.joint!r} is at {value:.4g} rad, outside {lower:.4g} to {upper:.4g} rad"
    return Violation(text, {"joint": condition.joint, "position_rad": value, "lower_rad": lower, "upper_rad": upper})


def _link_violation(condition: LinkCondition, error: float, violation: float) -> Violation:
    if isinstance(condition, PointCondition):
        text = f"{condition.link!r} is {100.0 * violation:.1f} cm outside its region"
        return Violation(text, {"link": condition.link, "distance_m": error, "beyond_m": violation})
    turned, too_far = math.degrees(error), math.degrees(violation)
    text = f"{condition.link!r} is turned by {turned:.1f}°, {too_far:.1f}° beyond its tolerance"
    return Violation(text, {"link": condition.link, "orientation_rad": error, "beyond_rad": violation})

"""Goals and constraints as sets of conditions, and what of them is violated in a configuration."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.forward import ForwardKinematics
from planners.goals import (
    AxisGoal,
    ConstraintGoal,
    Constraints,
    JointConstraint,
    PoseGoal,
    PositionConstraint,
    PositionGoal,
    Quaternion,
)
from planners.ik.conditions import (
    AxisCondition,
    Condition,
    JointCondition,
    LinkCondition,
    PointCondition,
    TurnCondition,
    norm,
)
from planners.problem import Deviation

Vector = NDArray[np.float64]

# Messages whose weights nobody has set carry 0; MoveIt takes such constraints as seriously as any.
LEAST_WEIGHT = 1e-6
DEFAULT_WEIGHT = 1.0


@dataclass(frozen=True)
class Violation:
    """A condition that does not hold: said in words, and as plain values."""

    sentence: str
    details: Mapping[str, str | float]


@dataclass(frozen=True)
class Joints:
    """The joints of a configuration.

    Attributes:
        names: in the order of its values.
        lower_rad: shape (n,), lower position limits.
        upper_rad: shape (n,), upper position limits.
    """

    names: tuple[str, ...]
    lower_rad: Vector
    upper_rad: Vector


@dataclass(frozen=True)
class Wish:
    """A goal in conditions.

    Attributes:
        required: what must hold.
        preferred: what shall hold as nearly as can be.
    """

    required: tuple[Condition, ...]
    preferred: tuple[Condition, ...] = ()

    def also(self, conditions: Sequence[Condition]) -> Wish:
        """The same with further conditions that must hold."""
        return Wish((*self.required, *conditions), self.preferred)


def wish(goal: PositionGoal | AxisGoal | PoseGoal | ConstraintGoal, joints: Joints) -> Wish:
    """What a goal demands; it must have passed the checks."""
    match goal:
        case PositionGoal():
            return Wish((_ball(goal.link, goal.position_m, goal.tolerance_m, goal.offset_m),))
        case AxisGoal():
            axis, direction = _unit(goal.axis), _unit(goal.direction)
            aligned = AxisCondition(goal.link, axis, direction, float(goal.axis_tolerance_rad))
            return Wish((_ball(goal.link, goal.position_m, goal.tolerance_m), aligned))
        case PoseGoal():
            at = _ball(goal.link, goal.pose.position_m, goal.position_tolerance_m)
            turned = tuple(_turned(goal.link, goal.pose.orientation, goal.orientation_tolerance_rad, DEFAULT_WEIGHT))
            return Wish((at, *turned)) if goal.strict else Wish((at,), turned)
        case ConstraintGoal():
            return Wish(conditions(goal.constraints, joints))


def conditions(constraints: Constraints | None, joints: Joints) -> tuple[Condition, ...]:
    """What constraints demand; they must have passed the checks."""
    if constraints is None:
        return ()
    found: list[Condition] = [_in_range(constraint, joints) for constraint in constraints.joints]
    found += [_in_region(constraint) for constraint in constraints.positions]
    for constraint in constraints.orientations:
        found += _turned(constraint.link, constraint.orientation, constraint.tolerance_rad, constraint.weight)
    return tuple(found)


@dataclass(frozen=True)
class ConditionSet:
    """Conditions that hold together, measured in configurations ``q`` of shape (n,) [rad].

    Attributes:
        forward: places the links.
        conditions: the conditions.
    """

    forward: ForwardKinematics
    conditions: Sequence[Condition]
    _of_joints: list[JointCondition] = field(init=False, repr=False)
    _of_links: list[LinkCondition] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        joints = [condition for condition in self.conditions if isinstance(condition, JointCondition)]
        links = [condition for condition in self.conditions if not isinstance(condition, JointCondition)]
        object.__setattr__(self, "_of_joints", joints)
        object.__setattr__(self, "_of_links", links)

    def holds(self, q: Vector) -> bool:
        """Whether all conditions hold."""
        if any(condition.beyond_rad(q[condition.column]) for condition in self._of_joints):
            return False
        return not any(beyond.any() for _, _, beyond in self._measured(q))

    def beyond_m(self, q: Vector) -> float:
        """How far the conditions are from holding together: 0 when they do; turns count by their arm [m]."""
        turned = [condition.arm_m * condition.beyond_rad(q[condition.column]) for condition in self._of_joints]
        moved = [condition.arm_m * norm(beyond) for condition, _, beyond in self._measured(q)]
        return math.hypot(*turned, *moved)

    def violations(self, q: Vector) -> list[Violation]:
        """What does not hold."""
        found = [
            _joint_violation(joint, float(q[joint.column]))
            for joint in self._of_joints
            if joint.beyond_rad(q[joint.column])
        ]
        found += [
            _link_violation(condition, norm(missing), norm(beyond))
            for condition, missing, beyond in self._measured(q)
            if beyond.any()
        ]
        return found

    def deviation(self, q: Vector) -> Deviation:
        """The furthest that a point is from the middle of its region, and a link from its orientation."""
        position_m, orientation_rad = 0.0, 0.0
        for condition, missing, _ in self._measured(q):
            if isinstance(condition, PointCondition):
                position_m = max(position_m, norm(missing))
            else:
                orientation_rad = max(orientation_rad, norm(missing))
        return Deviation(position_m, orientation_rad)

    def _measured(self, q: Vector) -> Iterator[tuple[LinkCondition, Vector, Vector]]:
        """Each condition on a link with what is missing, and what of it is beyond the tolerance."""
        if self._of_links:
            self.forward.place(q)
        for condition in self._of_links:
            missing = condition.missing(self.forward.placement(condition.link))
            yield condition, missing, condition.beyond(missing)


def rotation(orientation: Quaternion) -> Vector:
    """Rotation matrix of a quaternion x, y, z, w of any length above 0, shape (3, 3)."""
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
    """An orientation; one that leaves an axis of the link free is about that axis alone, one with two free is none."""
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


def _in_range(constraint: JointConstraint, joints: Joints) -> JointCondition:
    column = joints.names.index(constraint.joint)
    limits = float(joints.lower_rad[column]), float(joints.upper_rad[column])
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
    return Violation(
        f"joint {condition.joint!r} is at {value:.4g} rad, outside {lower:.4g} to {upper:.4g} rad",
        {"joint": condition.joint, "position_rad": value, "lower_rad": lower, "upper_rad": upper},
    )


def _link_violation(condition: LinkCondition, missing: float, beyond: float) -> Violation:
    if isinstance(condition, PointCondition):
        return Violation(
            f"{condition.link!r} is {100.0 * beyond:.1f} cm outside its region",
            {"link": condition.link, "distance_m": missing, "beyond_m": beyond},
        )
    turned, too_far = math.degrees(missing), math.degrees(beyond)
    return Violation(
        f"{condition.link!r} is turned by {turned:.1f}°, {too_far:.1f}° beyond its tolerance",
        {"link": condition.link, "orientation_rad": missing, "beyond_rad": beyond},
    )

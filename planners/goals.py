"""Goals and constraints: plain data in the root link, in SI units, with unit quaternions x, y, z, w."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from planners.scene import ZERO, Point, Pose, Quaternion


@dataclass(frozen=True)
class JointGoal:
    """Bring joints to positions [rad]; joints of the group that are not named keep their start position."""

    positions_rad: Mapping[str, float]  # joint name -> position, met exactly where the limits allow it
    tolerance_rad: float = 1e-4  # greatest distance of a position beyond its limit; the joint then goes to the limit


@dataclass(frozen=True)
class PositionGoal:
    """Bring a point of ``link`` to a point of the planning frame, whatever the orientation."""

    link: str
    position_m: Point  # x, y, z in the robot's root link [m]
    tolerance_m: float  # radius of the sphere around the point that counts as there [m]
    offset_m: Point = ZERO  # the point of the link, in the link's frame [m]


@dataclass(frozen=True)
class AxisGoal:
    """Bring the origin of ``link`` to a point with one axis of the link in a direction, as five joints can."""

    link: str
    position_m: Point  # x, y, z in the robot's root link [m]
    tolerance_m: float  # radius of the sphere around the point that counts as there [m]
    axis: Point  # unit vector in the link's frame
    direction: Point  # unit vector in the robot's root link that the axis shall have
    axis_tolerance_rad: float  # greatest angle between them [rad]


@dataclass(frozen=True)
class PoseGoal:
    """Bring ``link`` to a pose."""

    link: str
    pose: Pose  # in the robot's root link
    position_tolerance_m: float  # radius of the sphere around the position that counts as there [m]
    orientation_tolerance_rad: Point  # greatest rotation about the link's x, y, z from the desired orientation [rad]
    # True where an orientation outside its tolerance is a failure; else the position is met with the nearest
    # orientation, whose deviation is reported.
    strict: bool = False

    @property
    def position_m(self) -> Point:
        """The pose's position."""
        return self.pose.position_m

    @property
    def tolerance_m(self) -> float:
        """The position's tolerance."""
        return self.position_tolerance_m


@dataclass(frozen=True)
class JointConstraint:
    """A joint stays within ``below_rad`` and ``above_rad`` of a position [rad], as moveit_msgs/JointConstraint."""

    joint: str
    position_rad: float
    above_rad: float
    below_rad: float
    weight: float = 1.0


@dataclass(frozen=True)
class PositionConstraint:
    """A point of a link stays inside a box or sphere, as moveit_msgs/PositionConstraint with one region."""

    link: str  # the link
    region: Pose  # where the region is, in the robot's root link
    half_size_m: Point | None = None  # half the box's edges [m], or None for a sphere
    radius_m: float | None = None  # radius of the sphere [m], or None for a box
    offset_m: Point = ZERO  # the point of the link, in the link's frame [m]
    weight: float = 1.0  # its share where not all constraints can hold


@dataclass(frozen=True)
class OrientationConstraint:
    """A link keeps an orientation, as moveit_msgs/OrientationConstraint with ROTATION_VECTOR tolerances."""

    link: str  # the link
    orientation: Quaternion  # in the robot's root link
    tolerance_rad: Point  # greatest rotation about the link's x, y, z from it [rad]; pi or more leaves an axis free
    weight: float = 1.0  # its share where not all constraints can hold


@dataclass(frozen=True)
class Constraints:
    """Conditions that hold together."""

    joints: tuple[JointConstraint, ...] = ()
    positions: tuple[PositionConstraint, ...] = ()
    orientations: tuple[OrientationConstraint, ...] = ()

    @property
    def empty(self) -> bool:
        """True when there is no constraint."""
        return not (self.joints or self.positions or self.orientations)


@dataclass(frozen=True)
class ConstraintGoal:
    """Reach any configuration in which all constraints hold, as near to their middles as possible."""

    constraints: Constraints


SingleGoal = JointGoal | PositionGoal | AxisGoal | PoseGoal | ConstraintGoal


@dataclass(frozen=True)
class AnyOf:
    """Reach any of several goals: the goal that is reached soonest."""

    goals: tuple[SingleGoal, ...]


AnyGoal = SingleGoal | AnyOf

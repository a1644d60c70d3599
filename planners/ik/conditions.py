"""Conditions on one configuration that can be measured and aimed at: what goals and constraints come down to.

Each tells what is ``missing`` to its middle as a vector, and what of that lies ``beyond`` its tolerance: a vector of
zeros once it holds. Placements are those of its link in the robot's root link.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.forward import Placements

Vector = NDArray[np.float64]

# A turn counts as much as the motion of a point this far away: half the length of a small gripper.
ROTATION_ARM_M = 0.1

# Of unit vectors: so nearly parallel or opposite that they span no plane.
PARALLEL = 1e-9

# Rounding in the placement of a link must not break a condition that was met to its very edge.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class PointCondition:
    """A point of a link is in a region.

    Attributes:
        link: the link.
        offset_m: the point in the link's frame, shape (3,) [m].
        center_m: middle of the region, shape (3,) [m].
        axes: axes of the region in its columns, shape (3, 3).
        tolerance_m: radius of a sphere, or half the edges of a box, shape (3,) [m].
        weight: its share where not all can hold.
    """

    link: str
    offset_m: Vector
    center_m: Vector
    axes: Vector
    tolerance_m: float | Vector
    weight: float = 1.0

    arm_m = 1.0

    def point(self, placement: pin.SE3) -> Vector:
        """Where the point is, shape (3,) [m]."""
        position_m: Vector = placement.translation + placement.rotation @ self.offset_m
        return position_m

    def missing(self, placement: pin.SE3) -> Vector:
        """From the point to the middle, along the region's axes [m]."""
        missing_m: Vector = (self.center_m - self.point(placement)) @ self.axes
        return missing_m

    def beyond(self, missing: Vector, share: float = 1.0) -> Vector:
        """From the point to the region, shrunk to a share of its size [m]."""
        return outside(missing, self.tolerance_m, share)

    def distances(self, placements: Placements) -> Vector:
        """From the middle in each of many placements, shape (m,) [m]."""
        points_m = placements.positions_m + placements.rotations @ self.offset_m
        away: Vector = np.linalg.norm(points_m - self.center_m, axis=1)
        return away


@dataclass(frozen=True, eq=False)
class TurnCondition:
    """A link has an orientation.

    Attributes:
        link: the link.
        rotation: the orientation, shape (3, 3).
        tolerance_rad: greatest rotation from it about the link's axes, shape (3,) [rad].
        weight: its share where not all can hold.
    """

    link: str
    rotation: Vector
    tolerance_rad: Vector
    weight: float = 1.0

    arm_m = ROTATION_ARM_M

    def missing(self, placement: pin.SE3) -> Vector:
        """Rotation vector to the orientation, along the link's axes [rad]."""
        missing_rad: Vector = pin.log3(placement.rotation.T @ self.rotation)
        return missing_rad

    def beyond(self, missing: Vector, share: float = 1.0) -> Vector:
        """What of it is beyond a share of the tolerance [rad]."""
        return outside(missing, self.tolerance_rad, share)

    def distances(self, placements: Placements) -> Vector:
        """Angle to the orientation in each of many placements, shape (m,) [rad]."""
        traces = np.einsum("mij,ij->m", placements.rotations, self.rotation)
        return np.asarray(np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0)))


@dataclass(frozen=True, eq=False)
class AxisCondition:
    """An axis of a link has a direction, however the link turns about it.

    Attributes:
        link: the link.
        axis: unit vector in the link's frame, shape (3,).
        direction: unit vector, shape (3,).
        tolerance_rad: greatest angle between them, or greatest rotation about each of the link's axes, shape (3,).
        weight: its share where not all can hold.
    """

    link: str
    axis: Vector
    direction: Vector
    tolerance_rad: float | Vector
    weight: float = 1.0

    arm_m = ROTATION_ARM_M

    @cached_property
    def crossing(self) -> Vector:
        """What makes the cross product of the axis with a vector, shape (3, 3)."""
        return np.asarray(np.cross(self.axis, np.eye(3)).T)

    def missing(self, placement: pin.SE3) -> Vector:
        """The shortest rotation vector that brings the axis into the direction, along the link's axes [rad]."""
        wanted = self.direction @ placement.rotation
        normal = self.crossing @ wanted
        sine, cosine = norm(normal), float(self.axis @ wanted)
        if sine < PARALLEL:
            return np.zeros(3) if cosine > 0.0 else np.pi * frame_along(self.axis)[:, 0]
        turn: Vector = normal * (math.atan2(sine, cosine) / sine)
        return turn

    def beyond(self, missing: Vector, share: float = 1.0) -> Vector:
        """What of it is beyond a share of the tolerance [rad]."""
        return outside(missing, self.tolerance_rad, share)

    def distances(self, placements: Placements) -> Vector:
        """Angle between axis and direction in each of many placements, shape (m,) [rad]."""
        return np.asarray(np.arccos(np.clip(placements.rotations @ self.axis @ self.direction, -1.0, 1.0)))


@dataclass(frozen=True)
class JointCondition:
    """A joint is in a range.

    Attributes:
        joint: its name.
        column: where it is in a configuration.
        position_rad: where it shall be, as far as its limits allow [rad].
        lower_rad: lower end of the range [rad].
        upper_rad: upper end [rad].
        weight: its share where not all can hold.
    """

    joint: str
    column: int
    position_rad: float
    lower_rad: float
    upper_rad: float
    weight: float = 1.0

    arm_m = ROTATION_ARM_M

    def beyond_rad(self, value: float, share: float = 1.0) -> float:
        """From a position of the joint to a share of the range [rad]."""
        lower_rad = self.position_rad - share * (self.position_rad - self.lower_rad) - ROUNDING
        upper_rad = self.position_rad + share * (self.upper_rad - self.position_rad) + ROUNDING
        return min(max(value, lower_rad), upper_rad) - value


LinkCondition = PointCondition | TurnCondition | AxisCondition
Condition = LinkCondition | JointCondition


def outside(vector: Vector, tolerance: float | Vector, share: float) -> Vector:
    """The part of a vector outside a share of a ball of some radius, or of a box of half edges, around its origin."""
    if isinstance(tolerance, float):
        length = norm(vector)
        inside = share * tolerance + ROUNDING
        return vector * (1.0 - inside / length) if length > inside else np.zeros_like(vector)
    half = share * tolerance + ROUNDING
    rest: Vector = vector - np.minimum(np.maximum(vector, -half), half)
    return rest


def norm(vector: Vector) -> float:
    """Length of a short vector: numpy's own takes four times as long."""
    return math.sqrt(float(vector @ vector))


def frame_along(axis: Vector) -> Vector:
    """A rotation whose third column is a unit vector, shape (3, 3)."""
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    return np.column_stack((np.cross(across, axis), across, axis))

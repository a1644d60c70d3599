"""Soft limits of the joints, shared by planner and controller."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robot.calibration import Calibration
from robot.description.model import RobotModel
from robot.errors import DescriptionError
from robot.trajectory import TIME_TO_FULL_ACCELERATION_S, MotionLimits, Vector

# Distance of the soft limits from the calibrated end stops: covers backlash (1 deg) and rounding.
END_STOP_MARGIN_RAD = 0.03

# Greatest speed that is asked of a servo, of either family: it bounds the way towards a wrong goal (2.8 rad/s). A joint
# that follows a motion catches up by the rest of it; with less, at 4 rad/s, every motion ended with TRACKING_LOST.
FASTEST_TICKS_S = 1800
CATCHING_UP = 1.1

log = logging.getLogger("armbridge.arm")


def within_calibration(robot: RobotModel, calibration: Calibration) -> RobotModel:
    """Return the robot with each joint's limits narrowed to its calibrated range, less a margin, and to its servo."""
    joints = dict(robot.joints)
    for calibrated in calibration.joints:
        joint = joints.get(calibrated.joint)
        if joint is None or not joint.movable:
            raise DescriptionError("URDF", f"has no movable joint {calibrated.joint!r}, which the calibration names")
        lower = max(joint.lower, calibrated.lower_rad + END_STOP_MARGIN_RAD)
        upper = min(joint.upper, calibrated.upper_rad - END_STOP_MARGIN_RAD)
        if lower >= upper:
            raise DescriptionError(
                f"joint {joint.name!r}",
                f"the URDF's limits {joint.lower:.3f} to {joint.upper:.3f} rad and the calibrated range "
                f"{calibrated.lower_rad:.3f} to {calibrated.upper_rad:.3f} rad do not overlap",
            )
        fastest = abs(calibrated.rad_s_from_ticks_s(FASTEST_TICKS_S)) / CATCHING_UP
        if joint.max_velocity > fastest:
            log.warning(
                "joint %s: its velocity limit of %g rad/s is narrowed to %.2f rad/s, the most its servo can follow",
                joint.name,
                joint.max_velocity,
                fastest,
            )
        max_velocity = min(joint.max_velocity, fastest)
        joints[joint.name] = replace(joint, lower=lower, upper=upper, max_velocity=max_velocity)
    return replace(robot, joints=joints)


@dataclass(frozen=True)
class JointBounds:
    """Limits that the controller keeps."""

    lower_rad: Vector  # lower soft limits, shape (joints,) [rad]
    upper_rad: Vector  # upper soft limits, shape (joints,) [rad]
    max_velocity: Vector  # velocity limits, shape (joints,) [rad/s]
    max_acceleration: Vector  # acceleration limits, shape (joints,) [rad/s^2]

    @classmethod
    def of(cls, robot: RobotModel, joint_names: tuple[str, ...]) -> JointBounds:
        """Collect the limits of the robot's joints, in the order of the names."""
        joints = [robot.joints[name] for name in joint_names]
        return cls(
            lower_rad=np.array([joint.lower for joint in joints]),
            upper_rad=np.array([joint.upper for joint in joints]),
            max_velocity=np.array([joint.max_velocity for joint in joints]),
            max_acceleration=np.array([joint.max_acceleration for joint in joints]),
        )

    def of_columns(self, columns: NDArray[np.intp]) -> JointBounds:
        """Select the limits of some joints by their indices in the arrays."""
        return JointBounds(
            self.lower_rad[columns], self.upper_rad[columns], self.max_velocity[columns], self.max_acceleration[columns]
        )

    def within_servos(self, calibration: Calibration, limits_ticks: Mapping[int, tuple[int, int]]) -> JointBounds:
        """Narrow the soft limits to the servos' own limits of goals by id [ticks], less the margin.

        Raises DescriptionError where nothing is left of a joint's range.
        """
        ranges = []
        for joint in calibration.joints:
            low, high = sorted(map(joint.rad_from_ticks, limits_ticks[joint.servo_id]))
            ranges.append((low + END_STOP_MARGIN_RAD, high - END_STOP_MARGIN_RAD))
        lower = np.maximum(self.lower_rad, [low for low, _ in ranges])
        upper = np.minimum(self.upper_rad, [high for _, high in ranges])
        for joint, low, high in zip(calibration.joints, lower, upper, strict=True):
            if low >= high:
                raise DescriptionError(
                    f"servo {joint.servo_id} ({joint.joint})",
                    f"has the angle limits {limits_ticks[joint.servo_id]} ticks, which leave nothing of the "
                    "joint's range: write the calibration to the servos",
                )
        return replace(self, lower_rad=lower, upper_rad=upper)


def motion_limits(robot: RobotModel, joint_names: tuple[str, ...], speed_limit: float) -> MotionLimits:
    """Return the limits of motions of the robot's joints, with a share of their velocities."""
    joints, bounds = [robot.joints[name] for name in joint_names], JointBounds.of(robot, joint_names)
    jerk = np.array([np.inf if joint.max_jerk is None else joint.max_jerk for joint in joints])
    steepest = bounds.max_acceleration / TIME_TO_FULL_ACCELERATION_S
    return MotionLimits(speed_limit * bounds.max_velocity, bounds.max_acceleration, np.minimum(steepest, jerk))

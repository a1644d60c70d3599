"""The soft limits that planner and driver share: where the arm may go."""

from __future__ import annotations

from dataclasses import replace

from robot.calibration import Calibration
from robot.errors import DescriptionError
from robot.model import RobotModel

# Distance of the soft limits from the calibrated end stops: covers backlash (1 deg) and rounding.
END_STOP_MARGIN_RAD = 0.03


def within_calibration(robot: RobotModel, calibration: Calibration) -> RobotModel:
    """The robot with every joint's limits narrowed to what its calibration can reach, less a margin.

    Raises:
        DescriptionError: a calibrated joint is not a joint of the robot, or nothing is left of its range.
    """
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
        joints[joint.name] = replace(joint, lower=lower, upper=upper)
    return replace(robot, joints=joints)

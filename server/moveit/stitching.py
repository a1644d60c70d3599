"""Makes a given motion begin where the arm holds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.description.model import RobotModel
from robot.trajectory import Trajectory

# The arm may have moved so far since the motion was planned: backlash and droop of a client's measured start,
# and what the driver takes for the same place.
STITCH_TOLERANCE_RAD = 0.05

# Nearer starts are the same: half a servo tick.
SAME_RAD = 0.0008

# Share of the limits that the way to the start uses; it is short, and nobody asked for it.
STITCH_SHARE = 0.2

# Peak velocity and acceleration of a cubic from rest to rest, as multiples of way / time and way / time^2.
CUBIC_PEAK_VELOCITY, CUBIC_PEAK_ACCELERATION = 1.5, 6.0


def stitched(motion: Trajectory, held_rad: Mapping[str, float], robot: RobotModel) -> Trajectory | PlanningFailure:
    """Lead a motion in from where the arm holds, when that is near its start.

    Args:
        motion: begins somewhere near.
        held_rad: position of every joint of the motion [rad].
        robot: the arm, for its limits.

    Returns:
        The motion with the way to its start before it; a failure that names joint and numbers when it is too far.
    """
    held = np.array([held_rad[name] for name in motion.joint_names])
    away = np.abs(motion.positions_rad[0] - held)
    worst = int(np.argmax(away))
    if away[worst] > STITCH_TOLERANCE_RAD:
        return _too_far(motion, held, worst)
    if away[worst] <= SAME_RAD:
        return motion
    lead_s = _lead_s(motion.joint_names, away, robot)
    still = np.zeros((1, len(held)))
    return Trajectory(
        motion.joint_names,
        np.concatenate(([0.0], motion.time_s + lead_s)),
        np.vstack((held, motion.positions_rad)),
        np.vstack((still, motion.velocities_rad_s)),
        np.vstack((still, motion.accelerations_rad_s2)),
    )


def _lead_s(joint_names: tuple[str, ...], way_rad: np.ndarray, robot: RobotModel) -> float:
    """Time in which every joint gets so far, from rest, at a share of its limits [s]."""
    joints = [robot.joints[name] for name in joint_names]
    velocity = STITCH_SHARE * np.array([joint.max_velocity for joint in joints])
    acceleration = STITCH_SHARE * np.array([joint.max_acceleration for joint in joints])
    by_velocity = CUBIC_PEAK_VELOCITY * way_rad / velocity
    by_acceleration = np.sqrt(CUBIC_PEAK_ACCELERATION * way_rad / acceleration)
    return float(np.max(np.maximum(by_velocity, by_acceleration)))


def _too_far(motion: Trajectory, held: np.ndarray, worst: int) -> PlanningFailure:
    name = motion.joint_names[worst]
    start_rad, held_rad = float(motion.positions_rad[0, worst]), float(held[worst])
    return PlanningFailure(
        MoveItErrorCode.CONTROL_FAILED,
        f"the motion starts with joint {name} at {start_rad:.4f} rad, but the arm holds it at {held_rad:.4f} rad "
        f"(tolerance {STITCH_TOLERANCE_RAD} rad): plan it anew from here",
        {"joint": name, "start_rad": start_rad, "held_rad": held_rad, "tolerance_rad": STITCH_TOLERANCE_RAD},
    )

"""Splicing of trajectories: into the motion under way without a stop, and from where the arm holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.messages import ArmState, Course, Mode
from robot.model import RobotModel
from robot.trajectory import Trajectory

# The next motion leaves the present one so far ahead: planning takes a few milliseconds, on a busy machine some tens.
HORIZON_S = 0.16

# What remains of it for the way to the arm process and its next tick.
SENDING_S = 0.03

# What of the present motion is behind may be so much less than is known here: states come at 50 Hz.
STATE_AGE_S = 0.1


# The arm may have moved so far since the motion was planned: backlash and droop of a client's measured start,
# and what the driver takes for the same place.
STITCH_TOLERANCE_RAD = 0.05

# Nearer starts are the same: half a servo tick.
SAME_RAD = 0.0008

# Share of the limits that the way to the start uses; it is short, and nobody asked for it.
STITCH_SHARE = 0.2

# Peak velocity and acceleration of a cubic from rest to rest, as multiples of way / time and way / time^2.
CUBIC_PEAK_VELOCITY, CUBIC_PEAK_ACCELERATION = 1.5, 6.0


@dataclass(frozen=True)
class Branch:
    """Where another motion can leave the present one.

    Attributes:
        lead: the present motion from a little before now to where it is left, its time from 0 on.
        from_s: the time on the present motion at which the lead begins [s].
    """

    lead: Trajectory
    from_s: float

    @property
    def start_rad(self) -> dict[str, float]:
        """Where the joints are when the lead begins [rad]."""
        return dict(zip(self.lead.joint_names, self.lead.positions_rad[0].tolist(), strict=True))

    @property
    def positions_rad(self) -> dict[str, float]:
        """Where the joints are when the present motion is left [rad]."""
        return dict(zip(self.lead.joint_names, self.lead.positions_rad[-1].tolist(), strict=True))

    @property
    def velocities_rad_s(self) -> dict[str, float]:
        """How fast the joints move then [rad/s]."""
        return dict(zip(self.lead.joint_names, self.lead.velocities_rad_s[-1].tolist(), strict=True))

    def into(self, motion: Trajectory) -> Trajectory:
        """The lead and then a motion that begins at its end, of the same joints."""
        lead = self.lead
        return Trajectory(
            lead.joint_names,
            np.concatenate((lead.time_s, motion.time_s[1:] + lead.duration_s)),
            np.vstack((lead.positions_rad, motion.positions_rad[1:])),
            np.vstack((lead.velocities_rad_s, motion.velocities_rad_s[1:])),
            np.vstack((lead.accelerations_rad_s2, motion.accelerations_rad_s2[1:])),
        )


def branch_of(motion: Trajectory, state: ArmState, age_s: float) -> Branch | None:
    """Where the present motion can be left; None when it stands, goes back or is about to end.

    Args:
        motion: the present motion.
        state: the arm's latest.
        age_s: time since it came [s].
    """
    if state.mode is not Mode.MOVING or state.pace.course is not Course.FORWARD:
        return None
    now_s = state.fraction * motion.duration_s + age_s * state.pace.speed_factor
    leave_s = now_s + HORIZON_S * state.pace.speed_factor
    if state.pace.speed_factor == 0.0 or leave_s >= motion.duration_s:
        return None
    from_s = max(now_s - STATE_AGE_S, 0.0)
    return Branch(_between(motion, from_s, leave_s), from_s)


def _between(motion: Trajectory, from_s: float, to_s: float) -> Trajectory:
    """The part of a motion between two times; on it, it is the same curve."""
    inside = (motion.time_s > from_s) & (motion.time_s < to_s)
    first, last = motion.sample(from_s), motion.sample(to_s)
    arrays = (motion.positions_rad, motion.velocities_rad_s, motion.accelerations_rad_s2)
    columns = [np.vstack((first[i], array[inside], last[i])) for i, array in enumerate(arrays)]
    time_s = np.concatenate(([0.0], motion.time_s[inside] - from_s, [to_s - from_s]))
    return Trajectory(motion.joint_names, time_s, *columns)


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

"""From one motion into the next without a stop: where the next may begin, and how the two become one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robot.messages import ArmState, Course, Mode
from robot.trajectory import Trajectory

# The next motion leaves the present one so far ahead: planning takes a few milliseconds, on a busy machine some tens.
HORIZON_S = 0.16

# What remains of it for the way to the arm process and its next tick.
SENDING_S = 0.03

# What of the present motion is behind may be so much less than is known here: states come at 50 Hz.
STATE_AGE_S = 0.1


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

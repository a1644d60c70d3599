"""Thresholds of the controller for each joint, which follow from the strength to which its actuator is set.

A servo with half the position gain droops twice as far, and a servo that protects itself from 25 % of its torque on
must not be asked to hold with more. The settings of the program hold for servos as the factory leaves them; here they
are adapted to the servos that were found. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from robot.hardware.interface import Actuation
from robot.messages import GuardLimits
from robot.trajectory import Vector

# Of the distance at which a joint counts as being at its goal, 0.06 rad, a third is backlash (0.9 to 1.0 deg were
# measured); the rest is droop under load (1.8 to 2.6 deg), in inverse proportion to the gain.
DROOP_SHARE = 2.0 / 3.0
LARGEST_TOLERANCE_RAD = 0.3

# A protection is kept at this distance: its threshold is compared with a load that is measured in steps of 0.1 % and
# that ripples.
MARGIN = 0.8

# A joint that is loaded beyond its protection's threshold is relieved after this share of the protection's time.
RELIEF_SHARE = 0.5

# A stall is reported well before the protection of the servo latches.
STALL_SHARE = 0.25


@dataclass(frozen=True)
class ActuatorThresholds:
    """Thresholds of the joints, each of shape (joints,)."""

    goal_tolerance_rad: Vector  # greatest distance of a settled joint from its goal [rad]
    sustained_torque: Vector  # share of full duty that a joint may use for ever
    # Time above it after which a joint is limited to it; infinite where that is never needed [s].
    relieve_after_s: Vector
    stall_current_a: Vector  # current above which a joint that all but stands still is stalled [A]
    stall_time_s: Vector  # time for which that must last [s]
    free_speed_rad_s: Vector  # greatest speed of the joint [rad/s]
    jump_rad: Vector  # way beyond which two readings in a row are no motion [rad]

    @classmethod
    def of(cls, limits: GuardLimits, actuation: Actuation, full_torque: Vector) -> Self:
        """Adapt the program's limits to the actuators."""
        # A higher gain than the factory's does not make the gears stiffer.
        softness = 1.0 / np.clip(actuation.stiffness, 1e-2, 1.0)
        tolerance = limits.goal_tolerance_rad * (1.0 + DROOP_SHARE * (softness - 1.0))
        threshold = np.minimum(actuation.overload_torque, actuation.overload_current_a / actuation.stall_current_a)
        within = threshold >= full_torque
        return cls(
            goal_tolerance_rad=np.minimum(tolerance, max(LARGEST_TOLERANCE_RAD, limits.goal_tolerance_rad)),
            sustained_torque=np.where(within, full_torque, np.minimum(MARGIN * threshold, full_torque)),
            relieve_after_s=np.where(within, np.inf, RELIEF_SHARE * actuation.overload_time_s),
            stall_current_a=np.minimum(limits.stall_current_a, MARGIN * actuation.overload_current_a),
            stall_time_s=np.minimum(limits.stall_time_s, STALL_SHARE * actuation.overload_time_s),
            free_speed_rad_s=actuation.free_speed_rad_s,
            jump_rad=actuation.jump_rad,
        )

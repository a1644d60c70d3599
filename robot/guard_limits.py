"""How hard the servos may push, and what is borne before a motion has failed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GuardLimits:
    """How far, how much and how long.

    Attributes:
        torque_limit: share of full duty that the servos may use, register TORQUE_LIMIT.
        gripper_torque_limit: the same for that of the gripper.
        tracking_error_rad: a joint this far behind its goal is lost [rad].
        tracking_time_s: for so long it may be [s].
        stall_current_a: a servo that draws more and all but stands still is stalled [A].
        stall_time_s: for so long it may be [s].
        min_voltage_v: less is a fault [V].
        goal_tolerance_rad: how near its joints must come to the end of a motion [rad].
        settle_timeout_s: time for that, from the end of the motion on [s].
    """

    # Less than all, so that a servo's own overload protection stays the last resort.
    torque_limit: float = 0.8
    # So that it does not burn on its grip.
    gripper_torque_limit: float = 0.5
    tracking_error_rad: float = 0.35
    tracking_time_s: float = 0.2
    # 60 % of the stall current.
    stall_current_a: float = 1.5
    # Well before the servo's own overload timer of 2 s runs out.
    stall_time_s: float = 0.3
    # The electronics of a 7.4 V servo reset not far below.
    min_voltage_v: float = 4.5
    # Backlash (0.9-1.0 deg) plus droop under load (1.8-2.6 deg) of real arms.
    goal_tolerance_rad: float = 0.06
    settle_timeout_s: float = 1.0

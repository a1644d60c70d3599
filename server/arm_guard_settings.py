"""The settings of the section ``arm.guards``: how hard the servos push, and what a motion may not do."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from robot.messages import GuardLimits

_DEFAULT = GuardLimits()


class GuardSettings(BaseModel):
    """How hard the servos may push, and what is borne before a motion has failed.

    Attributes:
        torque_limit: share of full motor duty that each servo may use; less is gentler, and carries less.
        gripper_torque_limit: the same for that of the gripper.
        tracking_error_rad: a joint that is farther behind its goal is lost, which is a fault [rad].
        tracking_time_s: for so long it may be [s].
        stall_current_a: a servo that draws more and all but stands still is stalled, which is a fault, or a grip [A].
        stall_time_s: for so long it may be; the servo's own protection latches after 2 s [s].
        min_voltage_v: a supply below is a fault; 9 V are right for servos of 12 V [V].
        goal_tolerance_rad: how near each joint must come to the end of its motion [rad].
        settle_timeout_s: time for that, after which the motion has failed; less than
            ``moveit.allowed_goal_duration_margin`` [s].
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    torque_limit: float = Field(default=_DEFAULT.torque_limit, ge=0.3, le=0.8)
    gripper_torque_limit: float = Field(default=_DEFAULT.gripper_torque_limit, ge=0.2, le=0.5)
    tracking_error_rad: float = Field(default=_DEFAULT.tracking_error_rad, ge=0.1, le=1.0)
    tracking_time_s: float = Field(default=_DEFAULT.tracking_time_s, ge=0.05, le=1.0)
    stall_current_a: float = Field(default=_DEFAULT.stall_current_a, ge=0.3, le=2.7)
    stall_time_s: float = Field(default=_DEFAULT.stall_time_s, ge=0.1, le=1.5)
    min_voltage_v: float = Field(default=_DEFAULT.min_voltage_v, ge=4.0, le=11.0)
    goal_tolerance_rad: float = Field(default=_DEFAULT.goal_tolerance_rad, ge=0.02, le=0.3)
    settle_timeout_s: float = Field(default=_DEFAULT.settle_timeout_s, ge=0.1, le=10.0)

    def limits(self) -> GuardLimits:
        """The same as the arm process has it."""
        return GuardLimits(**self.model_dump())

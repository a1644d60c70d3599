"""Whether the arm can take a motion now, and what to do when it cannot."""

from __future__ import annotations

from typing import Protocol

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.messages import ArmState, Mode
from server.arm.services import ENABLE, RESET_FAULT

# Starting an interpreter, opening the bus, checking six servos and raising torque takes 1.2 s. Where other programs use
# every core, it has taken more than 15 s.
ARM_START_TIMEOUT_S = 60.0


class ReadArm(Protocol):
    """The arm, as `robot.arm.Arm`."""

    state: ArmState
    state_max_age_s: float

    @property
    def state_age_s(self) -> float:
        """Time since the latest state came [s]."""


def unusable(arm: ReadArm) -> PlanningFailure | None:
    """Return why no motion can begin now, with the remedy; None when one can."""
    state, age_s = arm.state, arm.state_age_s
    if state.mode is Mode.DISCONNECTED:
        return PlanningFailure(MoveItErrorCode.COMMUNICATION_FAILURE, f"the arm is not connected: {state.reason}")
    if age_s > arm.state_max_age_s:
        return PlanningFailure(
            MoveItErrorCode.ROBOT_STATE_STALE,
            f"the last state of the arm is {age_s:.1f} s old (limit {arm.state_max_age_s:g} s)",
        )
    if state.fault is not None:
        return PlanningFailure(
            MoveItErrorCode.CONTROL_FAILED,
            f"the arm has a fault: {state.fault} The service that resets it is {RESET_FAULT}.",
        )
    if state.mode is Mode.CONNECTED or state.goal_rad is None:
        reason = state.reason or "its servos are being checked"
        return PlanningFailure(MoveItErrorCode.COMMUNICATION_FAILURE, f"the arm is not ready: {reason}")
    if state.mode is Mode.RELAXED:
        return PlanningFailure(
            MoveItErrorCode.CONTROL_FAILED, f"the arm is relaxed: enable it by the service {ENABLE} first"
        )
    return None

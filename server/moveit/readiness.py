"""Whether the arm can take a motion now, and what to do when it cannot."""

from __future__ import annotations

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.messages import ArmState, Mode
from server.arm_services import ENABLE, RESET_FAULT

# Opening the bus, checking six servos and raising torque takes 0.7 s; a machine under load takes longer.
ARM_START_TIMEOUT_S = 15.0

# States come at 50 Hz; one this old means that the arm process is stuck.
STATE_MAX_AGE_S = 1.0


def unusable(state: ArmState, age_s: float) -> PlanningFailure | None:
    """Why no motion can begin from this state of the arm, with the remedy; None when one can.

    Args:
        state: the latest.
        age_s: time since it came [s].
    """
    if state.mode is Mode.DISCONNECTED:
        return PlanningFailure(MoveItErrorCode.COMMUNICATION_FAILURE, f"the arm is not connected: {state.reason}")
    if age_s > STATE_MAX_AGE_S:
        return PlanningFailure(
            MoveItErrorCode.ROBOT_STATE_STALE,
            f"the last state of the arm is {age_s:.1f} s old (limit {STATE_MAX_AGE_S:g} s)",
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

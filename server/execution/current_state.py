"""Current state of the arm: the positions that motions are planned from, and its readiness for a motion."""

from __future__ import annotations

import time
from typing import Any, Protocol

from planners.problem import MoveItErrorCode, PlanningFailure
from protocol.messages import Stamp
from robot.description.model import RobotModel
from robot.messages import ArmState, Mode
from server.arm.services import ENABLE, RESET_FAULT
from server.errors import RefusedError

# Starting an interpreter, opening the bus, checking six servos and raising torque takes 1.2 s. Where other programs use
# every core, it has taken more than 15 s.
ARM_START_TIMEOUT_S = 60.0


class StatedArm(Protocol):
    """Arm with a state, as `robot.arm.Arm`."""

    @property
    def state(self) -> ArmState:
        """The latest state."""


class CurrentState:
    """Current joint positions.

    Args:
        arm: the started arm.
        robot: its description.
    """

    def __init__(self, arm: StatedArm, robot: RobotModel) -> None:
        self._arm = arm
        self._frame = robot.root_link

    def positions_rad(self) -> dict[str, float] | None:
        """Return the position of every movable joint [rad]; None while they are unknown.

        These are the positions that the arm holds, not those it droops to: a motion from there starts without a step.
        """
        state = self._arm.state
        positions = state.position_rad if state.goal_rad is None else state.goal_rad
        return None if positions is None else dict(zip(state.joint_names, positions.tolist(), strict=True))

    def message(self) -> dict[str, Any]:
        """Return them as a moveit_msgs/RobotState without attached objects; without joints while they are unknown."""
        return state_message(self.positions_rad() or {}, self._frame, time.time())


def state_message(positions_rad: dict[str, float], frame: str, stamp_s: float) -> dict[str, Any]:
    """Return the moveit_msgs/RobotState of joints that stand still.

    Args:
        positions_rad: by joint [rad].
        frame: the planning frame.
        stamp_s: wall-clock time [s].
    """
    stamp = Stamp.from_seconds(stamp_s).as_message()
    header = {"stamp": stamp, "frame_id": frame}
    return {
        "joint_state": {
            "header": header,
            "name": list(positions_rad),
            "position": list(positions_rad.values()),
            "velocity": [],
            "effort": [],
        },
        "multi_dof_joint_state": {
            "header": header,
            "joint_names": [],
            "transforms": [],
            "twist": [],
            "wrench": [],
        },
        "attached_collision_objects": [],
        "is_diff": False,
    }


class ReadArm(Protocol):
    """Arm with a state and its age, as `robot.arm.Arm`."""

    state: ArmState
    state_max_age_s: float

    @property
    def state_age_s(self) -> float:
        """Time since the latest state came [s]."""


def check_ready(arm: ReadArm) -> None:
    """Check that a motion can begin now.

    Raises:
        RefusedError: none can; its sentence names the remedy.
    """
    state, age_s = arm.state, arm.state_age_s
    if state.mode is Mode.DISCONNECTED:
        raise _not_ready(MoveItErrorCode.COMMUNICATION_FAILURE, f"the arm is not connected: {state.reason}")
    if age_s > arm.state_max_age_s:
        raise _not_ready(
            MoveItErrorCode.ROBOT_STATE_STALE,
            f"the last state of the arm is {age_s:.1f} s old (limit {arm.state_max_age_s:g} s)",
        )
    if state.fault is not None:
        raise _not_ready(
            MoveItErrorCode.CONTROL_FAILED,
            f"the arm has a fault: {state.fault} The service that resets it is {RESET_FAULT}.",
        )
    if state.mode is Mode.CONNECTED or state.goal_rad is None:
        reason = state.reason or "its servos are being checked"
        raise _not_ready(MoveItErrorCode.COMMUNICATION_FAILURE, f"the arm is not ready: {reason}")
    if state.mode is Mode.RELAXED:
        raise _not_ready(MoveItErrorCode.CONTROL_FAILED, f"the arm is relaxed: enable it by the service {ENABLE} first")


def _not_ready(code: MoveItErrorCode, message: str) -> RefusedError:
    return RefusedError(PlanningFailure(code, message))

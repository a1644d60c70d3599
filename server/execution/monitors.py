"""Present state for execution: the arm's positions, its readiness, and the planning scene."""

from collections.abc import Callable, Collection, Mapping
from typing import Any

from planners.problem import MoveItErrorCode
from planners.scene import EMPTY_SCENE
from protocol.messages import Stamp
from robot.arm_group import AnyArm, ArmGroup, states_of
from robot.messages import Mode
from server.errors import refused

# Services that refusals name as the remedy.
ENABLE, RESET_FAULT = "/arm/enable", "/arm/reset_fault"

# Starting an interpreter, opening the bus, checking six servos and raising torque takes 1.2 s. Where other programs use
# every core, it has taken more than 15 s.
ARM_START_TIMEOUT_S = 60.0


class CurrentState:
    """Current joint positions."""

    def __init__(self, arm: AnyArm) -> None:
        self._arm = arm

    def positions_rad(self) -> dict[str, float] | None:
        """Return the position of every movable joint [rad]; None while they are unknown.

        These are the positions that the arm holds, not those it droops to: a motion from there starts without a step.
        """
        state = self._arm.state
        positions = state.position_rad if state.goal_rad is None else state.goal_rad
        if positions is None:
            return None
        return dict(zip(state.joint_names, positions.tolist(), strict=True))

    def speed_limit(self, joint_names: Collection[str]) -> float:
        """Return the share of the velocity limits that motions of some joints may use."""
        return self._arm.part(joint_names).state.pace.speed_limit

    @property
    def stamp_s(self) -> float:
        """Time of the latest state [s since the epoch]; of the arm's clock where that is faster than the machine's."""
        return self._arm.state.stamp_s


def joint_state_message(positions_rad: Mapping[str, float], stamp_s: float, frame: str = "") -> dict[str, Any]:
    """Return the sensor_msgs/JointState of positions alone."""
    header = {"stamp": Stamp.from_seconds(stamp_s).as_message(), "frame_id": frame}
    names, positions = list(positions_rad), list(positions_rad.values())
    return {"header": header, "name": names, "position": positions, "velocity": [], "effort": []}


def state_message(positions_rad: Mapping[str, float], frame: str, stamp_s: float) -> dict[str, Any]:
    """Return the moveit_msgs/RobotState of joints that stand still."""
    header = {"stamp": Stamp.from_seconds(stamp_s).as_message(), "frame_id": frame}
    return {
        "joint_state": joint_state_message(positions_rad, stamp_s, frame),
        "multi_dof_joint_state": {"header": header, "joint_names": [], "transforms": [], "twist": [], "wrench": []},
        "attached_collision_objects": [],
        "is_diff": False,
    }


def check_ready(arm: AnyArm) -> None:
    """Check that a motion can begin now; a refusal names one of several arms, and the service of this arm."""
    states, age_s = states_of(arm), arm.state_age_s
    for name, state in states.items():
        if state.mode is Mode.DISCONNECTED:
            message = f"{title_of(name)} is not connected: {state.reason}"
            raise refused(MoveItErrorCode.COMMUNICATION_FAILURE, message)
    if age_s > arm.state_max_age_s:
        raise refused(
            MoveItErrorCode.ROBOT_STATE_STALE,
            f"the last state of the arm is {age_s:.1f} s old (limit {arm.state_max_age_s:g} s)",
        )
    leaders = arm.leaders if isinstance(arm, ArmGroup) else frozenset[str]()
    for name, state in states.items():
        # While a leader is relaxed, it keeps no other arm from moving.
        if name not in leaders or state.mode is not Mode.RELAXED:
            title, prefix = title_of(name), name and f"/{name}"
            if state.fault is not None:
                text = f"{title} has a fault: {state.fault} The service that resets it is {prefix}{RESET_FAULT}."
                raise refused(MoveItErrorCode.CONTROL_FAILED, text)
            if state.mode is Mode.CONNECTED or state.goal_rad is None:
                reason = state.reason or "its servos are being checked"
                raise refused(MoveItErrorCode.COMMUNICATION_FAILURE, f"{title} is not ready: {reason}")
            if state.mode is Mode.RELAXED:
                text = f"{title} is relaxed: enable it by the service {prefix}{ENABLE} first"
                raise refused(MoveItErrorCode.CONTROL_FAILED, text)


def title_of(name: str) -> str:
    """Return the words for an arm in a sentence, from its name, which is empty for a lone arm."""
    return f"the arm {name}" if name else "the arm"


class CurrentScene:
    """Current planning scene as planners have it; another object, with another version, after every change."""

    def __init__(self) -> None:
        self.scene = EMPTY_SCENE
        self._callbacks: list[Callable[[], None]] = []

    def on_change(self, callback: Callable[[], None]) -> None:
        """Call ``callback`` after every change, also after changes that planners do not see."""
        self._callbacks.append(callback)

    def changed(self) -> None:
        for callback in self._callbacks:
            callback()

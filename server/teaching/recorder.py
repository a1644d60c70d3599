"""Recorder of one motion that is taught: takes the arm's states, and says when the recording has to end."""

from __future__ import annotations

import numpy as np

from robot.description.model import RobotModel
from robot.messages import ArmState, Mode
from robot.trajectory import Vector
from server.errors import ServiceError
from server.teaching.taught_motion import MAX_DURATION_S

# The arm's states come at most at this rate; of more the rest is left out.
MAX_RATE_HZ = 100.0


class TeachingRecorder:
    """Recording of some joints: of the arm's measured positions while it is relaxed, else of its commanded ones.

    Time is the control loop's, which a simulated arm on a busy machine does not outrun.
    """

    def __init__(self, name: str, joint_names: tuple[str, ...]) -> None:
        self.name = name
        self.joint_names = joint_names
        self._time_s: list[float] = []
        self._positions_rad: list[Vector] = []

    @property
    def duration_s(self) -> float:
        """Time that has been recorded [s]."""
        return self._time_s[-1] - self._time_s[0] if self._time_s else 0.0

    @property
    def points(self) -> int:
        """Number of positions that have been recorded."""
        return len(self._time_s)

    @property
    def samples(self) -> tuple[Vector, Vector]:
        """Times, shape (n,) [s], and positions, shape (n, joints) [rad]."""
        return np.array(self._time_s), np.array(self._positions_rad).reshape(len(self._time_s), len(self.joint_names))

    def take_state(self, state: ArmState) -> str:
        """Record a state; return the reason for which the recording ends with it, empty to go on."""
        if state.fault is not None:
            return f"the arm has a fault: {state.fault}"
        if state.mode is Mode.DISCONNECTED or state.position_rad is None:
            return f"the arm is not connected: {state.reason}" if state.reason else "the arm is not connected"
        if self._time_s and state.clock_s < self._time_s[-1]:
            return "the arm was started again"
        if self._time_s and state.clock_s - self._time_s[-1] < 0.5 / MAX_RATE_HZ:
            return ""
        if self._time_s and state.clock_s - self._time_s[0] > MAX_DURATION_S:
            return f"a recording lasts {MAX_DURATION_S:g} s at most"
        held_rad = state.goal_rad if state.torque_enabled and state.goal_rad is not None else state.position_rad
        self._time_s.append(state.clock_s)
        self._positions_rad.append(held_rad[[state.joint_names.index(name) for name in self.joint_names]])
        return ""


def joints_to_teach(robot: RobotModel, group: str) -> tuple[str, ...]:
    """Return the joints to record: a group's joints; without a name the default group's and the gripper's."""
    if group:
        if group not in robot.groups:
            raise ServiceError(f"group: must be one of {', '.join(robot.groups)}, not {group[:80]!r}")
        return robot.groups[group].joints
    joints = robot.groups[robot.default_group].joints
    gripper = robot.gripper.joints if robot.gripper is not None else ()
    return (*joints, *(name for name in gripper if name not in joints))

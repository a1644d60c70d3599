"""The arm's present state, as those see it who plan from it or ask for it."""

from __future__ import annotations

import time
from typing import Any, Protocol

from protocol.messages import Stamp
from robot.description.model import RobotModel
from robot.messages import ArmState


class StatedArm(Protocol):
    """What is asked of the arm here."""

    @property
    def state(self) -> ArmState:
        """The latest state."""


class CurrentState:
    """Tells where the joints are.

    Args:
        arm: the started arm.
        robot: its description.
    """

    def __init__(self, arm: StatedArm, robot: RobotModel) -> None:
        self._arm = arm
        self._frame = robot.root_link

    def positions_rad(self) -> dict[str, float] | None:
        """Position of every movable joint [rad], None while it is not known.

        What the arm holds is told, not where it droops to: a motion from there starts without a step.
        """
        state = self._arm.state
        positions = state.position_rad if state.goal_rad is None else state.goal_rad
        return None if positions is None else dict(zip(state.joint_names, positions.tolist(), strict=True))

    def message(self) -> dict[str, Any]:
        """The moveit_msgs/RobotState of it, without what is attached; without joints while they are not known."""
        return state_message(self.positions_rad() or {}, self._frame, time.time())


def state_message(positions_rad: dict[str, float], frame: str, stamp_s: float) -> dict[str, Any]:
    """A moveit_msgs/RobotState of joints that stand still.

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

"""The gripper of an arm, for programs with an event loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from armbridge_client.connection import Connection
from armbridge_client.errors import ArmError, GoalRefused
from armbridge_client.messages import (
    GripperCommand,
    GripperCommandGoal,
    GripperCommandResult,
    KinematicSolverInfo,
    MoveItErrorCode,
)
from armbridge_client.wire import from_wire

GRIPPER_TIMEOUT_S = 15.0


@dataclass(frozen=True)
class Grip:
    """End of a gripper's motion: its position [rad or m], and True if an object stopped it, which it now holds."""

    position: float
    holds: bool


class AsyncGripper:
    """Gripper of an arm; a new motion replaces the one in progress.

    Args:
        prefix: the arm's name behind a slash; empty for the only arm.
        joints: of the gripper; empty for an arm without one.
    """

    def __init__(self, connection: Connection, prefix: str, joints: Sequence[str]) -> None:
        self._connection = connection
        self._prefix = prefix
        self._joints = joints
        self._range: tuple[float, float] | None = None

    async def open(self, force: float = 0.0, *, timeout_s: float = GRIPPER_TIMEOUT_S) -> Grip:
        """Open the gripper to its limit. As :meth:`move`."""
        return await self.move((await self.range())[1], force, timeout_s=timeout_s)

    async def close(self, force: float = 0.0, *, timeout_s: float = GRIPPER_TIMEOUT_S) -> Grip:
        """Close the gripper until an object or its limit stops it. As :meth:`move`."""
        return await self.move((await self.range())[0], force, timeout_s=timeout_s)

    async def move(self, position: float, force: float = 0.0, *, timeout_s: float = GRIPPER_TIMEOUT_S) -> Grip:
        """Move the gripper to a position [rad, or m between sliding fingers].

        Args:
            force: share of the full motor duty, 0 to 0.5; 0 for the most that the server allows.

        Raises:
            GoalRefused: a stop, a cancel or another goal ended the motion.
            RequestRefused: the position is beyond the limits, or a fault ended the motion.
        """
        goal = GripperCommandGoal(GripperCommand(float(position), float(force)))
        values = await self._connection.perform(f"{self._prefix}/gripper_controller/gripper_cmd", goal, timeout_s)
        result = from_wire(GripperCommandResult, values)
        if not (result.reached_goal or result.stalled):
            failed = MoveItErrorCode.PREEMPTED
            sentence = f"the gripper was stopped at {result.position:.3f} by a stop, a cancel or another goal"
            raise GoalRefused(failed.value, failed.name, sentence, {}, None)
        return Grip(result.position, result.stalled)

    async def range(self) -> tuple[float, float]:
        """Return the closed and the open position [rad, or m between sliding fingers]."""
        if self._range is None:
            async with self._connection.subscribe(f"{self._prefix}/arm/joint_limits", KinematicSolverInfo) as infos:
                limits = [each for each in (await infos.__anext__()).limits if each.joint_name in self._joints]
            if not limits:
                raise ArmError("the arm has no gripper")
            # The position of two sliding fingers is the gap between them, the sum of both (docs/goals.md).
            self._range = sum(each.min_position for each in limits), sum(each.max_position for each in limits)
        return self._range

"""Following of a gripper: its fingers go where they are led, and grip where they stall."""

import asyncio
import contextlib
from collections.abc import Callable

import numpy as np

from robot.messages import Outcome
from robot.trajectory import Vector
from server.errors import RefusedError
from server.execution.goal import CancelScope
from server.lifecycle import end_task
from server.moveit.actions.gripper import Gripper
from server.teleop.following import TrackingLimits, tracking_velocity

# Once it has gripped, or another client has moved it, the gripper follows again when its lead has gone so far [rad].
STEP_RAD = 0.02

# Goals of the gripper are read a tick late, and its velocities take effect a tick later.
LATENCY_S = 0.02


class GripperFollowing:
    """Following of a gripper, one task at a time; ``lead`` returns position [rad or m] and velocity to follow now."""

    def __init__(self, gripper: Gripper, limits: TrackingLimits, lead: Callable[[], tuple[float, float]]) -> None:
        self._gripper, self._limits, self._lead = gripper, limits, lead
        self._claim: CancelScope | None = None
        self._task: asyncio.Task[None] | None = None
        # Position of the lead when the gripper stopped to follow.
        self._left_at: float | None = None

    def go_on(self) -> None:
        """Follow the lead, unless the gripper follows already, or has gripped and the lead stands."""
        if self._task is not None and not self._task.done():
            return
        if self._left_at is not None and abs(self._lead()[0] - self._left_at) < STEP_RAD:
            return
        self._claim = self._gripper.claim()
        self._task = asyncio.create_task(self._steer(self._claim), name="the gripper's following")

    def end(self, reason: str) -> None:
        if self._claim is not None:
            self._claim.cancel(reason)
        self._left_at = None

    async def close(self) -> None:
        """End at once; the gripper comes to rest by itself."""
        await end_task(self._task)

    async def _steer(self, claim: CancelScope) -> None:
        # A refusal is one of the whole arm, whose motions are refused as well.
        with contextlib.suppress(RefusedError):
            ended = await self._gripper.follow(claim, self._velocities)
            # After a pause of the server's own it goes on at once.
            self._left_at = None if ended.outcome is Outcome.UNSTEERED else self._lead()[0]

    def _velocities(self, goals: Vector) -> Vector:
        position, velocity = self._lead()
        return np.array([tracking_velocity(position - goal, velocity, self._limits, LATENCY_S) for goal in goals])

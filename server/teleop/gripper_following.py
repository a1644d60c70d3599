"""Following of a gripper: its fingers go where they are led, and grip where they stall."""

import asyncio
from collections.abc import Callable

import numpy as np

from robot.messages import Outcome
from robot.trajectory import Vector
from server.errors import RefusedError
from server.execution.goal import CancelScope
from server.lifecycle import end_task
from server.moveit.actions.gripper import Gripper
from server.teleop.following import TrackingLimits, tracking_velocity

# Distance of its lead after which a gripper that has gripped, or was moved by another client, follows again [rad].
STEP_RAD = 0.02

# Period in which it looks for that [s].
LOOK_S = 0.02

# Goals of the gripper are read a tick late, and its velocities take effect a tick later.
LATENCY_S = 0.02


class GripperFollowing:
    """Following of a gripper; ``lead`` returns position [rad or m] and velocity to follow now, None at its end."""

    def __init__(
        self, gripper: Gripper, limits: TrackingLimits, lead: Callable[[], tuple[float, float] | None]
    ) -> None:
        self._gripper, self._limits, self._lead = gripper, limits, lead
        self._claim: CancelScope | None = None
        self._task: asyncio.Task[None] | None = None
        self._over = False

    def start(self) -> None:
        """Follow the lead from now on, for the request in progress, unless the gripper follows already."""
        self._over = False
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._run(), name="the gripper's following")

    def end(self, reason: str) -> None:
        self._over = True
        if self._claim is not None:
            self._claim.cancel(reason)

    async def close(self) -> None:
        """End at once; the gripper comes to rest by itself."""
        await end_task(self._task)

    async def _run(self) -> None:
        left_at: float | None = None  # position of the lead when the gripper stopped to follow
        while not self._over and (lead := self._lead()) is not None:
            if left_at is not None and abs(lead[0] - left_at) < STEP_RAD:
                await asyncio.sleep(LOOK_S)
                continue
            self._claim = self._gripper.claim()
            try:
                ended = await self._gripper.follow(self._claim, self._velocities)
            except RefusedError:
                # A refusal is of the whole arm, whose motions are refused as well.
                return
            # After a pause of the server's own it goes on at once.
            left_at = None if ended.outcome is Outcome.UNSTEERED else (self._lead() or lead)[0]

    def _velocities(self, goals: Vector) -> Vector:
        lead = self._lead()
        if lead is None:
            self.end("nothing leads the gripper any more")
            return np.zeros_like(goals)
        position, velocity = lead
        return np.array([tracking_velocity(position - goal, velocity, self._limits, LATENCY_S) for goal in goals])

"""Targets of a gripper, which chunks have beside the arm's targets."""

import asyncio
from collections.abc import Callable

import numpy as np

from server.chunks.targets import SAMPLE_S, Targets
from server.moveit.actions.gripper import Gripper
from server.teleop.following import TrackingLimits
from server.teleop.gripper_following import LATENCY_S, GripperFollowing

# The gripper has come to its last target by then, or holds something [s].
SETTLES_S = 1.0

# Period in which a gripper that has gripped looks for a target that leads it on [s].
PERIOD_S = 0.05


class GripperTargets:
    """Following of targets by a gripper's fingers, one task at a time."""

    def __init__(self, gripper: Gripper, clock: Callable[[], float]) -> None:
        joint = gripper.joints[0]
        self.joint, self._clock = joint.name, clock
        limits = TrackingLimits(joint.max_velocity, joint.max_acceleration)
        self._following = GripperFollowing(gripper, limits, self._lead)
        self._targets: Targets | None = None
        self._task: asyncio.Task[None] | None = None

    def follow(self, targets: Targets) -> None:
        """Follow targets of the first finger from now on, for the request in progress."""
        self._targets = targets
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._run(), name="the gripper's targets")

    def end(self, reason: str) -> None:
        """Follow no more targets; the gripper holds."""
        if self._task is not None:
            self._task.cancel()
        self._following.end(reason)

    async def close(self) -> None:
        self.end("the server is ending")
        await self._following.close()

    async def _run(self) -> None:
        while self._targets is not None and self._clock() < self._targets.end_s + SETTLES_S:
            self._following.go_on()
            await asyncio.sleep(PERIOD_S)
        self._following.end("the chunk has ended")

    def _lead(self) -> tuple[float, float]:
        if self._targets is None:
            raise AssertionError("a gripper without targets is led")
        at_s = self._clock() + LATENCY_S
        position, ahead = self._targets.at(np.array([at_s, at_s + SAMPLE_S]))[:, 0].tolist()
        return position, (ahead - position) / SAMPLE_S

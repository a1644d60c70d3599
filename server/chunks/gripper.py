"""Following of the targets of a gripper, which chunks have beside the arm's targets; a finger that stalls grips."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

import numpy as np

from robot.trajectory import Vector
from server.chunks.targets import SAMPLE_S, Targets
from server.errors import RefusedError
from server.execution.goal import CancelScope
from server.moveit.actions.gripper import Gripper
from server.teleop.following import TrackingLimits, tracking_velocity

# Goals of the gripper are read a tick late, and its velocities take effect a tick later [s].
LATENCY_S = 0.02

# The gripper has come to its last target by then, or holds something [s].
SETTLES_S = 1.0


class GripperTargets:
    """Following of targets by a gripper, one task at a time."""

    def __init__(self, gripper: Gripper, clock: Callable[[], float]) -> None:
        self._gripper, self._clock = gripper, clock
        joint = gripper.joints[0]
        self._limits = TrackingLimits(joint.max_velocity, joint.max_acceleration)
        self._targets: Targets | None = None
        self._claim: CancelScope | None = None
        self._task: asyncio.Task[None] | None = None

    def follow(self, targets: Targets) -> None:
        """Follow targets of the gripper's first joint from now on."""
        self._targets = targets
        if self._task is None or self._task.done():
            self._claim = self._gripper.claim()
            self._task = asyncio.create_task(self._run(self._claim), name="the gripper's chunks")

    def end(self, reason: str) -> None:
        """Hold."""
        if self._claim is not None:
            self._claim.cancel(reason)

    async def close(self) -> None:
        """End at once."""
        self.end("the server is ending")
        if self._task is not None:
            await asyncio.wait((self._task,))

    async def _run(self, claim: CancelScope) -> None:
        # A refusal is one of the whole arm, whose chunks are refused as well.
        with contextlib.suppress(RefusedError):
            await self._gripper.follow(claim, lambda goals: self._velocities(claim, goals))

    def _velocities(self, claim: CancelScope, goals: Vector) -> Vector:
        targets, at_s = self._targets, self._clock() + LATENCY_S
        if targets is None:
            return np.zeros_like(goals)
        if at_s > targets.end_s + SETTLES_S:
            claim.cancel("the chunk has ended")
        target, ahead = targets.at(np.array([at_s, at_s + SAMPLE_S]))[:, 0]
        speed = (ahead - target) / SAMPLE_S
        return np.array([tracking_velocity(target - goal, speed, self._limits, LATENCY_S) for goal in goals])

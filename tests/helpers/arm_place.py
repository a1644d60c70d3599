"""An arm process somewhere: with simulated joints, on a bus, or on metal."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from robot.arm import Arm
from robot.messages import ArmConfig, ArmState, Mode, MotionEnded
from robot.trajectory import Trajectory
from tests.helpers.trajectories import smooth_move

# Without weight on it, and with room to both sides.
JOINT = "wrist_roll"
REACH_RAD = 0.15
DURATION_S = 0.6

# Backlash and droop of a real arm.
WITHIN_RAD = 0.06

# 30 ticks: nothing moves when torque comes on.
STILL_RAD = 0.046

# A bound of what takes a second or two on a quiet machine.
ANSWER_S = 40.0


class Watched(Arm):
    """An arm that keeps what its process said."""

    def __init__(self, config: ArmConfig) -> None:
        self.states: list[ArmState] = []
        self.ended: list[MotionEnded] = []
        super().__init__(config, self.states.append)

    def _received(self, message: Any) -> None:
        if isinstance(message, MotionEnded):
            self.ended.append(message)
        super()._received(message)


@dataclass
class Place:
    """An arm somewhere.

    Attributes:
        config: how it is driven.
        may_fall: whether torque may be taken off.
    """

    config: ArmConfig
    may_fall: bool
    arm: Watched = field(init=False)

    async def start(self) -> None:
        self.arm = Watched(self.config)
        await self.arm.start(ANSWER_S)
        await self.until(lambda: self.arm.state.mode is Mode.HOLDING)

    async def until(self, condition: Callable[[], bool], timeout_s: float = ANSWER_S) -> None:
        until_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < until_s, f"timed out: {self.arm.state}"
            await asyncio.sleep(0.01)

    async def answer(self, motion: asyncio.Future[MotionEnded]) -> MotionEnded:
        return await asyncio.wait_for(motion, ANSWER_S)

    def at(self, joint: str = JOINT) -> float:
        """Where a joint is [rad]."""
        assert self.arm.state.position_rad is not None
        return float(self.arm.state.position_rad[self.arm.state.joint_names.index(joint)])

    def held(self, joint: str = JOINT) -> float:
        """Where a joint is told to be [rad]."""
        assert self.arm.state.goal_rad is not None
        return float(self.arm.state.goal_rad[self.arm.state.joint_names.index(joint)])

    def move(self, way_rad: float, joint: str = JOINT, duration_s: float = DURATION_S) -> Trajectory:
        """From where the joint is held, so far."""
        return smooth_move({joint: (self.held(joint), self.held(joint) + way_rad)}, duration_s)

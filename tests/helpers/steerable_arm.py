"""The server's end of an arm that is steered, without the arm: what it was told is kept."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import numpy as np

from robot.arm import Arm, ArmStream
from robot.description import model
from robot.messages import ArmState, Mode, MotionEnded, Outcome, Setpoint

ROBOT = model.builtin()
NAMES = tuple(joint.name for joint in ROBOT.movable_joints)


class SteerableArm:
    """An arm that holds at zero, and takes streams."""

    def __init__(self) -> None:
        zeros = np.zeros(len(NAMES))
        self.state = ArmState(0.0, Mode.HOLDING, NAMES, position_rad=zeros, goal_rad=zeros)
        self.state_age_s = 0.0
        self.state_max_age_s = 1.0
        self.setpoints: list[Setpoint] = []
        self.streams: list[ArmStream] = []

    @property
    def as_arm(self) -> Arm:
        return cast("Arm", self)

    def stream(self, joint_names: tuple[str, ...]) -> ArmStream:
        ended: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
        stream = ArmStream(len(self.streams) + 1, joint_names, ended, self.setpoints.append)
        self.streams.append(stream)
        return stream

    def stop(self, motion: asyncio.Future[Any] | None = None) -> None:
        for stream in self.streams:
            if motion in (None, stream.ended) and not stream.ended.done():
                stream.ended.set_result(MotionEnded(0, Outcome.STOPPED, "stopped"))

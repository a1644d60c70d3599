"""An arm without a process: it is where it is put, and its motions end when a test says so."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any, cast

import numpy as np

from robot.arm import Arm, ArmStream
from robot.description import model
from robot.messages import ArmState, Mode, MotionEnded, Outcome, Setpoint
from robot.trajectory import Trajectory

ROBOT = model.builtin()
JOINTS = tuple(joint.name for joint in ROBOT.movable_joints)


class PlayedArm:
    """What is asked of `robot.arm.Arm` by those who play motions; its time passes when a test says so."""

    wait = Arm.wait

    def __init__(self) -> None:
        zeros = np.zeros(len(JOINTS))
        self.state = ArmState(1.0, Mode.HOLDING, JOINTS, position_rad=zeros, velocity_rad_s=zeros, goal_rad=zeros)
        self.state_age_s = 0.0
        self.state_max_age_s = 1.0
        self.steered = False
        self.started = asyncio.Event()
        self.started.set()
        self.played: list[Trajectory] = []
        self.stops: list[object] = []
        self.continued: list[float] = []
        self.refusing = False
        self._motion: asyncio.Future[MotionEnded] | None = None

    @property
    def clock_s(self) -> float:
        return self.state.clock_s

    def pass_time(self, seconds: float) -> None:
        """Say the next state, so much later on the arm's clock."""
        self.state = replace(self.state, clock_s=self.state.clock_s + seconds)

    def execute(
        self, trajectory: Trajectory, continues: tuple[asyncio.Future[MotionEnded], float] | None = None
    ) -> asyncio.Future[MotionEnded]:
        self.played.append(trajectory)
        if continues is not None:
            if self.refusing:
                refused: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
                refused.set_result(MotionEnded(2, Outcome.REFUSED, "too late"))
                return refused
            self.continued.append(continues[1])
            continues[0].set_result(MotionEnded(1, Outcome.STOPPED, "another takes its place"))
        self._motion = asyncio.get_running_loop().create_future()
        self.state = replace(self.state, mode=Mode.MOVING)
        return self._motion

    def stop(self, motion: asyncio.Future[MotionEnded] | None = None) -> None:
        self.stops.append(motion)
        if motion is self._motion or motion is None:
            self.end(Outcome.STOPPED, "stopped half-way")

    async def until_started(self, timeout_s: float) -> None:
        await asyncio.wait_for(self.started.wait(), timeout_s)

    async def end_streams(self, _timeout_s: float) -> bool:
        return not self.steered

    def put(self, **positions_rad: float) -> None:
        """Be somewhere else."""
        goal_rad = np.array([positions_rad.get(name, 0.0) for name in JOINTS])
        self.state = replace(self.state, goal_rad=goal_rad, position_rad=goal_rad)

    def show(self, fraction: float) -> None:
        """Have done a share of the motion in progress."""
        motion = self.played[-1]
        positions = motion.sample(fraction * motion.duration_s)[0].tolist()
        self.put(**dict(zip(motion.joint_names, positions, strict=True)))
        self.state = replace(self.state, fraction=fraction)

    def end(self, outcome: Outcome = Outcome.REACHED, message: str = "the arm is there") -> None:
        """End the motion in progress; one that is reached leaves the arm at its end."""
        if self._motion is None or self._motion.done():
            return
        if outcome is Outcome.REACHED:
            last = self.played[-1]
            self.put(**dict(zip(last.joint_names, last.positions_rad[-1].tolist(), strict=True)))
        self.state = replace(self.state, mode=Mode.HOLDING)
        self._motion.set_result(MotionEnded(1, outcome, message))


async def settle() -> None:
    """Let every task that can go on do so."""
    for _ in range(50):
        await asyncio.sleep(0)


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

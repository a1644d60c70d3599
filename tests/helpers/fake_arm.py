"""An arm without a process: it is where it is put, and its motions and streams end when a test says so."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import cast

import numpy as np

from robot.arm import Arm, ArmStream, Splice
from robot.messages import ArmState, ChangePace, Mode, MotionEnded, MotionProgress, Outcome, Setpoint
from robot.stop_epochs import STOP_EPOCHS, STOPPED_SINCE
from robot.trajectory import Trajectory
from tests.helpers.robots import so101

ROBOT = so101()
JOINTS = tuple(joint.name for joint in ROBOT.movable_joints)
HOME = dict.fromkeys(JOINTS, 0.0)


class FakeArm:
    """`robot.arm.Arm` as the server sees it; it keeps what it is told, and its time passes when a test says so.

    Args:
        positions_rad: position of each joint, 0 for those not named [rad]; None for an arm that is not read.

    Attributes:
        state: the latest state; a test may replace it.
        steered: whether a stream is in progress that :meth:`end_streams` cannot end.
        started: set unless a test clears it.
        refusing: whether a trajectory that continues another is refused.
        played: trajectories, oldest first.
        continued: times at which trajectories replaced others [s].
        stops: motions that were to stop; None for any.
        setpoints: of all streams.
        changes: of the pace.
        last_stop: stop epoch of the last stop of all motion.
    """

    wait = Arm.wait
    name = ""

    def __init__(self, positions_rad: Mapping[str, float] | None = HOME) -> None:
        self.state = ArmState(1.0, Mode.HOLDING, JOINTS, velocity_rad_s=np.zeros(len(JOINTS)))
        if positions_rad is not None:
            self.put(**positions_rad)
        self.state_age_s = 0.0
        self.state_max_age_s = 1.0
        self.rate = 1.0
        self.fraction = 0.0  # share of the motion in progress that is done
        self.steered = False
        self.started = asyncio.Event()
        self.started.set()
        self.refusing = False
        self.played: list[Trajectory] = []
        self.continued: list[float] = []
        self.stops: list[asyncio.Future[MotionEnded] | None] = []
        self.streams: list[ArmStream] = []
        self.setpoints: list[Setpoint] = []
        self.changes: list[ChangePace] = []
        self.last_stop = 0
        self._motion: asyncio.Future[MotionEnded] | None = None

    @property
    def as_arm(self) -> Arm:
        return cast("Arm", self)

    # What the server calls.

    def part(self, _joint_names: Collection[str]) -> FakeArm:
        return self

    @property
    def clock_s(self) -> float:
        return self.state.clock_s

    def execute(
        self,
        trajectory: Trajectory,
        *,
        gripping: bool = False,
        torque_share: float = 1.0,
        continues: Splice | None = None,
        epoch: int | None = None,
    ) -> asyncio.Future[MotionEnded]:
        if epoch is not None and epoch < self.last_stop:
            stopped: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
            stopped.set_result(MotionEnded(2, Outcome.STOPPED, STOPPED_SINCE))
            return stopped
        self.played.append(trajectory)
        if continues is not None:
            if self.refusing or continues.motion.done():
                refused: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
                refused.set_result(MotionEnded(2, Outcome.REFUSED, "too late"))
                return refused
            self.continued.append(continues.from_s)
            continues.motion.set_result(MotionEnded(1, Outcome.STOPPED, "another takes its place"))
        self._motion = asyncio.get_running_loop().create_future()
        self.state = replace(self.state, mode=Mode.MOVING)
        return self._motion

    def progress(self, motion: asyncio.Future[MotionEnded]) -> MotionProgress | None:
        if motion is not self._motion or motion.done() or self.state.mode is not Mode.MOVING:
            return None
        return MotionProgress(1, self.fraction, 0.0)

    def stream(self, joint_names: tuple[str, ...], epoch: int | None = None, *, gripping: bool = False) -> ArmStream:
        ended: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
        if epoch is not None and epoch < self.last_stop:
            ended.set_result(MotionEnded(0, Outcome.STOPPED, STOPPED_SINCE))
        stream = ArmStream(len(self.streams) + 1, joint_names, ended, self.setpoints.append)
        self.streams.append(stream)
        return stream

    def brake(self) -> None:
        """End nothing: a test does."""

    def stop(self, motion: asyncio.Future[MotionEnded] | None = None) -> None:
        self.stops.append(motion)
        if motion is None:
            self.last_stop = STOP_EPOCHS.begin()
        for stream in self.streams:
            if motion in (None, stream.ended) and not stream.ended.done():
                stream.ended.set_result(MotionEnded(0, Outcome.STOPPED, "stopped"))
        if motion is self._motion or motion is None:
            self.end(Outcome.STOPPED, "stopped half-way")

    def change_pace(self, change: ChangePace) -> None:
        self.changes.append(change)

    async def until_started(self, timeout_s: float) -> None:
        await asyncio.wait_for(self.started.wait(), timeout_s)

    async def end_streams(self, _timeout_s: float) -> bool:
        return not self.steered

    # What a test calls.

    def pass_time(self, seconds: float) -> None:
        """Say the next state, so much later on the arm's clock."""
        self.state = replace(self.state, clock_s=self.state.clock_s + seconds)

    def put(self, **positions_rad: float) -> None:
        """Be somewhere else; joints that are not named are at 0."""
        goal_rad = np.array([positions_rad.get(name, 0.0) for name in JOINTS])
        self.state = replace(self.state, goal_rad=goal_rad, position_rad=goal_rad)

    def lose_positions(self) -> None:
        """Be an arm whose joints are not read."""
        self.state = replace(self.state, goal_rad=None, position_rad=None)

    def show(self, fraction: float) -> None:
        """Have done a share of the motion in progress."""
        motion = self.played[-1]
        positions = motion.sample(fraction * motion.duration_s)[0].tolist()
        self.put(**dict(zip(motion.joint_names, positions, strict=True)))
        self.fraction = fraction

    def end(self, outcome: Outcome = Outcome.REACHED, message: str = "the arm is there") -> None:
        """End the motion in progress; one that is reached leaves the arm at its end."""
        if self._motion is None or self._motion.done():
            return
        if outcome is Outcome.REACHED:
            last = self.played[-1]
            self.put(**dict(zip(last.joint_names, last.positions_rad[-1].tolist(), strict=True)))
        self.state = replace(self.state, mode=Mode.HOLDING)
        self._motion.set_result(MotionEnded(1, outcome, message))


class StubbornArm(FakeArm):
    """An arm that brakes when a test says so."""

    def stop(self, motion: asyncio.Future[MotionEnded] | None = None) -> None:
        self.stops.append(motion)


async def settle() -> None:
    """Let every task that can go on do so."""
    for _ in range(50):
        await asyncio.sleep(0)

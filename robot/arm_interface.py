"""Interface of an arm for its callers: one arm (:class:`robot.arm.Arm`), or several (:mod:`robot.arm_group`)."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from typing import Any, Protocol

from robot.calibration import Calibration
from robot.messages import ArmState, ChangePace, CommandDone, Commanded, MotionEnded, MotionProgress, Order
from robot.trajectory import Trajectory, Vector


class StreamInterface(Protocol):
    """Stream of velocity setpoints, as :class:`robot.arm.ArmStream`."""

    joint_names: tuple[str, ...]
    ended: asyncio.Future[MotionEnded]
    commanded: Commanded | None

    def steer(self, velocity_rad_s: Vector) -> None:
        """Set the joints' velocities until the next setpoint."""


class ArmInterface(Protocol):
    """Arm that is moved; :class:`robot.arm.Arm` describes the members."""

    state_max_age_s: float

    @property
    def last_stop(self) -> int:
        """Stop epoch of the last stop of all motion."""

    @property
    def state(self) -> ArmState:
        """Latest state."""

    @property
    def state_age_s(self) -> float:
        """Age of the latest state [s]."""

    @property
    def clock_s(self) -> float:
        """Clock of the control loop [s]."""

    @property
    def pids(self) -> tuple[int, ...]:
        """Ids of its launched processes."""

    def part(self, joint_names: Collection[str]) -> ArmInterface:
        """Return the arm, or the arms together, that have some joints: nothing else counts for their motions."""

    async def until_started(self, timeout_s: float) -> None:
        """Wait while the start is in progress."""

    async def wait(self, ends: Collection[asyncio.Future[Any]], timeout_s: float) -> bool:
        """Wait until all of some futures are done, on the arm's clock."""

    def execute(
        self,
        trajectory: Trajectory,
        *,
        gripping: bool = False,
        torque_share: float = 1.0,
        continues: tuple[asyncio.Future[MotionEnded], float] | None = None,
        epoch: int | None = None,
    ) -> asyncio.Future[MotionEnded]:
        """Send a trajectory."""

    def progress(self, motion: asyncio.Future[MotionEnded]) -> MotionProgress | None:
        """Return the progress of a motion."""

    def stream(self, joint_names: tuple[str, ...], epoch: int | None = None) -> StreamInterface:
        """Begin a stream of velocity setpoints."""

    async def end_streams(self, timeout_s: float) -> bool:
        """Bring every stream to rest."""

    def stop(self, motion: asyncio.Future[MotionEnded] | None = None) -> None:
        """Brake one motion, or all of them."""

    def change_pace(self, change: ChangePace) -> None:
        """Change speed factor, direction or speed limit of motions."""

    async def rest(self, timeout_s: float) -> bool:
        """Wait until every motion has ended."""

    def order(
        self, order: Order, calibration: Calibration | None = None, epoch: int | None = None
    ) -> asyncio.Future[CommandDone]:
        """Send an order."""

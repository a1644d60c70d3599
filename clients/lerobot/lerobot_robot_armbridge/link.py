"""The connection that a robot, teleoperator or camera holds from connect to disconnect."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from armbridge_client import Arm, ConnectionLost, DeadlineExceeded, connect
from armbridge_client.messages import DiagnosticStatus, JointState, KinematicSolverInfo
from armbridge_client.motion import seconds
from armbridge_client.targets import stops_of
from armbridge_client.wire import Message
from lerobot_robot_armbridge.config_armbridge import ServerOptions
from lerobot_robot_armbridge.units import Units, difference, units_of, units_of_dataset

M = TypeVar("M", bound=Message)

FIRST_MESSAGE_TIMEOUT_S = 5.0
NEWEST_AT_MOST_S = 1.0


@dataclass(frozen=True)
class Newest(Generic[M]):
    """The newest message of a topic, and its number."""

    message: M
    number: int
    at_s: float


class Watch(Generic[M]):
    """Keeps the newest message of a topic, from its construction until the connection ends.

    Raises:
        DeadlineExceeded: no message came within 5 s.
    """

    def __init__(self, arm: Arm, topic: str, message_class: type[M]) -> None:
        self.topic = topic
        self._arm = arm
        self._newest: Newest[M] | None = None
        self._came = asyncio.Event()
        arm.loop.run(self._begin(message_class))

    def newest(self, at_most_s: float = NEWEST_AT_MOST_S) -> M:
        """Return the newest message.

        Raises:
            TimeoutError: it came longer ago than ``at_most_s``.
        """
        newest = self._newest
        age_s = time.monotonic() - newest.at_s if newest is not None else float("inf")
        if newest is None or age_s > at_most_s:
            raise TimeoutError(
                f"{self.topic}: the last message came {age_s:.1f} s ago; at most {at_most_s:g} s are taken"
            )
        return newest.message

    def latched(self) -> M:
        """Return the newest message, whenever it came."""
        return self.newest(float("inf"))

    def after(self, number: int, timeout_s: float) -> Newest[M]:
        """Wait for a message with a higher number than an earlier message; 0 for any.

        Raises:
            TimeoutError: none came in time.
        """
        return self._arm.loop.run(asyncio.wait_for(self._after(number), timeout_s))

    async def _begin(self, message_class: type[M]) -> None:
        connection = self._arm.asynchronous.connection
        stream = await connection.subscribe(self.topic, message_class, timeout_s=FIRST_MESSAGE_TIMEOUT_S).__aenter__()
        self._keep(await stream.__anext__())

        async def keep() -> None:
            while True:
                try:
                    self._keep(await stream.__anext__())
                except DeadlineExceeded:
                    continue  # a latched topic, or a connection that is being made again
                except ConnectionLost:
                    return  # closed

        self._task = asyncio.create_task(keep())

    def _keep(self, message: M) -> None:
        number = 1 if self._newest is None else self._newest.number + 1
        self._newest = Newest(message, number, time.monotonic())
        self._came.set()

    async def _after(self, number: int) -> Newest[M]:
        while self._newest is None or self._newest.number <= number:
            self._came.clear()
            await self._came.wait()
        return self._newest


class ArmLink:
    """An arm of the server with its newest states, in lerobot's units.

    Raises:
        ValueError: the arm has other joints than the options name, or another zero than their dataset's arm.
    """

    def __init__(self, options: ServerOptions, joints_topic: str = "") -> None:
        self.options = options
        self.prefix = f"/{options.arm}" if options.arm else ""
        # Of several arms each joint carries the arm's name; lerobot's names do not.
        self.server_names = {joint: f"{options.arm}_{joint}" if options.arm else joint for joint in options.joints}
        self.arm = connect(options.url, arm=options.arm)
        try:
            limits = Watch(self.arm, f"{self.prefix}/arm/joint_limits", KinematicSolverInfo).latched().limits
            self.limits_rad = {each.joint_name: (each.min_position, each.max_position) for each in limits}
            self.speed_rad_s = {each.joint_name: each.max_velocity for each in limits}
            self._check_joints()
            self._arm_state = Watch(self.arm, f"{self.prefix}/arm/state", DiagnosticStatus)
            values = {each.key: each.value for each in self._arm_state.latched().values}
            self.units = self._checked_units(units_of(self.limits_rad, values, use_degrees=options.use_degrees))
            self._joint_states = Watch(self.arm, joints_topic or f"{self.prefix}/joint_states", JointState)
        except BaseException:
            self.arm.close()
            raise

    def _checked_units(self, present: Units) -> Units:
        """Return this arm's units, or the units of the dataset's arm for values that are converted."""
        options = self.options
        if options.dataset is None:
            return present
        recorded = units_of_dataset(options.dataset, self.server_names, use_degrees=options.use_degrees)
        if not options.convert and (different := difference(recorded, present)):
            raise ValueError(f"dataset: {options.dataset}: {different}; --robot.convert=true shifts the values")
        return recorded if options.convert else present

    def _check_joints(self) -> None:
        missing = [name for name in self.server_names.values() if name not in self.limits_rad]
        if missing:
            raise ValueError(f"joints: the server's arm has no {missing}; it has {sorted(self.limits_rad)}")

    @property
    def stops(self) -> int:
        """Number of the last stop that the server has published."""
        return stops_of(self._arm_state.latched())

    def state(self) -> tuple[float, dict[str, float]]:
        """Return the stamp of the newest joint states [s since the epoch], and positions by the server's joints [rad].

        Raises:
            TimeoutError: they came longer ago than 1 s.
        """
        message = self._joint_states.newest()
        return seconds(message.header.stamp), dict(zip(message.name, message.position, strict=True))

    def positions(self) -> dict[str, float]:
        """Return the newest position of each joint, in lerobot's units by lerobot's names; raises as :meth:`state`."""
        return self.in_units(self.state()[1])

    def in_units(self, position_rad: Mapping[str, float]) -> dict[str, float]:
        """Return positions [rad, by the server's names] in lerobot's units by lerobot's names."""
        return {
            f"{joint}.pos": self.units.from_rad(name, position_rad[name]) for joint, name in self.server_names.items()
        }

    def in_rad(self, action: Mapping[str, float]) -> dict[str, float]:
        """Return an action of lerobot in radians, by the server's names.

        Raises:
            ValueError: a joint is missing, or its value is no finite number.
        """
        position_rad = {}
        for joint, name in self.server_names.items():
            value = float(action.get(f"{joint}.pos", math.nan))
            if not math.isfinite(value):
                raise ValueError(f"{joint}.pos: must be a finite number, is {action.get(f'{joint}.pos', 'missing')}")
            position_rad[name] = self.units.to_rad(name, value)
        return position_rad

"""An arm whose servos were found: one cycle of its bus, and the sequences that its driver needs.

This is where decisions (:mod:`robot.control.driver`) and transactions (:mod:`robot.servos.bus`) meet.
"""

from __future__ import annotations

import time
from collections import deque

from robot.control.driver import Driver
from robot.control.torque import TickLimits
from robot.control.upkeep import Upkeep
from robot.messages import MotionEnded
from robot.servos.bus import Bus
from robot.servos.control_block import CONTROL_ADDRESS, CONTROL_BYTES, parse_control
from robot.servos.registers import GOAL_ADDRESS, TELEMETRY_ADDRESS, TELEMETRY_BYTES, Register, encode
from robot.servos.servo_map import ServoMap
from robot.servos.telemetry import Measured, ServoWatch

# Round trips of the last second at 100 Hz.
ROUND_TRIPS_KEPT = 100

PERMILLE = 1000.0


class ArmOnBus:
    """One bus with the servos of an arm.

    Args:
        bus: the open bus.
        servos: the servos that should be on it.

    Attributes:
        driver: decides on goals; None until the servos were found.
        upkeep: comes with the driver.
        limits: comes with the driver.
        round_trips_s: what the latest block reads took [s].
        measured: the latest readings; None until every servo has answered.
        telling: whether ticks tell the servos their goals; not while a sequence does.
    """

    def __init__(self, bus: Bus, servos: ServoMap) -> None:
        self.bus = bus
        self.servos = servos
        self.watch = ServoWatch(servos)
        self.driver: Driver | None = None
        self.upkeep: Upkeep | None = None
        self.limits = TickLimits({}, {})
        self.round_trips_s: deque[float] = deque(maxlen=ROUND_TRIPS_KEPT)
        self.measured: Measured | None = None
        self.telling = True
        self._goal_rad: list[float] = []
        self._goal_blocks: dict[int, bytes] = {}

    def begin(self, driver: Driver, upkeep: Upkeep, limits: TickLimits) -> None:
        """Drive the servos that were found."""
        self.driver, self.upkeep, self.limits = driver, upkeep, limits

    def tick(self) -> list[MotionEnded]:
        """Read the servos, decide, and tell them their goals; returns the motions that this ended.

        Raises:
            PortLost: the port is gone.
        """
        self._read()
        driver, measured = self.driver, self.measured
        if driver is None or measured is None:
            return []
        ended = driver.step(measured, time.monotonic())
        if driver.driven and self.telling:
            self._tell_goals(driver)
            self._write_torque_limits(driver)
        return ended + self._read_back(driver, measured)

    def hold(self, goal_ticks: dict[int, int]) -> None:
        """Take note that the servos were told these goals, at full torque; goals far from the arm come back to it."""
        if self.driver is not None and self.upkeep is not None:
            self.driver.hold(self.servos.rad_from_ticks(goal_ticks), self.measured)
            self.upkeep.told(self.torque_permille(self.driver))

    def torque_permille(self, driver: Driver) -> dict[int, int]:
        """The torque limits that the driver wants, by servo id [0.1 %]."""
        limits = zip(self.servos.ids, driver.torque_limit.tolist(), strict=True)
        return {servo: round(limit * PERMILLE) for servo, limit in limits}

    def _read(self) -> None:
        asked = self.watch.ids_to_ask()
        if asked:
            started_s = time.monotonic()
            frames = self.bus.sync_read(asked, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
            self.round_trips_s.append(time.monotonic() - started_s)
            self.watch.take(asked, frames, started_s)
        if self.watch.complete:
            self.measured = self.watch.measured(time.monotonic(), time.time())

    def _tell_goals(self, driver: Driver) -> None:
        goal_rad = driver.goal_rad.tolist()
        if goal_rad != self._goal_rad:
            self._goal_rad, self._goal_blocks = goal_rad, self.servos.goal_blocks(driver.goal_rad)
        # Told again and again, also while the arm rests: a servo may have missed it.
        self.bus.sync_write(GOAL_ADDRESS, self._goal_blocks)

    def _write_torque_limits(self, driver: Driver) -> None:
        if self.upkeep is None:
            return
        changed = self.upkeep.limits_to_write(self.torque_permille(driver))
        if changed:
            data = {servo: encode(Register.TORQUE_LIMIT, limit) for servo, limit in changed.items()}
            self.bus.sync_write(Register.TORQUE_LIMIT, data)

    def _read_back(self, driver: Driver, measured: Measured) -> list[MotionEnded]:
        """Ask the servo whose turn it is whether it still is as it was told."""
        servo = self.upkeep.due() if self.upkeep is not None else None
        if self.upkeep is None or servo is None or self.watch.is_silent(servo):
            return []
        frame = self.bus.sync_read((servo,), CONTROL_ADDRESS, CONTROL_BYTES).get(servo)
        if frame is None:
            return []
        fault = self.upkeep.judge(servo, parse_control(frame.data), measured.stamp_s)
        return driver.react(fault, measured) if fault is not None and driver.driven else []

"""Dynamixel servos as hardware of the controller: radians and shares towards it, ticks and registers on the bus."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence

import numpy as np

from robot.description.limits import JointBounds
from robot.errors import NoReply, PortLost, StartupError
from robot.faults import Fault
from robot.hardware.config import DynamixelConfig, EmulatedDynamixelConfig
from robot.hardware.dynamixel.bus import Bus
from robot.hardware.dynamixel.readings import ServoWatch
from robot.hardware.dynamixel.registers import (
    HARDWARE_ERRORS,
    MOTION_ADDRESS,
    MOTION_BYTES,
    TELEMETRY_BYTES,
    Register,
    encode,
)
from robot.hardware.dynamixel.servo_map import ServoMap
from robot.hardware.dynamixel.survey import RegisterChecks, ServoFound, limits_of, refusal, survey
from robot.hardware.dynamixel.torque import ServoTorque
from robot.hardware.interface import (
    Actuation,
    Condition,
    Flags,
    HardwareInterface,
    Measured,
    StatusFlag,
    Steps,
    Survey,
)
from robot.hardware.port import resolve_port
from robot.messages import GuardLimits
from robot.trajectory import Vector

# Supply and temperature are read ten times a second; the reply is twice as long with them.
CLIMATE_EVERY = 10

NO_ZERO = (
    "no calibration says where the joints' zero is, and motions would go elsewhere than planned: calibrate the arm "
    "with lerobot, and name the calibration (arm.calibration, --calibration NAME)"
)


class SerialDynamixels:
    """Servos of an arm on a serial port, as a hardware source.

    Args:
        config: port, calibration and models.
        bounds: soft limits of the joints.
        guard_limits: torque limits.
        clock: time of the control loop [s].
    """

    def __init__(
        self, config: DynamixelConfig, bounds: JointBounds, guard_limits: GuardLimits, clock: Callable[[], float]
    ) -> None:
        self._config = config
        self._bounds = bounds
        self._guard_limits = guard_limits
        self._clock = clock

    def open(self) -> HardwareInterface:
        """Open the port; see :func:`robot.hardware.port.open_port` for the errors."""
        bus = Bus.open(resolve_port(self._config.port), self._config.baud)
        return DynamixelHardware(bus, self._config, self._bounds, self._guard_limits, self._clock)


class DynamixelHardware(HardwareInterface):
    """Servos of one arm on an open bus.

    Args:
        bus: the bus, which this closes.
        config: joints, whose order is that of every array, and their servos.
        bounds: soft limits of the joints.
        guard_limits: torque limits.
        clock: time of the control loop [s].

    Attributes:
        bus: as given.
        servos: conversion between joints and servos.
    """

    def __init__(
        self,
        bus: Bus,
        config: DynamixelConfig | EmulatedDynamixelConfig,
        bounds: JointBounds,
        guard_limits: GuardLimits,
        clock: Callable[[], float],
    ) -> None:
        self.bus = bus
        self.servos = ServoMap(config.calibration, bounds, guard_limits)
        super().__init__(self.servos.names, self.servos.full_torque)
        self.counters = bus.counters
        self.latched_status = sum(HARDWARE_ERRORS.values(), StatusFlag(0))
        self._config = config
        self._bounds = bounds
        self._clock = clock
        self._watch = ServoWatch(self.servos)
        self._cycle = 0
        self._found: dict[int, ServoFound] = {}
        self._soft_ticks: dict[int, tuple[int, int]] = {}
        self._checks = RegisterChecks(self.servos)
        self._torque = ServoTorque(bus, self.servos, self._found, self._soft_ticks)
        self._armed = False
        # The latest goals with the turns of their servos, and their blocks.
        self._goals: list[float] = []
        self._goal_blocks: dict[int, bytes] = {}
        self._share: list[float] = []
        self._shares: dict[int, float] = {}

    def survey(self) -> Steps[Survey]:
        """Survey the servos; see :meth:`HardwareInterface.survey`."""
        self._found.update((yield from survey(self.bus, self.servos, simulated=self._config.simulated)))
        found = [self._found[servo] for servo in self.servos.ids]
        limits = {servo: limits_of(self.servos, servo, each) for servo, each in self._found.items()}
        bounds = self._bounds.within_servos(self._config.calibration, limits)
        self._soft_ticks.update(self.servos.ticks_range(bounds))
        driven = np.array([each.torque_on for each in found])
        goal_rad = self.servos.positions_rad([each.goal_ticks for each in found])
        return Survey(
            bounds=bounds,
            driven=driven,
            goal_rad=np.where(driven, goal_rad, np.nan),
            max_voltage_v=np.array([each.max_voltage_v for each in found]),
            # Its overload protection counts the load of seconds by a rule that no document states.
            actuation=Actuation.unprotected(len(found)),
            reply_latency_s=self.bus.latency_s,
        )

    def read(self) -> Measured | None:
        """Read the servos' measurements in one transaction, and a hardware error that one of them reports."""
        asked = self._watch.ids_to_ask()
        self._cycle += 1
        if asked:
            whole = self._cycle % CLIMATE_EVERY == 0 or not self._watch.complete
            started_s = self._clock()
            frames = self.bus.sync_read(asked, MOTION_ADDRESS, TELEMETRY_BYTES if whole else MOTION_BYTES)
            self.round_trips_s.append(self._clock() - started_s)
            self._watch.take(asked, frames, started_s)
        alerting = self._watch.alerting()
        if alerting:
            servo = alerting[self._cycle % len(alerting)]
            with contextlib.suppress(NoReply):
                self._watch.take_hardware_error(servo, self.bus.read(servo, Register.HARDWARE_ERROR_STATUS))
        return self._watch.measured(self._clock(), time.time()) if self._watch.complete else None

    def write_goals(self, goal_rad: Vector) -> None:
        """Write the goals, also unchanged ones: a servo may have missed them, and its watchdog waits for them."""
        goals = [*goal_rad.tolist(), *map(self._watch.turns_ticks, self.servos.ids)]
        if goals != self._goals:
            self._goals = goals
            self._goal_blocks = {
                servo: encode(Register.GOAL_POSITION, ticks - self._watch.turns_ticks(servo))
                for servo, ticks in self.servos.goals_ticks(goal_rad).items()
            }
        self.bus.sync_write(Register.GOAL_POSITION, self._goal_blocks)

    def write_torque_shares(self, torque_share: Vector) -> None:
        """Write the torque limits that have changed."""
        self._torque.write_limits(self._checks.limits_to_write(self._shares_by_id(torque_share)))

    def check(self, stamp_s: float) -> Fault | None:
        """Read back one register of one servo, in turn."""
        due = self._checks.due()
        if due is None or self._watch.is_silent(due[0]):
            return None
        servo, register = due
        watchdog = register is Register.BUS_WATCHDOG
        if watchdog and not (servo in self._found and self._found[servo].has_watchdog):
            return None
        try:
            value = self.bus.read(servo, register)
        except NoReply:
            return None
        if watchdog:
            return self._checks.check_watchdog(servo, value, stamp_s)
        return self._checks.check_torque(servo, on=value == 1, stamp_s=stamp_s)

    def driven(self) -> Steps[Flags]:
        """Read every servo's TORQUE_ENABLE."""
        driven = np.zeros(len(self.servos.ids), dtype=bool)
        for joint, servo in enumerate(self.servos.ids):
            driven[joint] = yield from self._torque.is_on(servo)
        return driven

    def enable(self, joints: Sequence[int]) -> Steps[Vector]:
        """Switch torque on, unless the calibration is unknown or not the servos'."""
        yield 0.0
        if not self._config.simulated and not self._config.calibration.zero_is_known:
            raise StartupError(NO_ZERO)
        if reason := refusal(self.servos, self._found):
            raise StartupError(reason)
        self._armed = True
        goals = yield from self._torque.enable(self._ids(joints))
        self._checks.expect(self._torque.full_shares())
        return self.servos.rad_from_ticks(goals)

    def relax(self, torque_share: Vector) -> Steps[list[str]]:
        """Lower the torque limits, then switch torque off."""
        return self._labels((yield from self._torque.relax(self._shares_by_id(torque_share))))

    def switch_off(self, joints: Sequence[int] | None = None) -> Steps[list[str]]:
        """Switch torque off servo by servo."""
        ids = self.servos.ids if joints is None else self._ids(joints)
        return self._labels((yield from self._torque.switch_off(ids)))

    def cut_torque(self) -> Steps[list[str]]:
        """Broadcast torque off, then verify it servo by servo."""
        return self._labels((yield from self._torque.emergency_stop()))

    def clear_overloads(self, joints: Sequence[int], *, hold: bool) -> Steps[Vector | None]:
        """Reboot the servos, which clears every error that has switched one off."""
        overloaded = self._ids(joints)
        for servo in overloaded:
            yield from self._torque.clear_errors(servo, hold=hold)
        if not hold or not overloaded:
            return None
        goals = {}
        for servo in self.servos.ids:
            goals[servo] = yield from self._torque.goal(servo)
        self._checks.expect(self._torque.full_shares())
        return self.servos.rad_from_ticks(goals)

    def condition(self, joint: int) -> Condition:
        """Return the condition of one servo."""
        servo = self.servos.ids[joint]
        return Condition(
            hardware_id=f"servo {servo}",
            torque_enabled=self._checks.torque_on.get(servo),
            age_s=self._watch.age_s(servo, self._clock()),
            silent_cycles=self._watch.silent_cycles[servo],
            warnings=self._found[servo].warnings if servo in self._found else (),
        )

    def label(self, joint: int) -> str:
        """Return the joint's name with its servo's id."""
        return self.servos.label(self.servos.ids[joint])

    def close(self) -> None:
        """Disarm the watchdogs of servos that were driven, and close the bus; the servos keep their goals."""
        if self._armed:
            with contextlib.suppress(PortLost):
                self._torque.disarm_watchdogs()
        self.bus.close()

    def _ids(self, joints: Sequence[int]) -> list[int]:
        return [self.servos.ids[joint] for joint in joints]

    def _labels(self, servo_ids: Sequence[int]) -> list[str]:
        return [self.servos.label(servo) for servo in servo_ids]

    def _shares_by_id(self, torque_share: Vector) -> dict[int, float]:
        """Give shares of full duty by servo id; the same object while they are unchanged."""
        share = torque_share.tolist()
        if share != self._share:
            self._share, self._shares = share, dict(zip(self.servos.ids, share, strict=True))
        return self._shares

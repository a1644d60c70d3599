"""Feetech servos as hardware of the controller: radians and shares towards it, ticks and registers on the bus.

A servo that does not answer must not hold up the others: :class:`ServoWatch` keeps the latest good reading of each, and
chooses the servos to read in a cycle.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from robot.calibration import RAD_PER_TICK, Calibration
from robot.description.limits import JointBounds
from robot.errors import StartupError
from robot.faults import Fault
from robot.hardware.config import FeetechConfig
from robot.hardware.feetech import torque
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.calibration import read_differences, write_to_servos
from robot.hardware.feetech.packets import StatusFrame
from robot.hardware.feetech.profiles import FACTORY, ServoProfile
from robot.hardware.feetech.registers import (
    CONTROL_ADDRESS,
    CONTROL_BYTES,
    GOAL_ADDRESS,
    STALL_CURRENT_A,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Register,
    Telemetry,
    encode,
    parse_control,
    parse_telemetry,
)
from robot.hardware.feetech.servo_map import PERMILLE, ServoMap
from robot.hardware.feetech.settings import ServoSettings
from robot.hardware.feetech.survey import (
    RegisterChecks,
    ServoFound,
    calibration_refusal,
    change_refusal,
    read_control,
    survey,
)
from robot.hardware.feetech.torque import TickLimits
from robot.hardware.interface import (
    FREE_SPEED_RAD_S,
    JUMP_RAD,
    Actuation,
    Condition,
    Flags,
    HardwareInterface,
    Measured,
    Steps,
    Survey,
)
from robot.hardware.port import resolve_port
from robot.messages import GuardLimits
from robot.trajectory import Vector

NO_ZERO = (
    "no calibration says where the joints' zero is, and motions would go elsewhere than planned: calibrate the arm "
    "(armbridge calibrate NAME) and name the calibration (arm.calibration, --calibration NAME)"
)

NEEDS_SURVEY = (
    "a calibration was written into the servos, or its writing was broken off, and they were not checked since: the "
    "arm is enabled only once every servo has answered to the check"
)

# A servo that has missed this many reads in a row is read less often: waiting for it costs half of a period. As many as
# make its reading stale, so that it never counts as lost because it was not read.
MISSES_UNTIL_SILENT = 10
ASK_SILENT_EVERY = 10

# When none replies, waiting for all of them takes most of a period. The cycles in between leave time for sequences: an
# emergency stop must be able to report that no servo confirms it.
ASK_ALL_EVERY = 3


class SerialServos:
    """Servos of an arm on a serial port, as a hardware source.

    Args:
        config: port and calibration.
        bounds: soft limits of the joints.
        guard_limits: torque limits.
        clock: time of the control loop [s].
    """

    def __init__(
        self, config: FeetechConfig, bounds: JointBounds, guard_limits: GuardLimits, clock: Callable[[], float]
    ) -> None:
        self._config = config
        self._bounds = bounds
        self._guard_limits = guard_limits
        self._clock = clock

    def open(self) -> HardwareInterface:
        """Open the port; see :func:`robot.hardware.port.open_port` for the errors."""
        bus = Bus.open(resolve_port(self._config.port))
        config = self._config
        return FeetechHardware(
            bus, config.calibration, self._bounds, self._guard_limits, self._clock, profile=config.profile
        )


class FeetechHardware(HardwareInterface):
    """Servos of one arm on an open bus.

    Args:
        bus: the bus, which this closes.
        calibration: joints, whose order is that of every array, and their servos.
        bounds: soft limits of the joints.
        guard_limits: torque limits.
        clock: time of the control loop [s].
        profile: settings that the servos should have; None for those of the known profile that is nearest.
        simulated: True for emulated servos, without cable and supply to check.

    Attributes:
        bus: as given.
        servos: conversion between joints and servos.
    """

    def __init__(
        self,
        bus: Bus,
        calibration: Calibration,
        bounds: JointBounds,
        guard_limits: GuardLimits,
        clock: Callable[[], float],
        *,
        profile: ServoProfile | None = None,
        simulated: bool = False,
    ) -> None:
        self.bus = bus
        self.servos = ServoMap(calibration, bounds, guard_limits)
        super().__init__(self.servos.names, self.servos.full_torque / PERMILLE)
        self.counters = bus.counters
        self._calibration = calibration
        self._bounds = bounds
        self._clock = clock
        self._profile = profile
        self._simulated = simulated
        self._watch = ServoWatch(self.servos)
        self._found: dict[int, ServoFound] = {}
        self._first_found: dict[int, ServoFound] = {}
        self._checks = RegisterChecks(self.servos, self._found)
        self._limits = TickLimits({}, {})
        self._goal_rad: list[float] = []
        self._goal_blocks: dict[int, bytes] = {}
        self._share: list[float] = []
        self._share_permille: dict[int, int] = {}

    def survey(self) -> Steps[Survey]:
        """Survey the servos; see :meth:`HardwareInterface.survey`."""
        self._found.update((yield from survey(self.bus, self.servos, self._profile, simulated=self._simulated)))
        self._first_found = self._first_found or dict(self._found)
        self.needs_survey = False
        found = [self._found[servo] for servo in self.servos.ids]
        actuation = _actuation([each.settings for each in found])
        self.servos.limit_torque(actuation.max_torque)
        self.full_torque = self.servos.full_torque / PERMILLE
        own_limits = {servo: each.settings.angle_limits_ticks for servo, each in self._found.items()}
        bounds = self._bounds.within_servos(self._calibration, own_limits)
        self._limits = TickLimits(self.servos.ticks_range(bounds), own_limits)
        driven = np.array([each.control.torque_on for each in found])
        goal_rad = self.servos.positions_rad([each.control.goal_ticks for each in found])
        return Survey(
            bounds=bounds,
            driven=driven,
            goal_rad=np.where(driven, goal_rad, np.nan),
            max_voltage_v=np.array([each.settings.max_voltage_v for each in found]),
            actuation=actuation,
            reply_latency_s=self.bus.latency_s,
        )

    def read(self) -> Measured | None:
        """Read the servos' telemetry in one transaction; silent ones are read less often."""
        asked = self._watch.ids_to_ask()
        if asked:
            started_s = self._clock()
            frames = self.bus.sync_read(asked, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
            self.round_trips_s.append(self._clock() - started_s)
            self._watch.take(asked, frames, started_s)
        return self._watch.measured(self._clock(), time.time()) if self._watch.complete else None

    def write_goals(self, goal_rad: Vector) -> None:
        """Write the goals, also unchanged ones: a servo may have missed them."""
        goals = goal_rad.tolist()
        if goals != self._goal_rad:
            self._goal_rad, self._goal_blocks = goals, self.servos.goal_blocks(goal_rad)
        self.bus.sync_write(GOAL_ADDRESS, self._goal_blocks)

    def write_torque_shares(self, torque_share: Vector) -> None:
        """Write the torque limits that have changed."""
        changed = self._checks.limits_to_write(self._permille(torque_share))
        if changed:
            data = {servo: encode(Register.TORQUE_LIMIT, limit) for servo, limit in changed.items()}
            self.bus.sync_write(Register.TORQUE_LIMIT, data)

    def check(self, stamp_s: float) -> Fault | None:
        """Read back the registers of one servo, in turn."""
        servo = self._checks.due()
        if servo is None or self._watch.is_silent(servo):
            return None
        frame = self.bus.sync_read((servo,), CONTROL_ADDRESS, CONTROL_BYTES).get(servo)
        return None if frame is None else self._checks.check(servo, parse_control(frame.data), stamp_s)

    def driven(self) -> Steps[Flags]:
        """Read every servo's TORQUE_ENABLE."""
        driven = np.zeros(len(self.servos.ids), dtype=bool)
        for joint, servo in enumerate(self.servos.ids):
            driven[joint] = (yield from read_control(self.bus, servo)).torque_on
        return driven

    def enable(self, joints: Sequence[int]) -> Steps[Vector]:
        """Switch torque on; see :mod:`robot.hardware.feetech.torque`.

        Raises:
            StartupError: as there, for a real arm without a known zero, for servos that contradict the calibration, and
                for servos that were written to since the last survey.
        """
        if self.needs_survey:
            raise StartupError(NEEDS_SURVEY)
        if not self._simulated and not self._calibration.zero_is_known:
            raise StartupError(NO_ZERO)
        offsets_known = self._calibration.offsets_known
        if offsets_known and (reason := calibration_refusal(self.servos, self._found)):
            raise StartupError(reason)
        if reason := change_refusal(self.servos, self._first_found, self._found, offsets_known=offsets_known):
            raise StartupError(reason)
        goals = yield from torque.enable(self.bus, self.servos, self._limits, self._ids(joints))
        self._checks.expect(torque.full_torque(self.servos))
        return self.servos.rad_from_ticks(goals)

    def relax(self, torque_share: Vector) -> Steps[list[str]]:
        """Lower the torque limits, then switch torque off."""
        return self._labels((yield from torque.relax(self.bus, self.servos, self._permille(torque_share))))

    def switch_off(self, joints: Sequence[int] | None = None) -> Steps[list[str]]:
        """Switch torque off servo by servo."""
        ids = list(self.servos.ids) if joints is None else self._ids(joints)
        return self._labels((yield from torque.switch_off(self.bus, ids)))

    def cut_torque(self) -> Steps[list[str]]:
        """Broadcast torque off, then verify it servo by servo."""
        return self._labels((yield from torque.emergency_stop(self.bus, self.servos)))

    def clear_overloads(self, joints: Sequence[int], *, hold: bool) -> Steps[Vector | None]:
        """Switch torque off and on again; a firmware with which the overload stays latched needs a power cycle."""
        overloaded = self._ids(joints)
        for servo in overloaded:
            yield from torque.clear_overload(self.bus, self.servos, self._limits, servo)
            if not hold and (yield from torque.switch_off(self.bus, [servo])):
                raise StartupError(f"torque off could not be verified at {self.servos.label(servo)}")
        if not hold or not overloaded:
            return None
        goals = {}
        for servo in self.servos.ids:
            goals[servo] = (yield from read_control(self.bus, servo)).goal_ticks
        self._checks.expect(torque.full_torque(self.servos))
        return self.servos.rad_from_ticks(goals)

    def write_calibration(self, calibration: Calibration) -> Steps[str]:
        """Write homing offsets and angle limits, where they differ; see :mod:`robot.hardware.feetech.calibration`."""
        changes = yield from read_differences(self.bus, calibration)
        self.needs_survey = self.needs_survey or bool(changes)
        yield from write_to_servos(self.bus, changes)
        servos = {change.servo_id for change in changes}
        return f"{len(changes)} registers of {len(servos)} servos were written" if changes else "nothing had to change"

    def condition(self, joint: int) -> Condition:
        """Return the condition of one servo."""
        servo = self.servos.ids[joint]
        found = self._found.get(servo)
        return Condition(
            hardware_id=f"servo {servo}",
            torque_enabled=self._checks.torque_on.get(servo),
            age_s=self._watch.age_s(servo, self._clock()),
            silent_cycles=self._watch.silent_cycles[servo],
            warnings=() if found is None else found.warnings,
            registers={} if found is None else found.settings.by_name(),
            expected={} if found is None else {register.name: value for register, value in found.expected.items()},
        )

    def label(self, joint: int) -> str:
        """Return the joint's name with its servo's id."""
        return self.servos.label(self.servos.ids[joint])

    def close(self) -> None:
        """Close the bus; the servos keep their goals."""
        self.bus.close()

    def _ids(self, joints: Sequence[int]) -> list[int]:
        return [self.servos.ids[joint] for joint in joints]

    def _labels(self, servo_ids: Sequence[int]) -> list[str]:
        return [self.servos.label(servo) for servo in servo_ids]

    def _permille(self, torque_share: Vector) -> dict[int, int]:
        """Convert shares to register TORQUE_LIMIT by servo id; the same object while the shares are unchanged."""
        share = torque_share.tolist()
        if share != self._share:
            limits = zip(self.servos.ids, share, strict=True)
            self._share, self._share_permille = share, {servo: round(limit * PERMILLE) for servo, limit in limits}
        return self._share_permille


def _actuation(settings: Sequence[ServoSettings]) -> Actuation:
    """Return the strength of servos with these settings."""
    factory_gain = FACTORY.registers[Register.P_GAIN]
    return Actuation(
        stiffness=np.array([each[Register.P_GAIN] / factory_gain for each in settings]),
        max_torque=np.array([each.max_torque for each in settings]),
        overload_torque=np.array([each.overload_torque for each in settings]),
        overload_time_s=np.array([each.protection_time_s for each in settings]),
        overload_current_a=np.array([each.protection_current_a for each in settings]),
        stall_current_a=np.full(len(settings), STALL_CURRENT_A),
        free_speed_rad_s=np.full(len(settings), FREE_SPEED_RAD_S),
    )


class ServoWatch:
    """Readings of the servos, their ages, and the servos to read next.

    Args:
        servos: servos of the arm.

    Attributes:
        silent_cycles: cycles without a reading, by servo id.
    """

    def __init__(self, servos: ServoMap) -> None:
        self._servos = servos
        self._seen: dict[int, _Seen] = {}
        self._read_at_s: dict[int, float] = {}
        self._frames: Mapping[int, StatusFrame] = {}
        self._measured: Measured | None = None
        self._cycle = 0
        self._misses_in_row = dict.fromkeys(servos.ids, 0)
        self._doubted: set[int] = set()
        self.silent_cycles = dict.fromkeys(servos.ids, 0)

    @property
    def complete(self) -> bool:
        """True when every servo has answered at least once."""
        return len(self._seen) == len(self._servos.ids)

    def ids_to_ask(self) -> list[int]:
        """Choose the servos to read in this cycle: silent ones last, and only now and then."""
        self._cycle += 1
        silent = [servo for servo in self._servos.ids if self.is_silent(servo)]
        speaking = [servo for servo in self._servos.ids if servo not in silent]
        every = ASK_SILENT_EVERY if speaking else ASK_ALL_EVERY
        return speaking if self._cycle % every else speaking + silent

    def is_silent(self, servo_id: int) -> bool:
        """Return True for a servo that has missed so many reads in a row that it is read less often."""
        return self._misses_in_row[servo_id] >= MISSES_UNTIL_SILENT

    def take(self, asked: list[int], frames: Mapping[int, StatusFrame], now_s: float) -> None:
        """Take the replies to one block read.

        A reading with a jump that no joint can make may be another servo's with a disturbed id: the first one is
        ignored, a second one in a row is believed.

        Args:
            asked: servos that were asked.
            frames: valid replies, each with the telemetry block.
            now_s: monotonic time at which they were asked, so that no reading is older than its age [s].
        """
        if frames is self._frames and len(frames) == len(self._servos.ids) and not self._doubted:
            # The same bytes as in the last cycle, whose readings were believed.
            self._read_at_s = dict.fromkeys(self._servos.ids, now_s)
            return
        self._frames, self._measured = frames, None
        readings = {servo: parse_telemetry(frame.data) for servo, frame in frames.items()}
        jumped = {servo for servo, reading in readings.items() if self._jumps(servo, reading, now_s)}
        believed = readings.keys() - (jumped - self._doubted)
        self._doubted = (self._doubted - frames.keys()) | (jumped - believed)
        for servo in believed:
            self._seen[servo] = _Seen(readings[servo], readings[servo].status | frames[servo].error)
            self._read_at_s[servo] = now_s
            self._misses_in_row[servo] = 0
        for servo in self._servos.ids:
            if servo not in believed:
                self._misses_in_row[servo] += servo in asked
                self.silent_cycles[servo] += 1

    def _jumps(self, servo_id: int, reading: Telemetry, now_s: float) -> bool:
        """Return True when a servo cannot have turned from its last reading to this one."""
        seen = self._seen.get(servo_id)
        if seen is None:
            return False
        way_rad = abs(reading.position_ticks - seen.reading.position_ticks) * RAD_PER_TICK
        return way_rad > JUMP_RAD + FREE_SPEED_RAD_S * (now_s - self._read_at_s[servo_id])

    def age_s(self, servo_id: int, now_s: float) -> float:
        """Return the time since a servo's last good reply [s]; infinite when there was none."""
        read_at_s = self._read_at_s.get(servo_id)
        return float("inf") if read_at_s is None else now_s - read_at_s

    def measured(self, now_s: float, stamp_s: float) -> Measured:
        """Return all readings as arrays; every servo must have answered once."""
        age_s = np.array([now_s - self._read_at_s[servo] for servo in self._servos.ids])
        if self._measured is not None:
            return self._measured._replace(age_s=age_s, stamp_s=stamp_s)
        seen = [self._seen[servo] for servo in self._servos.ids]
        readings = [each.reading for each in seen]
        # From plain numbers: an operation on arrays costs more than all the arithmetic for six joints.
        self._measured = Measured(
            position_rad=np.array(self._servos.positions_rad([reading.position_ticks for reading in readings])),
            velocity_rad_s=np.array(self._servos.velocities_rad_s([reading.velocity_ticks_s for reading in readings])),
            load=np.array([reading.load_permille / 1000.0 for reading in readings]),
            current_a=np.array([reading.current_a for reading in readings]),
            voltage_v=np.array([reading.voltage_v for reading in readings]),
            temperature_c=np.array([float(reading.temperature_c) for reading in readings]),
            status=np.array([each.status for each in seen]),
            age_s=age_s,
            stamp_s=stamp_s,
        )
        return self._measured


class _Seen(NamedTuple):
    """Latest good reading of one servo."""

    reading: Telemetry
    status: int

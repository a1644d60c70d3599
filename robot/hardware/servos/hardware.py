"""Servos as hardware of the controller: radians and shares towards it, ticks and registers on the bus.

A servo that does not answer must not hold up the others, nor silence them: a servo that has just missed its
turn is asked last, since servos wait for the reply before theirs, and a servo that stays silent is asked now and then.
"""

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np

from robot.calibration import RAD_PER_TICK, Calibration
from robot.description.limits import JointBounds
from robot.description.servo_table import ServoKind
from robot.errors import NoReply, PortLost, StartupError
from robot.faults import Fault, FaultCode
from robot.hardware.boards import resolve_port
from robot.hardware.config import SerialConfig
from robot.hardware.feetech.profiles import ServoProfile
from robot.hardware.interface import Flags, HardwareInterface, Measured, Steps, Survey
from robot.hardware.servos import torque
from robot.hardware.servos.bus import ServoBus, StatusFrame
from robot.hardware.servos.family import Limit, ServoFamily, ServoFound, ServoMap, Values
from robot.hardware.servos.registers import Block, Telemetry
from robot.hardware.servos.survey import calibration_refusal, change_refusal, survey
from robot.hardware.servos.torque import ServoTorque
from robot.messages import GuardLimits, JointHealth
from robot.trajectory import Vector

MISSES_UNTIL_LAST = 2  # misses in a row after which a servo is asked behind the others

# Reads in a row without any reply, for each servo, after which all count as silent: each has been the first once.
EMPTY_READS_PER_SERVO = MISSES_UNTIL_LAST

# A servo that has missed this many reads in a row is read less often: waiting for it costs half of a period. As many as
# make its reading stale, so that it never counts as lost because it was not read.
MISSES_UNTIL_SILENT = 10
ASK_SILENT_EVERY = 10

# When none replies, waiting for all of them takes most of a period. The cycles in between leave time for sequences: an
# emergency stop must be able to report that no servo confirms it.
ASK_ALL_EVERY = 3


class ServoTracker:
    """Latest readings of an arm's servos."""

    def __init__(self, family: ServoFamily, servos: ServoMap) -> None:
        self._family = family
        self._servos = servos
        self._seen: dict[int, Telemetry] = {}
        self._error_known: set[int] = set()
        self._read_at_s: dict[int, float] = {}
        self._frames: Mapping[int, StatusFrame] = {}
        self._measured: Measured | None = None
        self._complete = False
        self._cycle = 0
        self._misses_in_row = dict.fromkeys(servos.ids, 0)
        self._empty_reads = 0
        self._suspect_ids: set[int] = set()
        self.silent_cycles = dict.fromkeys(servos.ids, 0)

    @property
    def complete(self) -> bool:
        """True when every servo has answered at least once, with its supply and temperature."""
        if not self._complete:
            supplied = [reading for reading in self._seen.values() if not math.isnan(reading.voltage_v)]
            self._complete = len(supplied) == len(self._servos.ids)
        return self._complete

    def ids_to_ask(self) -> list[int]:
        """Choose the servos to read in this cycle: those that have missed their turn last, silent ones now and then."""
        self._cycle += 1
        misses = self._misses_in_row
        prompt = [servo for servo in self._servos.ids if misses[servo] < MISSES_UNTIL_LAST]
        if len(prompt) == len(misses):
            return prompt
        late = [servo for servo in self._servos.ids if MISSES_UNTIL_LAST <= misses[servo] < MISSES_UNTIL_SILENT]
        silent = [servo for servo in self._servos.ids if self.is_silent(servo)]
        speaking = prompt + late
        every = ASK_SILENT_EVERY if speaking else ASK_ALL_EVERY
        return speaking if self._cycle % every else speaking + silent

    def is_silent(self, servo_id: int) -> bool:
        """Return True for a servo that is read less often, because it has missed many reads in a row."""
        return self._misses_in_row[servo_id] >= MISSES_UNTIL_SILENT

    def ask_again(self, servo_id: int) -> None:
        """Ask a servo in the next cycle, though it was silent."""
        self._misses_in_row[servo_id] = 0

    def alerting(self) -> list[int]:
        """Return the servos that report an error which has not been read lately."""
        return [servo for servo, seen in self._seen.items() if seen.reports_error and servo not in self._error_known]

    def take_error(self, servo_id: int, status: int) -> None:
        """Take the status flags of a servo's error register, which count until the servo reports none."""
        self._seen[servo_id].status = status
        self._error_known.add(servo_id)
        self._measured = None

    def turns_ticks(self) -> dict[int, int]:
        """Return the turns to add to positions for the calibrated ones, by id; empty for servos without turns."""
        if not self._family.counts_turns:
            return {}
        return {servo: seen.turns_ticks for servo, seen in self._seen.items()}

    def take(self, asked: Sequence[int], frames: Mapping[int, StatusFrame], now_s: float) -> None:
        """Take the replies to one block read of servos in this order, which were asked at a monotonic time [s].

        A reading with a jump that no joint can make may be another servo's with a disturbed id: the first one is
        ignored, a second one in a row is believed. When all servos behind a missing one are missing too, they may have
        waited for it, so that it alone has missed its turn.
        """
        if frames is self._frames and len(frames) == len(self._servos.ids) and not self._suspect_ids:
            # The same bytes as in the last cycle, whose readings were believed.
            self._read_at_s = dict.fromkeys(self._servos.ids, now_s)
            return
        self._frames, self._measured = frames, None
        parse, joints = self._family.parse_telemetry, self._servos.by_id
        readings = {servo: parse(frame, joints[servo]) for servo, frame in frames.items()}
        for servo, reading in readings.items() if self._family.counts_turns else ():
            reading.turns_ticks = self._servos.turns_ticks(servo, reading.position_ticks)
            reading.position_ticks += reading.turns_ticks
        jumped = {servo for servo, reading in readings.items() if self._jumps(servo, reading, now_s)}
        believed = readings.keys() - (jumped - self._suspect_ids)
        self._suspect_ids = (self._suspect_ids - frames.keys()) | (jumped - believed)
        self._believe({servo: readings[servo] for servo in believed}, now_s)
        if len(believed) < len(self._servos.ids):
            self._count_misses(asked, frames, believed)
        self._empty_reads = 0 if frames else self._empty_reads + 1
        if self._empty_reads >= EMPTY_READS_PER_SERVO * len(self._servos.ids):
            for servo, misses in self._misses_in_row.items():
                self._misses_in_row[servo] = max(misses, MISSES_UNTIL_SILENT)

    def age_s(self, servo_id: int, now_s: float) -> float:
        """Return the time since a servo's last good reply [s]; infinite when there was none."""
        read_at_s = self._read_at_s.get(servo_id)
        return float("inf") if read_at_s is None else now_s - read_at_s

    def measured(self, now_s: float, stamp_s: float) -> Measured:
        """Return all readings as arrays; they must be :attr:`complete`."""
        servos, ids = self._servos, self._servos.ids
        age_s = np.array([now_s - self._read_at_s[servo] for servo in ids])
        if self._measured is not None:
            return self._measured._replace(age_s=age_s, stamp_s=stamp_s)
        seen = [self._seen[servo] for servo in ids]
        # From plain numbers: an operation on arrays costs more than all the arithmetic for six joints.
        self._measured = Measured(
            position_rad=np.array(servos.positions_rad([each.position_ticks for each in seen])),
            velocity_rad_s=np.array(servos.velocities_rad_s([each.velocity_ticks_s for each in seen])),
            load=np.array(servos.signed([each.load for each in seen])),
            current_a=np.array(servos.signed([each.current_a for each in seen])),
            voltage_v=np.array([each.voltage_v for each in seen]),
            temperature_c=np.array([each.temperature_c for each in seen], dtype=float),
            status=np.array([each.status for each in seen]),
            age_s=age_s,
            stamp_s=stamp_s,
        )
        return self._measured

    def _believe(self, readings: Mapping[int, Telemetry], now_s: float) -> None:
        for servo, reading in readings.items():
            before = self._seen.get(servo, reading)
            if math.isnan(reading.voltage_v):
                reading.voltage_v, reading.temperature_c = before.voltage_v, before.temperature_c
            else:
                self._error_known.discard(servo)
            if reading.reports_error and before.reports_error:
                reading.status = before.status
            self._seen[servo] = reading
            self._read_at_s[servo] = now_s
            self._misses_in_row[servo] = 0

    def _count_misses(self, asked: Sequence[int], frames: Mapping[int, StatusFrame], believed: set[int]) -> None:
        missing = [servo for servo in asked if servo not in frames]
        behind_first = missing[1:] if missing and list(asked[-len(missing) :]) == missing else []
        for servo in self._servos.ids:
            if servo not in believed:
                self._misses_in_row[servo] += servo in asked and servo not in behind_first
                self.silent_cycles[servo] += 1

    def _jumps(self, servo_id: int, reading: Telemetry, now_s: float) -> bool:
        before = self._seen.get(servo_id)
        if before is None:
            return False
        way_rad = abs(reading.position_ticks - before.position_ticks) * RAD_PER_TICK
        free_speed_rad_s = self._family.free_speed_rad_s(self._servos.by_id[servo_id])
        return way_rad > self._family.jump_rad + free_speed_rad_s * (now_s - self._read_at_s[servo_id])


NO_ZERO = "no calibration says where the joints' zero is, and motions would go elsewhere than planned: {advice}"

NEEDS_SURVEY = (
    "a calibration was written into the servos, or its writing was broken off, and they were not checked since: the "
    "arm is enabled only once every servo has answered to the check"
)

TELEMETRY_EVERY = 10  # supply and temperature are read ten times a second where the reply is shorter without them


CYCLES_BETWEEN = 16  # cycles between register checks: each of six servos is checked about once a second


class ServoHardware(HardwareInterface):
    """Servos of one arm on an open bus, in the calibration's order; emulated ones have no cable and supply to check."""

    def __init__(
        self,
        family: ServoFamily,
        bus: ServoBus,
        calibration: Calibration,
        bounds: JointBounds,
        guard_limits: GuardLimits,
        clock: Callable[[], float],
        *,
        simulated: bool = False,
    ) -> None:
        self.bus = bus
        self.servos = ServoMap(family, calibration, bounds, guard_limits)
        super().__init__(self.servos.names, self.servos.full_torque)
        self.counters = bus.counters
        self.latched_status = family.latched_status
        self._family = family
        self._calibration = calibration
        self._bounds = bounds
        self._clock = clock
        self._simulated = simulated
        self._tracker = ServoTracker(family, self.servos)
        self._cycle = 0
        self._first_found: dict[int, ServoFound] = {}
        self._checks = RegisterChecks(family, self.servos)
        self._torque = ServoTorque(family, bus, self.servos)
        self._was_enabled = False
        # The latest goals and the turns of their servos, and their blocks.
        self._goals: list[float] = []
        self._goal_turns_ticks: dict[int, int] = {}
        self._goal_blocks: dict[int, bytes] = {}
        self._shares: list[float] = []
        self._limits: dict[int, Limit] = {}

    def survey(self) -> Steps[Survey]:
        self.servos.found = yield from survey(self._family, self.bus, self.servos, simulated=self._simulated)
        self._first_found = self._first_found or dict(self.servos.found)
        self.needs_survey = False
        self._shares = []
        found = [self.servos.found[servo] for servo in self.servos.ids]
        actuation = self._family.actuation(self.servos.joints, self.servos.found)
        self.full_torque = self.servos.full_torque = np.minimum(self.full_torque, actuation.max_torque)
        own_limits = {servo: self._torque.goal_limits_ticks(servo) for servo in self.servos.ids}
        bounds = self._bounds.within_servos(self._calibration, own_limits)
        self.servos.soft_limits_ticks = self.servos.ticks_range(bounds)
        table = self._family.registers
        driven = np.array([each.values[table.torque_enable] == 1 for each in found])
        goal_rad = self.servos.positions_rad([each.values[table.goal_position] + each.turns_ticks for each in found])
        return Survey(
            bounds=bounds,
            driven=driven,
            goal_rad=np.where(driven, goal_rad, np.nan),
            max_voltage_v=np.array([self._family.max_voltage_v(each.values) for each in found]),
            actuation=actuation,
            reply_latency_s=self.bus.latency_s,
        )

    def read(self) -> Measured | None:
        """Read the servos' measurements in one transaction, and an error that one of them reports."""
        asked = self._tracker.ids_to_ask()
        self._cycle += 1
        if asked:
            whole = self._cycle % TELEMETRY_EVERY == 0 or not self._tracker.complete
            block = self._family.telemetry if whole else self._family.motion
            started_s = self._clock()
            frames = self.bus.sync_read(asked, block.address, block.length)
            self.round_trips_s.append(self._clock() - started_s)
            self._tracker.take(asked, frames, started_s)
        if self._family.error_register is not None and (alerting := self._tracker.alerting()):
            servo = alerting[self._cycle % len(alerting)]
            with contextlib.suppress(NoReply):
                error = self.bus.read(servo, self._family.error_register, attempts=1)
                self._tracker.take_error(servo, self._family.status_of(error))
        return self._tracker.measured(self._clock(), time.time()) if self._tracker.complete else None

    def write_goals(self, goal_rad: Vector) -> None:
        """Write the goals, also unchanged ones: a servo may have missed them, and its watchdog waits for them."""
        goals = goal_rad.tolist()
        turns_ticks = self._tracker.turns_ticks()
        if goals != self._goals or turns_ticks != self._goal_turns_ticks:
            self._goals, self._goal_turns_ticks = goals, turns_ticks
            self._goal_blocks = self.servos.goal_blocks(goal_rad, turns_ticks)
        self.bus.sync_write(self._family.goal_address, self._goal_blocks)

    def write_torque_shares(self, torque_share: Vector) -> None:
        changed = self._checks.limits_to_write(self._limits_of(torque_share))
        if changed:
            torque.write_limits(self.bus, changed)

    def check(self, stamp_s: float) -> Fault | None:
        due = self._checks.due()
        if due is None or self._tracker.is_silent(due[0]):
            return None
        servo, block = due
        watchdog = self._family.watchdog
        if watchdog is not None and block.address == watchdog.register and not self._torque.has_watchdog(servo):
            return None
        frame = self.bus.sync_read((servo,), block.address, block.length).get(servo)
        if frame is None:
            return None
        return self._checks.check(servo, block.parse(frame.data), stamp_s)

    def driven(self) -> Steps[Flags]:
        driven = np.zeros(len(self.servos.ids), dtype=bool)
        for joint, servo in enumerate(self.servos.ids):
            driven[joint] = yield from self._torque.is_on(servo)
        return driven

    def enable(self, joints: Sequence[int]) -> Steps[Vector]:
        yield 0.0
        if refusal := self._refusal():
            raise StartupError(refusal)
        self._was_enabled = True
        goals = yield from self._torque.enable(self._ids(joints))
        self._expect_full_torque()
        return self.servos.rad_from_ticks(goals)

    def relax(self, torque_share: Vector) -> Steps[list[str]]:
        start, full = self._limits_of(torque_share), self._torque.full_limits()
        return self._labels((yield from torque.relax(self.bus, self.servos.ids, start, full)))

    def switch_off(self, joints: Sequence[int] | None = None) -> Steps[list[str]]:
        ids = self.servos.ids if joints is None else self._ids(joints)
        return self._labels((yield from torque.switch_off(self.bus, ids)))

    def cut_torque(self) -> Steps[list[str]]:
        return self._labels((yield from torque.emergency_stop(self.bus, self.servos.ids)))

    def clear_overloads(self, joints: Sequence[int], *, hold: bool) -> Steps[Vector | None]:
        overloaded = self._ids(joints)
        for servo in overloaded:
            yield from self._torque.clear_error(servo, hold=hold)
            # A reboot has made it silent, but its next reading must show that the error is gone.
            self._tracker.ask_again(servo)
        if not hold or not overloaded:
            return None
        goals = {}
        for servo in self.servos.ids:
            goals[servo] = yield from self._torque.goal(servo)
        self._expect_full_torque()
        return self.servos.rad_from_ticks(goals)

    def write_calibration(self, calibration: Calibration) -> Steps[str]:
        changes = yield from self._family.read_differences(self.bus, calibration)
        self.needs_survey = self.needs_survey or bool(changes)
        yield from self._family.write_differences(self.bus, changes)
        servos = {change.servo_id for change in changes}
        return f"{len(changes)} registers of {len(servos)} servos were written" if changes else "nothing had to change"

    def health(self, joint: int) -> JointHealth:
        servo = self.servos.ids[joint]
        found = self.servos.found.get(servo)
        return JointHealth(
            joint=self.joint_names[joint],
            hardware_id=f"servo {servo}",
            torque_enabled=self._checks.torque_on.get(servo),
            age_s=self._tracker.age_s(servo, self._clock()),
            silent_cycles=self._tracker.silent_cycles[servo],
            warnings=() if found is None else found.warnings,
            registers={} if found is None else self._family.settings(found.values),
            expected={} if found is None else {register.name: value for register, value in found.expected.items()},
        )

    def label(self, joint: int) -> str:
        return self.servos.label(self.servos.ids[joint])

    def close(self) -> None:
        """Disarm the watchdogs of servos that were driven, and close the bus; the servos keep their goals."""
        if self._was_enabled:
            with contextlib.suppress(PortLost):
                self._torque.disarm_watchdogs()
        self.bus.close()

    def _refusal(self) -> str:
        if self.needs_survey:
            return NEEDS_SURVEY
        if not self._simulated and not self._calibration.zero_is_known:
            return NO_ZERO.format(advice=self._family.calibrate_advice)
        offsets_known = self._calibration.offsets_known or self._family.assumes_no_offsets
        contradiction = calibration_refusal(self._family, self.servos) if offsets_known else ""
        return contradiction or change_refusal(
            self._family, self.servos, self._first_found, offsets_known=offsets_known
        )

    def _expect_full_torque(self) -> None:
        # A servo's mode may have changed, and with it the register that limits its torque.
        self._shares = []
        self._checks.expect(self._torque.full_limits())

    def _ids(self, joints: Sequence[int]) -> list[int]:
        return [self.servos.ids[joint] for joint in joints]

    def _labels(self, servo_ids: Sequence[int]) -> list[str]:
        return [self.servos.label(servo) for servo in servo_ids]

    def _limits_of(self, torque_share: Vector) -> dict[int, Limit]:
        """Convert shares of full duty to torque limits by servo id; the same object while the shares are unchanged."""
        shares = torque_share.tolist()
        if shares != self._shares:
            self._shares, self._limits = shares, self._torque.limits(self.servos.by_servo(torque_share))
        return self._limits


def family_of(kind: ServoKind, profile: ServoProfile | None = None) -> ServoFamily:
    """Return a family of servos, and import no other; Feetech's may have settings of their own."""
    match kind:
        case "feetech":
            from robot.hardware.feetech.family import Feetech

            return Feetech(profile)
        case "dynamixel":
            from robot.hardware.dynamixel.family import Dynamixel

            return Dynamixel()


def open_servos(
    family: ServoFamily,
    config: SerialConfig,
    bounds: JointBounds,
    guard_limits: GuardLimits,
    clock: Callable[[], float],
) -> ServoHardware:
    """Open the servos of an arm on a serial port; see :func:`robot.hardware.port.open_port` for the errors."""
    bus = family.bus.open(resolve_port(config.port), config.baud)
    return ServoHardware(family, bus, config.calibration, bounds, guard_limits, clock)


class RegisterChecks:
    """Comparison of driven servos' registers with what was written to them.

    A servo whose supply dips reboots, with torque off and its torque limit at the maximum. A servo that its watchdog
    has stopped ignores its goals. Telemetry shows neither, so the registers of one servo at a time are read back.
    """

    def __init__(self, family: ServoFamily, servos: ServoMap) -> None:
        self._family = family
        self._servos = servos
        self._turn = cycle((servo, block) for block in family.read_back for servo in servos.ids)
        self._cycle = 0
        self._expected: dict[int, Limit] = {}
        self.torque_on: dict[int, bool] = {}

    def due(self) -> tuple[int, Block[Any]] | None:
        """Return the servo and the block to read back in this cycle, if any."""
        self._cycle += 1
        return None if self._cycle % CYCLES_BETWEEN else next(self._turn)

    def expect(self, limits: Mapping[int, Limit]) -> None:
        """Expect these torque limits, which were written to the servos, by id."""
        self._expected = dict(limits)
        self.torque_on.clear()

    def limits_to_write(self, limits: Mapping[int, Limit]) -> dict[int, Limit]:
        """Return the torque limits that differ from the expected ones, and expect them, by id."""
        if limits == self._expected:
            return {}
        changed = {servo: limit for servo, limit in limits.items() if self._expected.get(servo) != limit}
        self._expected.update(changed)
        return changed

    def check(self, servo_id: int, values: Values, stamp_s: float) -> Fault | None:
        """Return the fault of a servo that has rebooted, was relaxed, or was stopped by its watchdog; None for none."""
        limit, joint = self._expected.get(servo_id), self._servos.by_id[servo_id].joint
        torque_on = values.get(self._family.registers.torque_enable)
        if torque_on is not None:
            self.torque_on[servo_id] = torque_on == 1
        if limit is not None:
            watchdog = self._family.watchdog
            if watchdog is not None and values.get(watchdog.register) == watchdog.tripped:
                silence = f"{watchdog.silence_s:g} s"
                message = f"the servo of joint {joint} has stopped by itself, since it heard nothing for {silence}"
                return Fault(FaultCode.SERVO_SILENT, message, joint, stamp_s)
            restarted = self._family.has_restarted(self._servos.found[servo_id], values, limit)
            if restarted or values.get(limit.register, limit.value) != limit.value:
                self._expected.pop(servo_id)
            if restarted:
                return Fault(FaultCode.SERVO_REBOOTED, f"the servo of joint {joint} has restarted", joint, stamp_s)
        if torque_on not in (None, 1):
            return Fault(FaultCode.TORQUE_LOST, f"the servo of joint {joint} was found relaxed", joint, stamp_s)
        return None

"""Survey of the servos before anything is written to them, and register checks while they are driven.

The survey assumes nothing about the registers: torque may be on at power-up, and the goal may have any value. What
makes a position uncertain keeps the servos from being driven: :func:`refusal`.

A servo whose supply dips reboots, with torque off and its watchdog disarmed, which its telemetry does not show; and a
servo whose watchdog has stopped it ignores its goals. So TORQUE_ENABLE and BUS_WATCHDOG of one servo at a time are read
back in turn (:class:`RegisterChecks`).
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from itertools import cycle

from robot.advice import ServoAlert, ServoWarning
from robot.calibration import TICKS_PER_TURN, JointCalibration
from robot.errors import NoReply, StartupError
from robot.faults import Fault, FaultCode
from robot.hardware.dynamixel.bus import Bus, Identity, ping, read
from robot.hardware.dynamixel.registers import (
    MAX_HOMING_OFFSET_IN_POSITION_MODE,
    PLAIN_DRIVE_MODE,
    VOLT_PER_UNIT,
    WATCHDOG_TRIPPED,
    WATCHDOG_UNIT_S,
    OperatingMode,
    Register,
)
from robot.hardware.dynamixel.servo_map import ServoMap
from robot.hardware.interface import Steps

NONE_ANSWERS_ADVICE = ": is the arm powered, and are its servos set to 1,000,000 baud?"
MISSING_ADVICE = ": check the cable to the first one named and its id"

# Position limits that differ from the calibration by more than this many ticks (0.7 deg) are of another calibration.
LIMITS_AGREE_WITHIN_TICKS = 8

# A servo that counts more turns was turned by another program. The SDK cannot send every goal that far away: some have
# the bytes of a packet's header (32 turns).
MOST_TURNS = 16

# Cycles between register checks: each of six servos is checked about once a second.
CYCLES_BETWEEN = 16

# Register BUS_WATCHDOG while a servo is driven: 0.5 s without an instruction stop it where it is. Shorter pauses are
# those of a busy computer, and goals are streamed, so that a servo is never far from its last one.
WATCHDOG = round(0.5 / WATCHDOG_UNIT_S)


@dataclass(frozen=True)
class ServoFound:
    """Servo as surveyed.

    Attributes:
        identity: its model and firmware.
        mode: register OPERATING_MODE; enabling may change a gripper's.
        homing_offset: register HOMING_OFFSET [ticks].
        torque_on: True while its motor is driven.
        goal_ticks: register GOAL_POSITION, as the calibration counts.
        position_limits_ticks: registers MIN_POSITION_LIMIT and MAX_POSITION_LIMIT.
        max_voltage_v: register MAX_VOLTAGE_LIMIT [V].
        pwm_limit: register PWM_LIMIT.
        current_limit_ma: register CURRENT_LIMIT; None for a servo without current control [mA].
        has_watchdog: True if its firmware has register BUS_WATCHDOG.
        warnings: warnings about it.
    """

    identity: Identity
    mode: OperatingMode
    homing_offset: int
    torque_on: bool
    goal_ticks: int
    position_limits_ticks: tuple[int, int]
    max_voltage_v: float
    pwm_limit: int
    current_limit_ma: int | None
    has_watchdog: bool
    warnings: tuple[ServoWarning, ...] = ()


def survey(bus: Bus, servos: ServoMap, *, simulated: bool = False) -> Steps[dict[int, ServoFound]]:
    """Survey every servo of the arm, without writing.

    Args:
        bus: an open bus.
        servos: servos of the arm.
        simulated: True for emulated servos, without cable and supply to check.

    Returns:
        Servos by id.

    Raises:
        StartupError: a servo is missing, of another model, or in a mode in which its position is not the calibrated
            one.
        NoReply: a servo stopped answering.
        PortLost: the port is gone.
    """
    identities = yield from _identify(bus, servos, simulated=simulated)
    found = {}
    for joint in servos.joints:
        found[joint.servo_id] = yield from _look_at(bus, servos, joint, identities[joint.servo_id])
    return found


def limits_of(servos: ServoMap, servo_id: int, found: ServoFound) -> tuple[int, int]:
    """Return the lowest and highest position that a servo can be sent to, as the calibration counts [ticks].

    In position mode these are its own limits (e-manual, Min/Max Position Limit (48, 52)); in all modes its turns must
    be certain.
    """
    lowest, highest = servos.unambiguous_ticks(servo_id)
    if found.mode is not OperatingMode.POSITION:
        return lowest, highest
    return max(lowest, found.position_limits_ticks[0]), min(highest, found.position_limits_ticks[1])


def refusal(servos: ServoMap, found: dict[int, ServoFound]) -> str:
    """Return the reason why the servos' positions are not those of the calibration, empty for none."""
    for servo, each in found.items():
        wanted = servos.by_id[servo].homing_offset
        if each.homing_offset != wanted:
            return (
                f"servo {servos.label(servo)} has the homing offset {each.homing_offset} in register HOMING_OFFSET "
                f"({int(Register.HOMING_OFFSET)}), but its calibration says {wanted}: write the calibration to the "
                "servos, or calibrate the arm anew"
            )
    return ""


class RegisterChecks:
    """Comparison of the servos' registers with what was written to them.

    Args:
        servos: servos of the arm.

    Attributes:
        torque_on: register TORQUE_ENABLE of each servo when it was last read back, by id.
    """

    def __init__(self, servos: ServoMap) -> None:
        self._servos = servos
        self._turn = cycle(
            (servo, register) for register in (Register.TORQUE_ENABLE, Register.BUS_WATCHDOG) for servo in servos.ids
        )
        self._cycle = 0
        self._expected: dict[int, float] = {}
        self.torque_on: dict[int, bool] = {}

    def due(self) -> tuple[int, Register] | None:
        """Return the servo and the register to read back in this cycle, if any."""
        self._cycle += 1
        return None if self._cycle % CYCLES_BETWEEN else next(self._turn)

    def expect(self, shares: dict[int, float]) -> None:
        """Expect these torque limits, which were written to the servos, as shares of full duty by id."""
        self._expected = dict(shares)
        self.torque_on.clear()

    def limits_to_write(self, shares: dict[int, float]) -> dict[int, float]:
        """Return the torque limits that differ from the expected ones, and expect them, by id."""
        if shares == self._expected:
            return {}
        changed = {servo: share for servo, share in shares.items() if self._expected.get(servo) != share}
        self._expected.update(changed)
        return changed

    def check_watchdog(self, servo_id: int, value: int, stamp_s: float) -> Fault | None:
        """Compare register BUS_WATCHDOG of a driven servo with what was written to it.

        Args:
            servo_id: id of the servo.
            value: register BUS_WATCHDOG.
            stamp_s: wall-clock time [s since the epoch].

        Returns:
            Fault of a servo that has rebooted, or that its watchdog has stopped; None otherwise.
        """
        if servo_id not in self._expected:
            return None
        joint = self._servos.by_id[servo_id].joint
        if value == WATCHDOG_TRIPPED:
            silence_s = WATCHDOG * WATCHDOG_UNIT_S
            message = f"the servo of joint {joint} has stopped by itself, since it heard nothing for {silence_s:g} s"
            return Fault(FaultCode.SERVO_SILENT, message, joint, stamp_s)
        if value == 0:
            self._expected.pop(servo_id)
            return Fault(FaultCode.SERVO_REBOOTED, f"the servo of joint {joint} has started anew", joint, stamp_s)
        return None

    def check_torque(self, servo_id: int, *, on: bool, stamp_s: float) -> Fault | None:
        """Compare register TORQUE_ENABLE of a driven servo with what was written to it; see :meth:`check_watchdog`."""
        self.torque_on[servo_id] = on
        joint = self._servos.by_id[servo_id].joint
        return (
            None
            if on
            else Fault(FaultCode.TORQUE_LOST, f"the servo of joint {joint} was found relaxed", joint, stamp_s)
        )


def _identify(bus: Bus, servos: ServoMap, *, simulated: bool) -> Steps[dict[int, Identity]]:
    """Ping every servo, and check its model."""
    found: dict[int, Identity] = {}
    for servo in servos.ids:
        with contextlib.suppress(NoReply):
            found[servo] = yield from ping(bus, servo)
    missing = [servos.label(servo) for servo in servos.ids if servo not in found]
    if not found:
        raise StartupError(f"no servo answers{'' if simulated else NONE_ANSWERS_ADVICE}")
    if missing:
        raise StartupError(f"no answer from {', '.join(missing)}{'' if simulated else MISSING_ADVICE}")
    for servo, identity in found.items():
        model = servos.models[servo]
        if identity.model_number != model.number:
            raise StartupError(
                f"servo {servos.label(servo)} is model {identity.model_number}, not {model.name} ({model.number})"
            )
    return found


def _look_at(bus: Bus, servos: ServoMap, joint: JointCalibration, identity: Identity) -> Steps[ServoFound]:
    servo = joint.servo_id
    mode = yield from read(bus, servo, Register.OPERATING_MODE)
    drive_mode = yield from read(bus, servo, Register.DRIVE_MODE)
    offset = yield from read(bus, servo, Register.HOMING_OFFSET)
    _check_modes(servos, servo, mode, drive_mode, offset)
    lowest = yield from read(bus, servo, Register.MIN_POSITION_LIMIT)
    highest = yield from read(bus, servo, Register.MAX_POSITION_LIMIT)
    goal = yield from read(bus, servo, Register.GOAL_POSITION)
    present = yield from read(bus, servo, Register.PRESENT_POSITION)
    turns = servos.turns_ticks(servo, present)
    if abs(turns) > MOST_TURNS * TICKS_PER_TURN:
        raise StartupError(
            f"servo {servos.label(servo)} is at {present} ticks, more than {MOST_TURNS} turns away from its calibrated "
            "range: switch its supply off and on"
        )
    model = servos.models[servo]
    has_watchdog = identity.firmware >= model.watchdog_firmware
    return ServoFound(
        identity=identity,
        mode=OperatingMode(mode),
        homing_offset=offset,
        torque_on=(yield from read(bus, servo, Register.TORQUE_ENABLE)) == 1,
        goal_ticks=goal + turns,
        position_limits_ticks=(lowest, highest),
        max_voltage_v=(yield from read(bus, servo, Register.MAX_VOLTAGE_LIMIT)) * VOLT_PER_UNIT,
        pwm_limit=(yield from read(bus, servo, Register.PWM_LIMIT)),
        current_limit_ma=(yield from read(bus, servo, Register.CURRENT_LIMIT)) if model.has_current else None,
        has_watchdog=has_watchdog,
        warnings=_warnings(joint, (lowest, highest), identity, has_watchdog=has_watchdog),
    )


def _check_modes(servos: ServoMap, servo: int, mode: int, drive_mode: int, homing_offset: int) -> None:
    """Raise StartupError for a servo that does not follow positions as the calibration counts them."""
    label, has_current = servos.label(servo), servos.models[servo].has_current
    modes = [each for each in OperatingMode if has_current or each is not OperatingMode.CURRENT_BASED_POSITION]
    if mode not in modes:
        known = ", ".join(str(int(each)) for each in modes)
        raise StartupError(
            f"servo {label} is in operating mode {mode}, not a mode of position control ({known}): set register "
            f"OPERATING_MODE ({int(Register.OPERATING_MODE)}) to {int(OperatingMode.EXTENDED_POSITION)}"
        )
    if mode == OperatingMode.POSITION and abs(homing_offset) > MAX_HOMING_OFFSET_IN_POSITION_MODE:
        raise StartupError(
            f"servo {label} is in operating mode {mode}, in which it ignores its homing offset of {homing_offset} "
            f"ticks (more than {MAX_HOMING_OFFSET_IN_POSITION_MODE}): set register OPERATING_MODE "
            f"({int(Register.OPERATING_MODE)}) to {int(OperatingMode.EXTENDED_POSITION)}"
        )
    if drive_mode != PLAIN_DRIVE_MODE:
        raise StartupError(
            f"servo {label} has drive mode {drive_mode}, which changes its direction, profile or torque: set register "
            f"DRIVE_MODE ({int(Register.DRIVE_MODE)}) to {PLAIN_DRIVE_MODE}"
        )


def _warnings(
    joint: JointCalibration, limits_ticks: tuple[int, int], identity: Identity, *, has_watchdog: bool
) -> tuple[ServoWarning, ...]:
    warnings = []
    calibrated = joint.range_min, joint.range_max
    if max(abs(a - b) for a, b in zip(limits_ticks, calibrated, strict=True)) > LIMITS_AGREE_WITHIN_TICKS:
        sentence = f"the servo's position limits {limits_ticks} differ from the calibrated range {calibrated} ticks"
        warnings.append(ServoWarning(ServoAlert.POSITION_LIMITS, sentence))
    if not has_watchdog:
        sentence = (
            f"firmware {identity.firmware} has no bus watchdog, so that the servo does not notice when this computer "
            "fails: update it"
        )
        warnings.append(ServoWarning(ServoAlert.NO_WATCHDOG, sentence))
    return tuple(warnings)

"""Survey of the servos before anything is written to them, and register checks while they are driven.

The survey assumes nothing about the registers: torque may be on or off at power-up, and the goal may have any value.

A servo whose supply dips reboots, with torque off and its torque limit at the maximum, which its telemetry does not
show. So the control block of one servo at a time is read back and compared with what was written
(:class:`RegisterChecks`).
"""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import cycle

from robot.advice import ServoAlert, ServoWarning
from robot.calibration import MAX_TICK, JointCalibration
from robot.errors import NoReply, StartupError
from robot.faults import Fault, FaultCode
from robot.hardware.feetech.bus import STEP_ATTEMPTS, Bus, read_block
from robot.hardware.feetech.profiles import ServoProfile, meaning, nearest_profile
from robot.hardware.feetech.registers import (
    CONTROL_ADDRESS,
    CONTROL_BYTES,
    MODELS,
    Control,
    Register,
    parse_control,
)
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.settings import SETTINGS_ADDRESS, SETTINGS_BYTES, ServoSettings, parse_settings
from robot.hardware.interface import Steps

# Register OPERATING_MODE of a servo that follows position goals.
POSITION_MODE = 0

# Register PHASE, bit 4: positions count on beyond one turn, and overflow.
PHASE_MULTI_TURN = 0x10

NONE_ANSWERS_ADVICE = ": is the arm powered, and the adapter's jumper on B?"
MISSING_ADVICE = ": check the cable to the first one named and its id"

# Angle limits that differ from the calibration by more than this many ticks (0.7 deg) are of another calibration.
LIMITS_AGREE_WITHIN_TICKS = 8

CALIBRATE_OR_WRITE_BACK = (
    "Either calibrate the arm anew (armbridge calibrate NAME --write-servos), or write the calibrated offsets and "
    "limits back (armbridge calibrate NAME --write-back)"
)

# Cycles between register checks: each of six servos is checked about once a second.
CYCLES_BETWEEN = 16


@dataclass(frozen=True)
class ServoFound:
    """Servo as surveyed.

    Attributes:
        model: register MODEL_NUMBER.
        control: commands that it holds.
        settings: its settings.
        warnings: warnings about it.
        expected: values of the settings that differ from the profile.
    """

    model: int
    control: Control
    settings: ServoSettings
    warnings: tuple[ServoWarning, ...] = ()
    expected: Mapping[Register, int] = field(default_factory=dict)


def survey(
    bus: Bus,
    servos: ServoMap,
    profile: ServoProfile | None = None,
    *,
    simulated: bool = False,
) -> Steps[dict[int, ServoFound]]:
    """Survey every servo of the arm, without writing.

    Args:
        bus: an open bus.
        servos: servos of the arm.
        profile: settings that they should have; None for those of the known profile that is nearest.
        simulated: True for emulated servos, without cable and supply to check.

    Returns:
        Servos by id.

    Raises:
        StartupError: a servo is missing, is of an unknown model, or is not in position mode.
        NoReply: a servo stopped answering.
        PortLost: the port is gone.
    """
    models = yield from _check_present(bus, servos, simulated=simulated)
    found = {}
    for joint in servos.joints:
        servo = joint.servo_id
        settings = yield from read_settings(bus, servo)
        _check_mode(joint, settings)
        found[servo] = ServoFound(models[servo], (yield from read_control(bus, servo)), settings)
    held = [(found[joint.servo_id].settings, joint.servo.gripper) for joint in servos.joints]
    expected = nearest_profile(held) if profile is None else profile
    versions = Counter(settings.firmware for settings, _ in held)
    usual_firmware = max(versions, key=lambda version: (versions[version], version))
    for joint in servos.joints:
        plain = found[joint.servo_id]
        compared = replace(plain, expected=expected.differences(plain.settings, gripper=joint.servo.gripper))
        warnings = tuple(_warnings(joint, compared, expected.name, usual_firmware))
        found[joint.servo_id] = replace(compared, warnings=warnings)
    return found


def calibration_refusal(servos: ServoMap, found: Mapping[int, ServoFound]) -> str:
    """Return the reason not to drive servos that contradict the calibration, empty for none.

    A servo subtracts its homing offset from the encoder's position, so that with another one every position means
    another angle. With the calibrated offset, but limits of another one, its limits stop the joint at wrong angles.

    Args:
        servos: servos of the arm.
        found: servos as surveyed, by id.
    """
    shifted = []
    for joint in servos.joints:
        held = found[joint.servo_id].settings[Register.HOMING_OFFSET]
        if held != joint.homing_offset:
            angle_deg = math.degrees(abs(joint.rad_s_from_ticks_s(held - joint.homing_offset)))
            shifted.append(
                f"{servos.label(joint.servo_id)} by {angle_deg:.1f} deg ({held} instead of {joint.homing_offset} ticks)"
            )
    if not shifted:
        return _limits_refusal(servos, found)
    return (
        f"the zero has shifted since the calibration at {', '.join(shifted)}: other homing offsets were written into "
        f"the servos. {CALIBRATE_OR_WRITE_BACK}"
    )


def _limits_refusal(servos: ServoMap, found: Mapping[int, ServoFound]) -> str:
    """Return the reason not to drive servos whose range was shifted; wider and narrower ones are another's choice."""
    shifted = []
    for joint in servos.joints:
        low, high = found[joint.servo_id].settings.angle_limits_ticks
        low_by, high_by = low - joint.range_min, high - joint.range_max
        # A limit at the end of the turn is none: it was opened, not shifted.
        up = low_by > LIMITS_AGREE_WITHIN_TICKS and high_by > LIMITS_AGREE_WITHIN_TICKS and high != MAX_TICK
        down = low_by < -LIMITS_AGREE_WITHIN_TICKS and high_by < -LIMITS_AGREE_WITHIN_TICKS and low != 0
        if up or down:
            shifted.append(
                f"{servos.label(joint.servo_id)} {low} to {high} instead of {joint.range_min} to "
                f"{joint.range_max} ticks"
            )
    if not shifted:
        return ""
    return (
        f"the angle limits are of another zero than the homing offset at {', '.join(shifted)}: the writing of a "
        f"calibration was broken off. {CALIBRATE_OR_WRITE_BACK}"
    )


def change_refusal(
    servos: ServoMap, before: Mapping[int, ServoFound], found: Mapping[int, ServoFound], *, offsets_known: bool
) -> str:
    """Return the reason not to drive servos whose calibration has changed since the arm was connected, empty for none.

    Args:
        servos: servos of the arm.
        before: servos as first surveyed, by id.
        found: servos as surveyed last, by id.
        offsets_known: True if the calibration has the servos' homing offsets: servos that agree with it may be driven.
    """
    changed = []
    for joint in servos.joints:
        was, held = (_calibrated_registers(each[joint.servo_id]) for each in (before, found))
        calibrated = joint.homing_offset, joint.range_min, joint.range_max
        if held != was and not (offsets_known and held == calibrated):
            changed.append(
                f"{servos.label(joint.servo_id)} (offset {was[0]} to {held[0]}, limits {was[1]}..{was[2]} to "
                f"{held[1]}..{held[2]} ticks)"
            )
    if not changed:
        return ""
    return (
        f"the servos do not have the calibration in use any longer at {', '.join(changed)}. {CALIBRATE_OR_WRITE_BACK}"
    )


def _calibrated_registers(found: ServoFound) -> tuple[int, int, int]:
    return found.settings[Register.HOMING_OFFSET], *found.settings.angle_limits_ticks


def read_control(bus: Bus, servo_id: int) -> Steps[Control]:
    """Read the control block of a servo, as a sequence.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    frame = yield from read_block(bus, servo_id, CONTROL_ADDRESS, CONTROL_BYTES)
    return parse_control(frame.data)


def read_settings(bus: Bus, servo_id: int) -> Steps[ServoSettings]:
    """Read the settings of a servo in one transaction, as a sequence.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    frame = yield from read_block(bus, servo_id, SETTINGS_ADDRESS, SETTINGS_BYTES)
    return parse_settings(frame.data)


class RegisterChecks:
    """Comparison of the servos' control blocks with what was written to them.

    Args:
        servos: servos of the arm.
        found: servos as surveyed, by id; may be filled later.

    Attributes:
        torque_on: register TORQUE_ENABLE of each servo when it was last read back, by id.
    """

    def __init__(self, servos: ServoMap, found: dict[int, ServoFound]) -> None:
        self._servos = servos
        self._found = found
        self._turn = cycle(servos.ids)
        self._cycle = 0
        self._expected: dict[int, int] = {}
        self.torque_on: dict[int, bool] = {}

    def due(self) -> int | None:
        """Return the servo to read back in this cycle, if any."""
        self._cycle += 1
        return None if self._cycle % CYCLES_BETWEEN else next(self._turn)

    def expect(self, permille: dict[int, int]) -> None:
        """Expect these torque limits, which were written to the servos, by id [0.1 %]."""
        self._expected = dict(permille)
        self.torque_on.clear()

    def limits_to_write(self, permille: dict[int, int]) -> dict[int, int]:
        """Return the torque limits that differ from the expected ones, and expect them, by id [0.1 %]."""
        if permille == self._expected:
            return {}
        changed = {servo: limit for servo, limit in permille.items() if self._expected.get(servo) != limit}
        self._expected.update(changed)
        return changed

    def check(self, servo_id: int, control: Control, stamp_s: float) -> Fault | None:
        """Compare the control block of a driven servo with what was written to it.

        Args:
            servo_id: id of the servo.
            control: its control block.
            stamp_s: wall-clock time [s since the epoch].

        Returns:
            Fault of a servo that has rebooted or was relaxed, None otherwise.
        """
        self.torque_on[servo_id] = control.torque_on
        wanted = self._expected.get(servo_id)
        if wanted != control.torque_limit_permille:
            self._expected.pop(servo_id, None)
        fresh = self._found[servo_id].settings[Register.MAX_TORQUE]
        rebooted = control.torque_limit_permille == fresh != wanted
        joint = self._servos.by_id[servo_id].joint
        if rebooted and wanted is not None:
            return Fault(FaultCode.SERVO_REBOOTED, f"the servo of joint {joint} has started anew", joint, stamp_s)
        if not control.torque_on:
            return Fault(FaultCode.TORQUE_LOST, f"the servo of joint {joint} was found relaxed", joint, stamp_s)
        return None


def _check_present(bus: Bus, servos: ServoMap, *, simulated: bool) -> Steps[dict[int, int]]:
    """Return the model number of each servo, by id."""
    models = {}
    for joint in servos.joints:
        model = yield from _ping(bus, joint.servo_id)
        if model is not None:
            models[joint.servo_id] = model
    if not models:
        raise StartupError(f"no servo answers{'' if simulated else NONE_ANSWERS_ADVICE}")
    if missing := [servos.label(joint.servo_id) for joint in servos.joints if joint.servo_id not in models]:
        raise StartupError(f"no answer from {', '.join(missing)}{'' if simulated else MISSING_ADVICE}")
    for joint in servos.joints:
        model = models[joint.servo_id]
        if model not in (_named_model(joint), *MODELS.values()):
            known = ", ".join(f"{name.upper()} ({number})" for name, number in MODELS.items())
            raise StartupError(
                f"servo {joint.servo_id} ({joint.joint}) is model {model}, none of {known}: if it is a clone with "
                f'their registers, write model = "{model}" for it into the robot.toml of the arm'
            )
    return models


def _named_model(joint: JointCalibration) -> int:
    """Return the model number that the robot's folder names, by name or by number."""
    name = joint.servo.model
    return int(name) if name.isdecimal() else MODELS.get(name, MODELS["sts3215"])


def _ping(bus: Bus, servo_id: int) -> Steps[int | None]:
    for _ in range(STEP_ATTEMPTS):
        yield 0.0
        with contextlib.suppress(NoReply):
            return bus.ping(servo_id, attempts=1)
    return None


def _check_mode(joint: JointCalibration, settings: ServoSettings) -> None:
    mode = settings[Register.OPERATING_MODE]
    if mode != POSITION_MODE:
        raise StartupError(
            f"servo {joint.servo_id} ({joint.joint}) is in operating mode {mode}, not position mode {POSITION_MODE}: "
            "armbridge setup --registers sets it"
        )


def _warnings(
    joint: JointCalibration, found: ServoFound, profile: str, usual_firmware: tuple[int, int]
) -> Iterator[ServoWarning]:
    settings = found.settings
    if found.model != _named_model(joint):
        sentence = f"the servo is model {found.model}, not {_named_model(joint)}: its speed and torque may be others"
        yield ServoWarning(ServoAlert.MODEL, sentence)
    calibrated = joint.range_min, joint.range_max
    limits = settings.angle_limits_ticks
    if max(abs(a - b) for a, b in zip(limits, calibrated, strict=True)) > LIMITS_AGREE_WITHIN_TICKS:
        sentence = f"the servo's angle limits {limits} differ from the calibrated range {calibrated} ticks"
        yield ServoWarning(ServoAlert.ANGLE_LIMITS, sentence)
    if settings[Register.PHASE] & PHASE_MULTI_TURN:
        sentence = "the servo counts several turns (register PHASE, bit 4), so that its position may overflow"
        yield ServoWarning(ServoAlert.SEVERAL_TURNS, sentence)
    if delay := settings[Register.RETURN_DELAY]:
        sentence = f"{meaning(Register.RETURN_DELAY, delay)}: set register RETURN_DELAY to 0"
        yield ServoWarning(ServoAlert.RETURN_DELAY, sentence)
    if not found.control.locked:
        sentence = (
            "the servo's EPROM is unlocked (register LOCK), as lerobot leaves it, so that what is written by mistake "
            "stays: armbridge setup --registers locks it"
        )
        yield ServoWarning(ServoAlert.EPROM_UNLOCKED, sentence)
    if settings.firmware != usual_firmware:
        sentence = "the servo has firmware {}.{}, most others {}.{}".format(*settings.firmware, *usual_firmware)
        yield ServoWarning(ServoAlert.FIRMWARE, sentence)
    for register, value in found.expected.items():
        held = settings[register]
        consequence = meaning(register, held)
        sentence = (
            f"register {register.name} is {held}, not {value} as in the profile {profile}"
            f"{consequence and f': {consequence}'}"
        )
        yield ServoWarning(ServoAlert.REGISTER, sentence, register.name)

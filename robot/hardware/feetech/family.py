"""Feetech's STS series, STS3215 and STS3250, and the calibration in their EPROM.

A servo whose supply dips reboots, with torque off and its torque limit at register MAX_TORQUE.
"""

import contextlib
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from robot.calibration import Calibration, JointCalibration
from robot.description.servo_table import ServoSpec
from robot.errors import PortError, RobotError, StartupError
from robot.faults import ServoAlert, ServoWarning
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.profiles import FACTORY, ServoProfile, meaning, nearest_profile
from robot.hardware.feetech.registers import (
    AMPERE_PER_UNIT,
    CONTROL,
    FREE_SPEED_RAD_S,
    GOAL_ADDRESS,
    MODELS,
    PERCENT,
    PERMILLE,
    PROTECTION_TIME_UNIT_S,
    SETTINGS,
    SETTINGS_BLOCK,
    STALL_CURRENT_A,
    TABLE,
    TELEMETRY,
    VOLT_PER_UNIT,
    Register,
    parse_telemetry,
)
from robot.hardware.interface import Actuation, Result, Steps, run_to_end
from robot.hardware.servos.bus import ATTEMPTS, ServoBus, StatusFrame, read, write_verified
from robot.hardware.servos.family import Difference, Limit, ServoFamily, ServoFound, Values, label
from robot.hardware.servos.registers import Block, Telemetry
from robot.hardware.servos.survey import limits_warnings
from robot.trajectory import Vector


def calibrated_registers(joint: JointCalibration) -> dict[Register, int]:
    """Return a joint's calibrated registers in the order of writing: never a new offset with old limits."""
    return {
        Register.MIN_ANGLE_LIMIT: joint.range_min,
        Register.MAX_ANGLE_LIMIT: joint.range_max,
        Register.HOMING_OFFSET: joint.homing_offset,
    }


def differences(calibration: Calibration, held: Mapping[int, Mapping[Register, int]]) -> list[Difference]:
    """Compare a calibration with the registers of servos by id; joints of other servos are left out."""
    return [
        Difference(joint.joint, joint.servo_id, register, value, held[joint.servo_id][register])
        for joint in calibration.joints
        if joint.servo_id in held
        for register, value in calibrated_registers(joint).items()
        if held[joint.servo_id][register] != value
    ]


def read_differences(bus: ServoBus, calibration: Calibration) -> Steps[list[Difference]]:
    """Compare a calibration with the servos' registers, as a sequence; raises NoReply."""
    held: dict[int, dict[Register, int]] = {}
    for joint in calibration.joints:
        held[joint.servo_id] = {}
        for register in calibrated_registers(joint):
            held[joint.servo_id][register] = yield from read(bus, joint.servo_id, register)
    return differences(calibration, held)


def write_to_servos(bus: ServoBus, changes: Sequence[Difference]) -> Steps[None]:
    """Write a calibration to servos without torque, as a sequence; EPROM wears, so only what differs is written.

    A servo takes all of its changes or, after an error or when the sequence is given up, none, as far as it answers.
    Its EPROM is locked again in either case. Raises StartupError for a servo that keeps another value, and NoReply.
    """
    for servo_id in dict.fromkeys(change.servo_id for change in changes):
        own = [change for change in changes if change.servo_id == servo_id]
        yield from write_verified(bus, servo_id, Register.TORQUE_ENABLE, 0)
        try:
            yield from write_verified(bus, servo_id, Register.LOCK, 0)
            for change in own:
                if (yield from read(bus, servo_id, change.register)) != change.calibrated:
                    yield from write_verified(bus, servo_id, change.register, change.calibrated)
            yield from write_verified(bus, servo_id, Register.LOCK, 1)
        except BaseException:
            _undo_and_lock(bus, servo_id, own)
            raise


def _undo_and_lock(bus: ServoBus, servo_id: int, changes: Sequence[Difference]) -> None:
    """Undo the changes of a servo that has not taken all, and lock its EPROM, at once: no steps follow."""
    with contextlib.suppress(RobotError):
        _undo_incomplete(bus, changes)
    for _ in range(ATTEMPTS):
        try:
            _at_once(write_verified(bus, servo_id, Register.LOCK, 1))
        except PortError:
            return
        except RobotError:
            continue
        return


def _undo_incomplete(bus: ServoBus, changes: Sequence[Difference]) -> None:
    """Write the former values back, the offset first, unless the last change has been made and so all have."""
    if _at_once(read(bus, changes[-1].servo_id, changes[-1].register)) == changes[-1].calibrated:
        return
    for change in reversed(changes):
        if _at_once(read(bus, change.servo_id, change.register)) != change.in_servo:
            _at_once(write_verified(bus, change.servo_id, change.register, change.in_servo))


def _at_once(steps: Steps[Result]) -> Result:
    return run_to_end(steps, lambda _wait_s: None)


# Register ACCELERATION: its largest value, 39 rad/s^2. Smoothness comes from the trajectory, and any less adds lag.
ACCELERATION = 254

POSITION_MODE = 0  # Register OPERATING_MODE of a servo that follows position goals
PHASE_MULTI_TURN = 0x10  # Register PHASE, bit 4: positions count on beyond one turn, and overflow
NO_LIMITS = (0, 0)  # registers MIN_ANGLE_LIMIT and MAX_ANGLE_LIMIT of a servo without limits


def check_model(servo_id: int, joint: ServoSpec, model: int) -> None:
    """Raise StartupError for a servo of an unknown model, whose registers may have other meanings."""
    if model not in MODELS.values() and str(model) != joint.model:
        known = ", ".join(f"{name.upper()} ({number})" for name, number in MODELS.items())
        raise StartupError(
            f"servo {servo_id} ({joint.joint}) is model {model}, not one of {known}: if it is a clone with their "
            f'registers, write model = "{model}" for it into the robot.toml of the arm'
        )


class Feetech(ServoFamily):
    """Servos of one arm, with the settings that they should have; by default the nearest known profile's."""

    bus = Bus
    registers = TABLE
    motion = telemetry = TELEMETRY
    read_back = (CONTROL,)
    goal_address = GOAL_ADDRESS
    torque_on_clears_errors = True
    none_answers_advice = ": is the arm powered, and the adapter's jumper on B?"
    calibrate_advice = (
        "calibrate the arm (armbridge calibrate NAME) and name the calibration (arm.calibration, --calibration NAME)"
    )
    recalibrate_advice = (
        "Either calibrate the arm again (armbridge calibrate NAME --write-servos), or write the calibrated offsets and "
        "limits back (armbridge calibrate NAME --write-back)"
    )

    def __init__(self, profile: ServoProfile | None = None) -> None:
        self._profile = profile

    def check_model(self, joint: JointCalibration, model: int) -> None:
        check_model(joint.servo_id, joint.servo, model)

    def survey_blocks(self, joint: JointCalibration) -> Sequence[Block[Register]]:
        return SETTINGS_BLOCK, CONTROL

    def check_settings(self, joint: JointCalibration, values: Values) -> None:
        mode = values[Register.OPERATING_MODE]
        if mode != POSITION_MODE:
            raise StartupError(
                f"servo {joint.servo_id} ({joint.joint}) is in operating mode {mode}, not position mode "
                f"{POSITION_MODE}: armbridge setup --registers sets it"
            )

    def compare(self, joints: Sequence[JointCalibration], found: Mapping[int, ServoFound]) -> dict[int, ServoFound]:
        held = [(found[joint.servo_id].values, joint.servo.gripper) for joint in joints]
        profile = self._profile or nearest_profile(held)
        versions = Counter(_firmware(values) for values, _ in held)
        usual_firmware = max(versions, key=lambda version: (versions[version], version))
        compared = {}
        for joint in joints:
            servo = found[joint.servo_id]
            expected = profile.differences(servo.values, gripper=joint.servo.gripper)
            warnings = (
                *_warnings(joint, servo, usual_firmware),
                *_profile_warnings(servo.values, expected, profile.name),
            )
            compared[joint.servo_id] = replace(servo, expected=expected, warnings=warnings)
        return compared

    def position_limits_ticks(self, values: Values) -> tuple[int, int]:
        return values[Register.MIN_ANGLE_LIMIT], values[Register.MAX_ANGLE_LIMIT]

    def goal_limits_ticks(self, values: Values, certain_ticks: tuple[int, int]) -> tuple[int, int]:
        """Return the angle limits, to which a servo clamps its goals."""
        limits = self.position_limits_ticks(values)
        return Register.GOAL_POSITION.value_range if limits == NO_LIMITS else limits

    def max_voltage_v(self, values: Values) -> float:
        return values[Register.MAX_VOLTAGE] * VOLT_PER_UNIT

    def free_speed_rad_s(self, joint: JointCalibration) -> float:
        return FREE_SPEED_RAD_S

    def actuation(self, joints: Sequence[JointCalibration], found: Mapping[int, ServoFound]) -> Actuation:
        plain = super().actuation(joints, found)

        def each(register: Register) -> Vector:
            return np.array([float(found[joint.servo_id].values[register]) for joint in joints])

        def threshold(register: Register) -> Vector:
            """Return the values of a register in which 0 means no protection: a threshold of 0 would always trip."""
            values = each(register)
            return np.where(values > 0.0, values, np.inf)

        return plain._replace(
            stiffness=each(Register.P_GAIN) / FACTORY.registers[Register.P_GAIN],
            max_torque=each(Register.MAX_TORQUE) / PERMILLE,
            overload_torque=threshold(Register.OVERLOAD_TORQUE) / PERCENT,
            overload_time_s=threshold(Register.PROTECTION_TIME) * PROTECTION_TIME_UNIT_S,
            overload_current_a=threshold(Register.PROTECTION_CURRENT) * AMPERE_PER_UNIT,
            stall_current_a=np.full(len(joints), STALL_CURRENT_A),
        )

    def settings(self, values: Values) -> dict[str, int]:
        return {register.name: values[register] for register in SETTINGS}

    def parse_telemetry(self, frame: StatusFrame, joint: JointCalibration) -> Telemetry:
        """Parse registers 56 to 70; the error byte of the reply has status flags too."""
        telemetry = parse_telemetry(frame.data)
        telemetry.status |= frame.error
        return telemetry

    def around_goal(self, speed_ticks_s: float) -> tuple[bytes, bytes]:
        cap = Register.GOAL_VELOCITY.encode(math.ceil(speed_ticks_s))
        return Register.ACCELERATION.encode(ACCELERATION), Register.GOAL_TIME.encode(0) + cap

    def limit(self, joint: JointCalibration, values: Values, share: float) -> Limit:
        return Limit(Register.TORQUE_LIMIT, round(share * PERMILLE))

    def clear_error(self, bus: ServoBus, joint: JointCalibration) -> Steps[None]:
        """Switch torque off; a firmware with which the overload stays latched needs a power cycle."""
        try:
            yield from write_verified(bus, joint.servo_id, Register.TORQUE_ENABLE, 0)
        except StartupError as error:
            raise StartupError(
                f"the overload of {label(joint)} stays latched, and the servo ignores torque off: switch the servos' "
                "supply off and on"
            ) from error

    def has_restarted(self, found: ServoFound, values: Values, limit: Limit) -> bool:
        """Return True for the torque limit of a servo after power-up."""
        return values.get(Register.TORQUE_LIMIT) == found.values[Register.MAX_TORQUE] != limit.value

    read_differences = staticmethod(read_differences)
    write_differences = staticmethod(write_to_servos)


def _firmware(values: Values) -> tuple[int, int]:
    return values[Register.FIRMWARE_MAJOR], values[Register.FIRMWARE_MINOR]


def _named_model(joint: JointCalibration) -> int:
    name = joint.servo.model
    return int(name) if name.isdecimal() else MODELS.get(name, MODELS["sts3215"])


def _warnings(joint: JointCalibration, found: ServoFound, usual_firmware: tuple[int, int]) -> Iterator[ServoWarning]:
    values = found.values
    limits = values[Register.MIN_ANGLE_LIMIT], values[Register.MAX_ANGLE_LIMIT]
    if found.model != _named_model(joint):
        sentence = f"the servo is model {found.model}, not {_named_model(joint)}: its speed and torque may be others"
        yield ServoWarning(ServoAlert.MODEL, sentence)
    yield from limits_warnings(joint, ServoAlert.ANGLE_LIMITS, limits)
    if values[Register.PHASE] & PHASE_MULTI_TURN:
        sentence = "the servo counts several turns (register PHASE, bit 4), so that its position may overflow"
        yield ServoWarning(ServoAlert.SEVERAL_TURNS, sentence)
    if delay := values[Register.RETURN_DELAY]:
        sentence = f"{meaning(Register.RETURN_DELAY, delay)}: set register RETURN_DELAY to 0"
        yield ServoWarning(ServoAlert.RETURN_DELAY, sentence)
    if values[Register.LOCK] != 1:
        sentence = (
            "the servo's EPROM is unlocked (register LOCK), as lerobot leaves it, so that a value written by mistake "
            "stays: armbridge setup --registers locks it"
        )
        yield ServoWarning(ServoAlert.EPROM_UNLOCKED, sentence)
    if (firmware := _firmware(values)) != usual_firmware:
        sentence = "the servo has firmware {}.{}, most others {}.{}".format(*firmware, *usual_firmware)
        yield ServoWarning(ServoAlert.FIRMWARE, sentence)


def _profile_warnings(values: Values, expected: Mapping[Register, int], profile: str) -> Iterator[ServoWarning]:
    for register, value in expected.items():
        consequence = meaning(register, values[register])
        sentence = (
            f"register {register.name} is {values[register]}, not {value} as in the profile {profile}"
            f"{consequence and f': {consequence}'}"
        )
        yield ServoWarning(ServoAlert.REGISTER, sentence, register.name)

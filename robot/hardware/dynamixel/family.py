"""Dynamixel's X series: XL430-W250 and XL330-M288, and the packets of protocol 2.0.

A servo in current-based position mode, the gripper where it has current control, is limited by GOAL_CURRENT, any other
by GOAL_PWM. Every servo that is driven has its bus watchdog armed: it stops by itself when this computer fails.

Instruction ``FF FF FD 00 ID LEN LEN INST P.. CRC CRC``, status ``FF FF FD 00 ID LEN LEN 55 ERR P.. CRC CRC``; LEN
counts what follows it, little endian. Behind every ``FF FF FD`` from INST to the last parameter one more ``FD`` is
stuffed, so that no header can be in a packet; LEN and CRC count the stuffed bytes (e-manual, DYNAMIXEL Protocol 2.0).
"""

import contextlib
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

from dynamixel_sdk import INST_REBOOT, INST_STATUS, PacketHandler

from robot.calibration import JointCalibration
from robot.errors import NoReply, StartupError
from robot.faults import ServoAlert, ServoWarning
from robot.hardware.dynamixel.registers import (
    AMPERE_PER_UNIT,
    FULL_PWM,
    HARDWARE_ERRORS,
    MAX_HOMING_OFFSET_IN_POSITION_MODE,
    MODELS,
    MOTION,
    PLAIN_DRIVE_MODE,
    TABLE,
    TELEMETRY,
    TICKS_S2_PER_ACCELERATION_UNIT,
    TICKS_S_PER_VELOCITY_UNIT,
    VOLT_PER_UNIT,
    WATCHDOG_TRIPPED,
    WATCHDOG_UNIT_S,
    Model,
    OperatingMode,
    Register,
    status_of,
)
from robot.hardware.interface import StatusFlag, Steps
from robot.hardware.servos.bus import ServoBus, StatusFrame, read, write_verified
from robot.hardware.servos.family import Limit, ServoFamily, ServoFound, Values, Watchdog, label
from robot.hardware.servos.registers import RETURN_DELAY_UNIT_US, Block, Telemetry
from robot.hardware.servos.survey import limits_warnings

HEADER = b"\xff\xff\xfd\x00"
_HEADER_IN_BODY = b"\xff\xff\xfd"
STUFFED = b"\xff\xff\xfd\xfd"

PREFIX_BYTES = 7  # header, id and LEN: what LEN does not count
LENGTH_OVERHEAD = 3  # INST and CRC; a status packet has ERR as well
STATUS_OVERHEAD_BYTES = 11  # bytes of a status packet besides its data: header, id, LEN, INST, ERR, CRC

# Bit of ERR: HARDWARE_ERROR_STATUS is not 0. The other bits are the number of an error of the instruction.
ALERT = 0x80

MAX_PACKET_BYTES = 1024  # longest packet of the SDK

PROTOCOL = 2.0
_SDK = PacketHandler(PROTOCOL)


def crc16(data: bytes) -> int:
    return _SDK.updateCRC(0, data, len(data))


def packet(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    body = bytes([instruction]) + parameters
    body = body.replace(_HEADER_IN_BODY, STUFFED)
    head = HEADER + bytes([servo_id]) + (len(body) + LENGTH_OVERHEAD - 1).to_bytes(2, "little") + body
    return head + crc16(head).to_bytes(2, "little")


def instruction_packet(servo_id: int, instruction: int, parameters: Sequence[int] = ()) -> list[int]:
    """Build an instruction for ``txPacket`` of ``dynamixel_sdk``, which adds header and CRC.

    Raises ValueError for a longer packet than the SDK sends, and for a packet that needs a stuffed byte: version 4.1.0
    computes it and sends the packet without it.
    """
    size = PREFIX_BYTES + LENGTH_OVERHEAD + len(parameters)
    if size > MAX_PACKET_BYTES:
        raise ValueError(f"a packet has at most {MAX_PACKET_BYTES} bytes, not {size}")
    if _HEADER_IN_BODY in bytes(parameters):
        raise ValueError("an instruction must not have the bytes of a header, FF FF FD, among its parameters")
    length = len(parameters) + LENGTH_OVERHEAD
    return [0, 0, 0, 0, servo_id, length & 0xFF, length >> 8, instruction, *parameters, 0, 0]


def status_bytes(data_length: int, replies: int = 1) -> int:
    """Count the bytes of ``replies`` status packets with ``data_length`` bytes of data each, without stuffing."""
    return replies * (data_length + STATUS_OVERHEAD_BYTES)


def parse_status_frames(received: bytes, expected_ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
    """Find the replies of the expected servos in the bytes received since the instruction, by id.

    A frame counts only if its header, id, LEN, INST and CRC fit, and its servo has not sent a different one. Noise
    between frames is skipped. A reply that reports an error of the instruction has no data, so that it counts only
    where none is expected.
    """
    frames: dict[int, StatusFrame] = {}
    contradicted: set[int] = set()
    at = received.find(HEADER)
    while at >= 0:
        frame, end = _frame_at(received, at)
        expected = frame is not None and frame.servo_id in expected_ids and len(frame.data) == data_length
        if frame is not None and expected and frames.setdefault(frame.servo_id, frame) != frame:
            contradicted.add(frame.servo_id)
        at = received.find(HEADER, end)
    return {servo_id: frame for servo_id, frame in frames.items() if servo_id not in contradicted}


def _frame_at(received: bytes, at: int) -> tuple[StatusFrame | None, int]:
    """Parse the packet whose header is at ``at``; return it, None if it is invalid, and the end of what was used."""
    length_at = at + len(HEADER) + 1
    end = at + PREFIX_BYTES + int.from_bytes(received[length_at : length_at + 2], "little")
    whole = received[at:end]
    if end > len(received) or len(whole) < STATUS_OVERHEAD_BYTES or whole[PREFIX_BYTES] != INST_STATUS:
        return None, at + 1
    if crc16(whole[:-2]) != int.from_bytes(whole[-2:], "little"):
        return None, at + 1
    body = whole[PREFIX_BYTES:-2].replace(STUFFED, _HEADER_IN_BODY)
    return StatusFrame(whole[len(HEADER)], body[1], body[2:]), end


# Register PROFILE_ACCELERATION, 39 rad/s^2: smoothness comes from the trajectory, and any less adds lag.
PROFILE_ACCELERATION = round(25400 / TICKS_S2_PER_ACCELERATION_UNIT)

# 0.5 s without an instruction stop a driven servo where it is. A busy computer makes shorter pauses, and goals
# are streamed, so that a servo is never far from its last one.
SILENCE_S = 0.5
WATCHDOG = round(SILENCE_S / WATCHDOG_UNIT_S)

# Time after which a rebooted servo answers again at the earliest, and intervals and number of further tries. The
# e-manual states none; start-up takes a few tenths of a second.
REBOOT_S = 0.3
REBOOT_RETRY_S = 0.1
REBOOT_TRIES = 20

_MOTION = struct.Struct("<hhii")
_SUPPLY = struct.Struct("<HB")
_SUPPLY_AT = Register.PRESENT_INPUT_VOLTAGE - MOTION.address

# What a survey reads, register by register: the addresses between them are not documented.
_SURVEYED = (
    Register.FIRMWARE_VERSION,
    Register.OPERATING_MODE,
    Register.DRIVE_MODE,
    Register.HOMING_OFFSET,
    Register.MIN_POSITION_LIMIT,
    Register.MAX_POSITION_LIMIT,
    Register.GOAL_POSITION,
    Register.PRESENT_POSITION,
    Register.TORQUE_ENABLE,
    Register.MAX_VOLTAGE_LIMIT,
    Register.PWM_LIMIT,
)


class Bus(ServoBus):
    """Bus of Dynamixel servos, protocol 2.0; the SDK would poll up to 34 ms for each reply, more than three ticks."""

    registers = TABLE
    word_bytes = 2
    reply_delay_s = 254 * RETURN_DELAY_UNIT_US * 1e-6  # the most of RETURN_DELAY_TIME; the factory's 250 is hardly less
    # 4, 6 (out of range) or 7 (cannot be written now); e-manual, DYNAMIXEL Protocol 2.0, Status Packet.
    instruction_error_bits = ~ALERT
    _make_sdk = staticmethod(partial(PacketHandler, PROTOCOL))
    _packet = staticmethod(instruction_packet)
    _parse_replies = staticmethod(parse_status_frames)
    _reply_bytes = staticmethod(status_bytes)

    def _added_bytes(self, received: bytes) -> int:
        return received.count(STUFFED)

    def _note_disturbance(self) -> None:
        super()._note_disturbance()
        # A reply that has not come yet may still come.
        self._last_byte_s = self._clock()


class Dynamixel(ServoFamily):
    """Servos of one arm."""

    bus = Bus
    registers = TABLE
    motion = MOTION
    telemetry = TELEMETRY
    read_back = TABLE.block(Register.TORQUE_ENABLE), TABLE.block(Register.BUS_WATCHDOG)
    goal_address = Register.GOAL_POSITION
    # A relaxed servo may set its goal to its position, which jitters.
    goal_within_ticks = 8
    counts_turns = True
    watchdog = Watchdog(Register.BUS_WATCHDOG, WATCHDOG, WATCHDOG_TRIPPED, SILENCE_S)
    error_register = Register.HARDWARE_ERROR_STATUS
    latched_status = sum(HARDWARE_ERRORS.values(), StatusFlag(0))
    assumes_no_offsets = True
    none_answers_advice = ": is the arm powered, and are its servos set to 1,000,000 baud?"
    calibrate_advice = "calibrate the arm with lerobot, and name the calibration (arm.calibration, --calibration NAME)"

    def check_model(self, joint: JointCalibration, model: int) -> None:
        named = model_of(joint)
        if model != named.number:
            raise StartupError(f"servo {label(joint)} is model {model}, not {named.name} ({named.number})")

    def survey_blocks(self, joint: JointCalibration) -> Sequence[Block[Register]]:
        current = (Register.CURRENT_LIMIT,) if model_of(joint).has_current else ()
        return [TABLE.block(register) for register in (*_SURVEYED, *current)]

    def check_settings(self, joint: JointCalibration, values: Values) -> None:
        has_current, mode = model_of(joint).has_current, values[Register.OPERATING_MODE]
        modes = [each for each in OperatingMode if has_current or each is not OperatingMode.CURRENT_BASED_POSITION]
        to_extended = f"set register OPERATING_MODE (11) to {int(OperatingMode.EXTENDED_POSITION)}"
        if mode not in modes:
            known = ", ".join(str(int(each)) for each in modes)
            raise StartupError(
                f"servo {label(joint)} is in operating mode {mode}, not a mode of position control ({known}): "
                f"{to_extended}"
            )
        offset = values[Register.HOMING_OFFSET]
        if mode == OperatingMode.POSITION and abs(offset) > MAX_HOMING_OFFSET_IN_POSITION_MODE:
            raise StartupError(
                f"servo {label(joint)} is in operating mode {mode}, in which it ignores its homing offset of {offset} "
                f"ticks (more than {MAX_HOMING_OFFSET_IN_POSITION_MODE}): {to_extended}"
            )
        if values[Register.DRIVE_MODE] != PLAIN_DRIVE_MODE:
            raise StartupError(
                f"servo {label(joint)} has drive mode {values[Register.DRIVE_MODE]}, which changes its direction, "
                f"profile or torque: set register DRIVE_MODE (10) to {PLAIN_DRIVE_MODE}"
            )

    def compare(self, joints: Sequence[JointCalibration], found: Mapping[int, ServoFound]) -> dict[int, ServoFound]:
        each = ((joint, found[joint.servo_id]) for joint in joints)
        return {
            joint.servo_id: replace(servo, warnings=tuple(self._warnings(joint, servo.values))) for joint, servo in each
        }

    def position_limits_ticks(self, values: Values) -> tuple[int, int]:
        return values[Register.MIN_POSITION_LIMIT], values[Register.MAX_POSITION_LIMIT]

    def goal_limits_ticks(self, values: Values, certain_ticks: tuple[int, int]) -> tuple[int, int]:
        """Return a servo's own limits in position mode; e-manual, Min/Max Position Limit (48, 52)."""
        if values[Register.OPERATING_MODE] != OperatingMode.POSITION:
            return certain_ticks
        lowest, highest = self.position_limits_ticks(values)
        return max(certain_ticks[0], lowest), min(certain_ticks[1], highest)

    def max_voltage_v(self, values: Values) -> float:
        return values[Register.MAX_VOLTAGE_LIMIT] * VOLT_PER_UNIT

    def free_speed_rad_s(self, joint: JointCalibration) -> float:
        return model_of(joint).free_speed_rad_s

    def has_watchdog(self, joint: JointCalibration, values: Values) -> bool:
        return values[Register.FIRMWARE_VERSION] >= model_of(joint).watchdog_firmware

    def parse_telemetry(self, frame: StatusFrame, joint: JointCalibration) -> Telemetry:
        """Parse registers 124 to 135, or to 146 with supply and temperature."""
        pwm, current, velocity, position = _MOTION.unpack_from(frame.data)
        volts, temperature_c = math.nan, math.nan
        if len(frame.data) == TELEMETRY.length:
            volts, temperature_c = _SUPPLY.unpack_from(frame.data, _SUPPLY_AT)
        return Telemetry(
            position_ticks=position,
            velocity_ticks_s=velocity * TICKS_S_PER_VELOCITY_UNIT,
            load=pwm / FULL_PWM,
            current_a=current * AMPERE_PER_UNIT if model_of(joint).has_current else math.nan,
            voltage_v=volts * VOLT_PER_UNIT,
            temperature_c=temperature_c,
            reports_error=bool(frame.error & ALERT),
        )

    def status_of(self, error: int) -> StatusFlag:
        return status_of(error)

    def profile(self, speed_ticks_s: float) -> Values:
        velocity = math.ceil(speed_ticks_s / TICKS_S_PER_VELOCITY_UNIT)
        return {Register.PROFILE_ACCELERATION: PROFILE_ACCELERATION, Register.PROFILE_VELOCITY: velocity}

    def limit(self, joint: JointCalibration, values: Values, share: float) -> Limit:
        """Return a share of the stall current for a servo in current-based position mode, of the duty for others."""
        if values[Register.OPERATING_MODE] == OperatingMode.CURRENT_BASED_POSITION:
            wanted = round(share * model_of(joint).stall_current_ma)
            return Limit(Register.GOAL_CURRENT, min(wanted, values[Register.CURRENT_LIMIT]))
        return Limit(Register.GOAL_PWM, min(round(share * FULL_PWM), values[Register.PWM_LIMIT]))

    def prepare(self, bus: ServoBus, joint: JointCalibration, values: Values) -> Steps[Values]:
        """Bring a gripper with current control into current-based position mode."""
        mode = OperatingMode.CURRENT_BASED_POSITION
        if not (joint.servo.gripper and model_of(joint).has_current) or values[Register.OPERATING_MODE] == mode:
            return values
        yield from write_verified(bus, joint.servo_id, Register.OPERATING_MODE, mode)
        return {**values, Register.OPERATING_MODE: mode}

    def clear_error(self, bus: ServoBus, joint: JointCalibration) -> Steps[None]:
        """Reboot the servo, the only way to clear an error."""
        yield 0.0
        with contextlib.suppress(NoReply):
            bus.ask(joint.servo_id, instruction_packet(joint.servo_id, INST_REBOOT))
        yield REBOOT_S
        for _ in range(REBOOT_TRIES - 1):
            with contextlib.suppress(NoReply):
                yield from read(bus, joint.servo_id, Register.MODEL_NUMBER)
                return
            yield REBOOT_RETRY_S
        yield from read(bus, joint.servo_id, Register.MODEL_NUMBER)

    def has_restarted(self, found: ServoFound, values: Values, limit: Limit) -> bool:
        """Return True for a disarmed watchdog."""
        return values.get(Register.BUS_WATCHDOG) == 0

    def _warnings(self, joint: JointCalibration, values: Values) -> Iterator[ServoWarning]:
        yield from limits_warnings(joint, ServoAlert.POSITION_LIMITS, self.position_limits_ticks(values))
        if not self.has_watchdog(joint, values):
            sentence = (
                f"firmware {values[Register.FIRMWARE_VERSION]} has no bus watchdog, so that the servo does not notice "
                "when this computer fails: update it"
            )
            yield ServoWarning(ServoAlert.NO_WATCHDOG, sentence)


def model_of(joint: JointCalibration) -> Model:
    """Return the model of a joint's servo; raises StartupError for an unknown one."""
    model = MODELS.get(joint.servo.model)
    if model is None:
        raise StartupError(
            f"the servo of joint {joint.joint} is a {joint.servo.model!r} in the arm's robot.toml; known are "
            f"{', '.join(MODELS)}"
        )
    return model

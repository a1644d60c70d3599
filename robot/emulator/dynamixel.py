"""Emulated Dynamixel servos of the X series: control table, drive, protection, packets, and an arm of them.

Access, ranges and error numbers follow the e-manual's control tables of the XL430-W250 and XL330-M288 and its page
DYNAMIXEL Protocol 2.0, as far as they state them. Where they do not, the emulation is the harsher of what could be: the
goal after power-up is 0 at any position, torque on does not move the goal to the position, and a servo whose watchdog
is cleared goes on to its old goal.
"""

import math
from collections.abc import Callable, Iterable, Mapping

from dynamixel_sdk import INST_REBOOT, INST_STATUS

from robot.calibration import TICKS_PER_TURN, JointCalibration
from robot.description.limits import JointBounds
from robot.description.model import RobotModel
from robot.emulator.arm import EmulatedArm, start_pose_rad
from robot.emulator.plant import NO_LOAD_TICKS_S, STALL_CURRENT_A, Drive, Plant
from robot.emulator.servo import FULL_DUTY_PERMILLE, EmulatedServo, Thresholds
from robot.emulator.servo_bus import Codec, Instruction
from robot.hardware.config import EmulatedConfig
from robot.hardware.dynamixel.family import ALERT, HEADER, PREFIX_BYTES, Dynamixel, crc16, model_of, packet
from robot.hardware.dynamixel.registers import (
    FULL_PWM,
    HARDWARE_ERRORS,
    MAX_HOMING_OFFSET_IN_POSITION_MODE,
    TABLE,
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
from robot.hardware.interface import StatusFlag
from robot.hardware.servos.registers import Area
from robot.messages import GuardLimits

# Error numbers of a status packet.
INSTRUCTION_ERROR = 2
CRC_ERROR = 3
DATA_RANGE_ERROR = 4
DATA_LENGTH_ERROR = 5
DATA_LIMIT_ERROR = 6
ACCESS_ERROR = 7

MEMORY_BYTES = 256  # the last documented address is 227, of the XL330; addresses without a register read as 0

# Values of a new servo of every model.
_DEFAULTS: Mapping[Register, int] = {Register.FIRMWARE_VERSION: 52, Register.BAUD_RATE: 3, Register.PWM_LIMIT: FULL_PWM}
_DEFAULTS_OF_MODEL: Mapping[str, Mapping[Register, int]] = {
    "xl430-w250": {
        Register.TEMPERATURE_LIMIT: 72,
        Register.MAX_VOLTAGE_LIMIT: 140,
        Register.MIN_VOLTAGE_LIMIT: 60,
        Register.VELOCITY_LIMIT: 265,
        Register.SHUTDOWN: 52,
    },
    "xl330-m288": {
        Register.TEMPERATURE_LIMIT: 70,
        Register.MAX_VOLTAGE_LIMIT: 70,
        Register.MIN_VOLTAGE_LIMIT: 35,
        Register.CURRENT_LIMIT: 1750,
        Register.VELOCITY_LIMIT: 445,
        Register.SHUTDOWN: 53,
    },
}

# The Koch's supplies: 12 V for the XL430, 5 V for the XL330.
SUPPLY_V: Mapping[str, float] = {"xl430-w250": 12.0, "xl330-m288": 5.0}

_CURRENT_REGISTERS = frozenset({Register.CURRENT_LIMIT, Register.GOAL_CURRENT})  # registers of the XL330 alone

# "Goal values", which are read-only while the watchdog has stopped the servo.
_GOALS = frozenset({Register.GOAL_PWM, Register.GOAL_CURRENT, Register.GOAL_POSITION})

_PROFILE = (Register.PROFILE_VELOCITY, Register.PROFILE_ACCELERATION)

# Registers that a power cut clears.
_RAM = tuple(
    register
    for register in Register
    if register.area is not Area.EEPROM and register not in (Register.MODEL_NUMBER, Register.FIRMWARE_VERSION)
)

MOST_EXTENDED_TICKS = 1_048_575  # furthest goal of the modes that count turns
STIFFNESS = 32  # gain of :class:`robot.emulator.plant.Plant` with which a servo follows with a lag of 20 ms
UNLIMITED_TICKS_S2 = 1e7  # an acceleration of 0 is unlimited

# Share of the stall current that counts as overload, and the time that it must last; the e-manual states neither.
OVERLOAD_PERMILLE = 950.0
OVERLOAD_S = 1.0

MOVING_TICKS_S = 10 * TICKS_S_PER_VELOCITY_UNIT

REBOOT_S = 0.25  # reboot: time without an answer

# Friction in the gear carries most of a resting joint's weight; the share that is left for the motor is the one of an
# STS3215 (:mod:`robot.emulator.feetech`).
CARRIED_BY_MOTOR = 0.18

_BITS: Mapping[StatusFlag, int] = {flag: bit for bit, flag in HARDWARE_ERRORS.items()}


class DynamixelServo(EmulatedServo[Register]):
    """XL430 or XL330 on the bus, from power-up on; its encoder is absolute within one turn."""

    table = TABLE
    memory_bytes = MEMORY_BYTES
    return_delay = Register.RETURN_DELAY_TIME
    torque_limit = Register.GOAL_PWM
    full_torque = FULL_PWM
    baudrates = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)

    def __init__(
        self,
        servo_id: int,
        model: Model,
        plant: Plant,
        position_limits_ticks: tuple[int, int] = (0, TICKS_PER_TURN - 1),
        homing_offset_ticks: int = 0,
        mode: OperatingMode = OperatingMode.EXTENDED_POSITION,
        joint: str = "",
    ) -> None:
        # A Dynamixel adds its homing offset to the encoder's position.
        super().__init__(plant, joint, -homing_offset_ticks)
        self.model = model
        self.protection.latches = True
        self.voltage_v = SUPPLY_V[model.name]
        self.stall_torque_nm = model.stall_torque_nm
        self.duty_permille_per_nm = CARRIED_BY_MOTOR * FULL_DUTY_PERMILLE / model.stall_torque_nm
        self.writes = 0  # number of accepted writes
        values: Mapping[Register, int] = {
            **_DEFAULTS,
            **_DEFAULTS_OF_MODEL[model.name],
            Register.MODEL_NUMBER: model.number,
            Register.ID: servo_id,
            Register.OPERATING_MODE: mode,
            Register.HOMING_OFFSET: homing_offset_ticks,
            Register.MIN_POSITION_LIMIT: position_limits_ticks[0],
            Register.MAX_POSITION_LIMIT: position_limits_ticks[1],
        }
        for register, value in values.items():
            self.memory.set(register, value)
        self.power_up()

    def power_up(self) -> None:
        """Start as after a power cut: EEPROM as it was, RAM as after power-up, torque off, the count of turns lost."""
        for register in _RAM:
            self.memory.set(register, 0)
        self._reset_limits()
        self.kept_write = None
        self._heard_s = self._starts_in_s = 0.0
        self.protection.power_up()
        self._forget_turns()
        self._follow_status()

    def write(self, address: int, data: bytes) -> int:
        """Write whole registers as an instruction does; if one is refused, nothing is written."""
        wanted = self.memory.decode_block(address, data)
        if address not in TABLE.registers or any(
            address + at not in self.memory.register_at for at in range(len(data))
        ):
            return ACCESS_ERROR
        if sum(register.size for register in wanted) != len(data):
            return DATA_LENGTH_ERROR
        for register, value in wanted.items():
            if error := self._refusal(register, value):
                return error
        self.writes += 1
        if all(self.value(register) == value for register, value in wanted.items()):
            # Goals are written a hundred times a second, also while the arm rests.
            return 0
        for register, value in wanted.items():
            self.memory.set(register, value)
        if Register.OPERATING_MODE in wanted:
            self._reset_limits()
            self._clear_profile()
            self._forget_turns()
        self._follow_write(address)
        return 0

    @property
    def present_ticks(self) -> int:
        return round(self.plant.position_ticks) - self._turns_ticks + self._offset_ticks

    @property
    def error(self) -> int:
        return ALERT if self.value(Register.HARDWARE_ERROR_STATUS) else 0

    @property
    def listens(self) -> bool:
        return self.connected and self._starts_in_s <= 0.0

    def ping(self) -> bytes:
        return self.memory.read(Register.MODEL_NUMBER, 2) + self.memory.read(Register.FIRMWARE_VERSION, 1)

    def maintain(self, code: int) -> bool:
        if code == INST_REBOOT:
            self.power_up()
            self._starts_in_s = REBOOT_S
        return code == INST_REBOOT

    def fail(self, hardware_error: int) -> None:
        """Detect hardware errors, bits of HARDWARE_ERROR_STATUS, until the next reboot."""
        self.protection.latch(status_of(hardware_error))
        self.update_protection()

    def hear(self) -> None:
        self._heard_s = 0.0

    def step(self, duration_s: float) -> None:
        self._starts_in_s = max(0.0, self._starts_in_s - duration_s)
        super().step(duration_s)
        self._heard_s += duration_s
        watchdog = self.value(Register.BUS_WATCHDOG)
        if watchdog > 0 and self.value(Register.TORQUE_ENABLE) and self._heard_s > watchdog * WATCHDOG_UNIT_S:
            self._clear_profile()
            self.set(Register.BUS_WATCHDOG, WATCHDOG_TRIPPED)

    def _reset_limits(self) -> None:
        self.memory.set(Register.GOAL_PWM, self.value(Register.PWM_LIMIT))
        self.memory.set(Register.GOAL_CURRENT, self.value(Register.CURRENT_LIMIT))

    def _clear_profile(self) -> None:
        for register in _PROFILE:
            self.memory.set(register, 0)

    def _forget_turns(self) -> None:
        """Count turns from 0 again: the position is within one turn of the encoder."""
        self._turns_ticks = math.floor(self.plant.position_ticks / TICKS_PER_TURN) * TICKS_PER_TURN

    def _refusal(self, register: Register, value: int) -> int:
        area, has_register = register.area, self.model.has_current or register not in _CURRENT_REGISTERS
        if area is Area.READ_ONLY or not has_register or (area is Area.EEPROM and self.value(Register.TORQUE_ENABLE)):
            return ACCESS_ERROR
        if self.value(Register.BUS_WATCHDOG) == WATCHDOG_TRIPPED and register in _GOALS:
            return DATA_RANGE_ERROR
        shut_down = self.value(Register.HARDWARE_ERROR_STATUS) & self.value(Register.SHUTDOWN)
        if register is Register.TORQUE_ENABLE and value and shut_down:
            return ACCESS_ERROR
        if register is Register.BUS_WATCHDOG and not 0 <= value <= 127:
            return DATA_RANGE_ERROR
        lowest, highest = self._limits(register)
        return 0 if lowest <= value <= highest else DATA_LIMIT_ERROR

    def _limits(self, register: Register) -> tuple[int, int]:
        match register:
            case Register.TORQUE_ENABLE:
                return 0, 1
            case Register.GOAL_PWM:
                return -self.value(Register.PWM_LIMIT), self.value(Register.PWM_LIMIT)
            case Register.GOAL_CURRENT:
                return -self.value(Register.CURRENT_LIMIT), self.value(Register.CURRENT_LIMIT)
            case Register.GOAL_POSITION if self._in_position_mode:
                return self.value(Register.MIN_POSITION_LIMIT), self.value(Register.MAX_POSITION_LIMIT)
            case Register.GOAL_POSITION:
                return -MOST_EXTENDED_TICKS, MOST_EXTENDED_TICKS
        return register.value_range

    @property
    def _in_position_mode(self) -> bool:
        return self.value(Register.OPERATING_MODE) == OperatingMode.POSITION

    @property
    def _offset_ticks(self) -> int:
        """Homing offset that acts: in position mode one beyond its range is ignored."""
        offset = self.value(Register.HOMING_OFFSET)
        return 0 if self._in_position_mode and abs(offset) > MAX_HOMING_OFFSET_IN_POSITION_MODE else offset

    def _thresholds_from_registers(self) -> Thresholds:
        lowest, highest = (self.value(Register.MIN_VOLTAGE_LIMIT), self.value(Register.MAX_VOLTAGE_LIMIT))
        return Thresholds(
            voltage_v=((lowest - 0.5) * VOLT_PER_UNIT, (highest + 0.5) * VOLT_PER_UNIT),
            temperature_c=self.value(Register.TEMPERATURE_LIMIT),
            load_permille=OVERLOAD_PERMILLE,
            overload_s=OVERLOAD_S,
            current_a=math.inf,
            overcurrent_s=math.inf,
            latching=~StatusFlag(0),
        )

    def _drive_from_registers(self) -> Drive:
        stopped = self.value(Register.BUS_WATCHDOG) == WATCHDOG_TRIPPED
        goal = self.value(Register.GOAL_POSITION) - self._offset_ticks + self._turns_ticks
        share = abs(self.value(Register.GOAL_PWM)) / FULL_PWM
        if self.value(Register.OPERATING_MODE) == OperatingMode.CURRENT_BASED_POSITION:
            share = min(share, abs(self.value(Register.GOAL_CURRENT)) / self.model.stall_current_ma)
        velocity = self.value(Register.PROFILE_VELOCITY) * TICKS_S_PER_VELOCITY_UNIT
        acceleration = self.value(Register.PROFILE_ACCELERATION) * TICKS_S2_PER_ACCELERATION_UNIT
        return Drive(
            goal_ticks=self.plant.position_ticks if stopped else goal,
            velocity_ticks_s=velocity or NO_LOAD_TICKS_S,
            acceleration_ticks_s2=acceleration or UNLIMITED_TICKS_S2,
            torque_permille=share * FULL_DUTY_PERMILLE if self.value(Register.TORQUE_ENABLE) else 0.0,
            p_gain=STIFFNESS,
        )

    @property
    def _load_permille(self) -> float:
        return self.plant.current_a / STALL_CURRENT_A * FULL_DUTY_PERMILLE

    def _follow_status(self) -> None:
        errors = sum(bit for flag, bit in _BITS.items() if self.protection.status & flag)
        self.memory.set(Register.HARDWARE_ERROR_STATUS, errors)
        if errors & self.value(Register.SHUTDOWN):
            self.memory.set(Register.TORQUE_ENABLE, 0)
        self._follow_registers()

    def _measured(self) -> Iterable[tuple[Register, int]]:
        plant = self.plant
        return (
            (Register.MOVING, int(abs(plant.velocity_ticks_s) > MOVING_TICKS_S)),
            (Register.PRESENT_PWM, round(plant.duty_permille / FULL_DUTY_PERMILLE * FULL_PWM)),
            (Register.PRESENT_CURRENT, self._current_or_load()),
            (Register.PRESENT_VELOCITY, round(plant.velocity_ticks_s / TICKS_S_PER_VELOCITY_UNIT)),
            (Register.PRESENT_POSITION, self.present_ticks),
            (Register.PRESENT_INPUT_VOLTAGE, round(self.voltage_v / VOLT_PER_UNIT)),
            (Register.PRESENT_TEMPERATURE, round(self.motor.temperature_c)),
        )

    def _current_or_load(self) -> int:
        """Return address 126: the XL330's current [mA], the XL430's estimated load [0.1 %]."""
        if not self.model.has_current:
            return round(self.plant.duty_permille)
        return round(self.plant.current_a / STALL_CURRENT_A * self.model.stall_current_ma)


_HEADER_IN_BODY = b"\xff\xff\xfd"

_SHORTEST_LENGTH = 3  # INST and CRC


class DynamixelCodec(Codec):
    """Packets of protocol 2.0, as :mod:`robot.hardware.dynamixel.family` describes them."""

    header = HEADER
    word_bytes = 2
    rejection = INSTRUCTION_ERROR

    def end_of_instruction(self, received: bytes, at: int) -> int | None:
        length = received[at + PREFIX_BYTES - 2 : at + PREFIX_BYTES]
        end = at + PREFIX_BYTES + int.from_bytes(length, "little")
        return end if len(length) == 2 and end <= len(received) else None

    def instruction(self, packet: bytes) -> Instruction | None:
        if len(packet) < PREFIX_BYTES + _SHORTEST_LENGTH:
            return None
        body = packet[PREFIX_BYTES:-2].replace(_HEADER_IN_BODY + b"\xfd", _HEADER_IN_BODY)
        error = 0 if crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little") else CRC_ERROR
        return Instruction(packet[len(HEADER)], body[0], body[1:], len(packet), error)

    def status_packet(self, servo_id: int, error: int, data: bytes = b"") -> bytes:
        return packet(servo_id, INST_STATUS, bytes([error]) + data)


DYNAMIXEL = DynamixelCodec()


def emulated_dynamixel_arm(
    robot: RobotModel, config: EmulatedConfig, bounds: JointBounds, limits: GuardLimits, clock: Callable[[], float]
) -> EmulatedArm[DynamixelServo]:
    joints = config.calibration.joints
    servos = [_servo(joint, start_rad) for joint, start_rad in zip(joints, start_pose_rad(config), strict=True)]
    return EmulatedArm(robot, config, Dynamixel(), servos, DYNAMIXEL, bounds, limits, clock, holds=config.driven)


def _servo(joint: JointCalibration, start_rad: float) -> DynamixelServo:
    plant = Plant(
        position_ticks=joint.ticks_from_rad(start_rad) - joint.homing_offset,
        lower_stop_ticks=joint.range_min - joint.homing_offset,
        upper_stop_ticks=joint.range_max - joint.homing_offset,
    )
    limits = joint.range_min, joint.range_max
    return DynamixelServo(joint.servo_id, model_of(joint), plant, limits, joint.homing_offset, joint=joint.joint)

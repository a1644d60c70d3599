"""Registers of the Feetech STS3215: addresses, sizes, signs and units.

Addresses follow Feetech's STS3215 memory table V3.6; two-byte values are little endian, signed ones are
sign-magnitude with the sign in a bit that differs per register.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

from robot.hardware.servos.registers import Area as Area
from robot.hardware.servos.registers import Layout, RegisterTable


class Register(IntEnum):
    """Address of a register's first byte."""

    FIRMWARE_MAJOR = 0
    FIRMWARE_MINOR = 1
    MODEL_NUMBER = 3
    ID = 5
    BAUD_RATE = 6
    RETURN_DELAY = 7
    RESPONSE_LEVEL = 8
    MIN_ANGLE_LIMIT = 9
    MAX_ANGLE_LIMIT = 11
    MAX_TEMPERATURE = 13
    MAX_VOLTAGE = 14
    MIN_VOLTAGE = 15
    MAX_TORQUE = 16
    PHASE = 18
    UNLOADING_CONDITION = 19
    LED_ALARM_CONDITION = 20
    P_GAIN = 21
    D_GAIN = 22
    I_GAIN = 23
    MIN_STARTUP_FORCE = 24
    CW_DEAD_ZONE = 26
    CCW_DEAD_ZONE = 27
    PROTECTION_CURRENT = 28
    ANGULAR_RESOLUTION = 30
    HOMING_OFFSET = 31
    OPERATING_MODE = 33
    PROTECTIVE_TORQUE = 34
    PROTECTION_TIME = 35
    OVERLOAD_TORQUE = 36
    TORQUE_ENABLE = 40
    ACCELERATION = 41
    GOAL_POSITION = 42
    GOAL_TIME = 44
    GOAL_VELOCITY = 46
    TORQUE_LIMIT = 48
    LOCK = 55
    PRESENT_POSITION = 56
    PRESENT_VELOCITY = 58
    PRESENT_LOAD = 60
    PRESENT_VOLTAGE = 62
    PRESENT_TEMPERATURE = 63
    STATUS = 65
    MOVING = 66
    GOAL_POSITION_ECHO = 67
    PRESENT_CURRENT = 69


LAYOUT: Mapping[Register, Layout] = MappingProxyType(
    {
        Register.FIRMWARE_MAJOR: Layout(1, Area.READ_ONLY),
        Register.FIRMWARE_MINOR: Layout(1, Area.READ_ONLY),
        Register.MODEL_NUMBER: Layout(2, Area.READ_ONLY),
        Register.ID: Layout(1, Area.EEPROM),
        Register.BAUD_RATE: Layout(1, Area.EEPROM),
        Register.RETURN_DELAY: Layout(1, Area.EEPROM),
        Register.RESPONSE_LEVEL: Layout(1, Area.EEPROM),
        Register.MIN_ANGLE_LIMIT: Layout(2, Area.EEPROM),
        Register.MAX_ANGLE_LIMIT: Layout(2, Area.EEPROM),
        Register.MAX_TEMPERATURE: Layout(1, Area.EEPROM),
        Register.MAX_VOLTAGE: Layout(1, Area.EEPROM),
        Register.MIN_VOLTAGE: Layout(1, Area.EEPROM),
        Register.MAX_TORQUE: Layout(2, Area.EEPROM),
        Register.PHASE: Layout(1, Area.EEPROM),
        Register.UNLOADING_CONDITION: Layout(1, Area.EEPROM),
        Register.LED_ALARM_CONDITION: Layout(1, Area.EEPROM),
        Register.P_GAIN: Layout(1, Area.EEPROM),
        Register.D_GAIN: Layout(1, Area.EEPROM),
        Register.I_GAIN: Layout(1, Area.EEPROM),
        Register.MIN_STARTUP_FORCE: Layout(2, Area.EEPROM),
        Register.CW_DEAD_ZONE: Layout(1, Area.EEPROM),
        Register.CCW_DEAD_ZONE: Layout(1, Area.EEPROM),
        Register.PROTECTION_CURRENT: Layout(2, Area.EEPROM),
        Register.ANGULAR_RESOLUTION: Layout(1, Area.EEPROM),
        Register.HOMING_OFFSET: Layout(2, Area.EEPROM, sign_bit=11),
        Register.OPERATING_MODE: Layout(1, Area.EEPROM),
        Register.PROTECTIVE_TORQUE: Layout(1, Area.EEPROM),
        Register.PROTECTION_TIME: Layout(1, Area.EEPROM),
        Register.OVERLOAD_TORQUE: Layout(1, Area.EEPROM),
        Register.TORQUE_ENABLE: Layout(1, Area.RAM),
        Register.ACCELERATION: Layout(1, Area.RAM),
        Register.GOAL_POSITION: Layout(2, Area.RAM, sign_bit=15),
        Register.GOAL_TIME: Layout(2, Area.RAM),
        Register.GOAL_VELOCITY: Layout(2, Area.RAM, sign_bit=15),
        Register.TORQUE_LIMIT: Layout(2, Area.RAM),
        Register.LOCK: Layout(1, Area.RAM),
        Register.PRESENT_POSITION: Layout(2, Area.READ_ONLY, sign_bit=15),
        Register.PRESENT_VELOCITY: Layout(2, Area.READ_ONLY, sign_bit=15),
        Register.PRESENT_LOAD: Layout(2, Area.READ_ONLY, sign_bit=10),
        Register.PRESENT_VOLTAGE: Layout(1, Area.READ_ONLY),
        Register.PRESENT_TEMPERATURE: Layout(1, Area.READ_ONLY),
        Register.STATUS: Layout(1, Area.READ_ONLY),
        Register.MOVING: Layout(1, Area.READ_ONLY),
        Register.GOAL_POSITION_ECHO: Layout(2, Area.READ_ONLY, sign_bit=15),
        Register.PRESENT_CURRENT: Layout(2, Area.READ_ONLY, sign_bit=15),
    }
)

# Register MODEL_NUMBER of the servos whose registers are these: Feetech's STS series.
MODELS: Mapping[str, int] = MappingProxyType({"sts3215": 777, "sts3250": 2825})

TELEMETRY_ADDRESS = Register.PRESENT_POSITION
TELEMETRY_BYTES = 15

GOAL_ADDRESS = Register.ACCELERATION


VOLT_PER_UNIT = 0.1
AMPERE_PER_UNIT = 0.0065

# Current of a stalled STS3215 C001 at full duty (Feetech's data sheet: 2.4 A at 6 V, 2.7 A at 7.4 V).
STALL_CURRENT_A = 2.7

# The acceleration register counts in steps of 100 ticks/s^2.
TICKS_S2_PER_ACCELERATION_UNIT = 100


TABLE = RegisterTable(LAYOUT)
value_range, encode, decode = TABLE.value_range, TABLE.encode, TABLE.decode

# Commands that a servo holds.
CONTROL = TABLE.block(Register.TORQUE_ENABLE, Register.LOCK)
CONTROL_ADDRESS, CONTROL_BYTES = CONTROL.address, CONTROL.length

# The telemetry block as one struct, parsed hundreds of times a second; the byte without a name is the async flag.
_TELEMETRY = struct.Struct("<HHHBBBBBHH")
_SIGN_10, _SIGN_15 = 1 << 10, 1 << 15


# Six hundred are created a second, and a frozen one takes three times as long.
@dataclass(slots=True)
class Telemetry:
    """Measurements of a servo, registers 56 to 70.

    Attributes:
        position_ticks: present position, 4096 ticks per turn.
        velocity_ticks_s: present velocity [ticks/s].
        load_permille: motor duty, signed [0.1 %].
        voltage_v: supply [V].
        temperature_c: temperature of the motor's housing [degC].
        status: bits of :class:`robot.hardware.interface.StatusFlag`.
        moving: True while the servo is on its way to a goal.
        goal_ticks_echo: goal that it follows.
        current_a: motor current, signed [A].
    """

    position_ticks: int
    velocity_ticks_s: int
    load_permille: int
    voltage_v: float
    temperature_c: int
    status: int
    moving: bool
    goal_ticks_echo: int
    current_a: float


def parse_telemetry(data: bytes) -> Telemetry:
    """Parse the telemetry block, ``TELEMETRY_BYTES`` from ``TELEMETRY_ADDRESS`` on.

    Raises:
        ValueError: ``data`` has another length.
    """
    if len(data) != TELEMETRY_BYTES:
        raise ValueError(f"the telemetry block has {TELEMETRY_BYTES} bytes, not {len(data)}")

    position, velocity, load, volts, temperature, _, status, moving, echo, current = _TELEMETRY.unpack(data)
    # Sign and magnitude; bits above the sign are ignored.
    magnitude = load & (_SIGN_10 - 1)
    return Telemetry(
        position_ticks=position if position < _SIGN_15 else _SIGN_15 - position,
        velocity_ticks_s=velocity if velocity < _SIGN_15 else _SIGN_15 - velocity,
        load_permille=-magnitude if load & _SIGN_10 else magnitude,
        voltage_v=volts * VOLT_PER_UNIT,
        temperature_c=temperature,
        status=status,
        moving=moving != 0,
        goal_ticks_echo=echo if echo < _SIGN_15 else _SIGN_15 - echo,
        current_a=(current if current < _SIGN_15 else _SIGN_15 - current) * AMPERE_PER_UNIT,
    )


def goal_block(goal_ticks: int, velocity_ticks_s: int, acceleration: int = 254) -> bytes:
    """Build registers 41 to 47: goal, velocity cap and acceleration.

    Args:
        goal_ticks: goal position.
        velocity_ticks_s: velocity cap [ticks/s]; 0 means as fast as the servo can.
        acceleration: in 100 ticks/s^2, at most 254; the default lags least behind a streamed goal.

    Raises:
        ValueError: a register cannot hold its value.
    """
    return (
        encode(Register.ACCELERATION, acceleration)
        + encode(Register.GOAL_POSITION, goal_ticks)
        + encode(Register.GOAL_TIME, 0)
        + encode(Register.GOAL_VELOCITY, velocity_ticks_s)
    )

"""Registers of the Feetech STS3215: addresses, sizes, signs and units.

Addresses follow Feetech's STS3215 memory table V3.6; two-byte values are little endian, signed ones are
sign-magnitude with the sign in a bit that differs per register.
"""

import struct
from collections.abc import Mapping

from robot.hardware.servos.registers import Area, Block, RegisterEnum, RegisterTable, Telemetry

READ_ONLY, EEPROM, RAM = Area.READ_ONLY, Area.EEPROM, Area.RAM


class Register(RegisterEnum):
    """Registers: address of the first byte, size in bytes, memory area, and sign."""

    FIRMWARE_MAJOR = 0, 1, READ_ONLY
    FIRMWARE_MINOR = 1, 1, READ_ONLY
    MODEL_NUMBER = 3, 2, READ_ONLY
    ID = 5, 1, EEPROM
    BAUD_RATE = 6, 1, EEPROM
    RETURN_DELAY = 7, 1, EEPROM
    RESPONSE_LEVEL = 8, 1, EEPROM
    MIN_ANGLE_LIMIT = 9, 2, EEPROM
    MAX_ANGLE_LIMIT = 11, 2, EEPROM
    MAX_TEMPERATURE = 13, 1, EEPROM
    MAX_VOLTAGE = 14, 1, EEPROM
    MIN_VOLTAGE = 15, 1, EEPROM
    MAX_TORQUE = 16, 2, EEPROM
    PHASE = 18, 1, EEPROM
    UNLOADING_CONDITION = 19, 1, EEPROM
    LED_ALARM_CONDITION = 20, 1, EEPROM
    P_GAIN = 21, 1, EEPROM
    D_GAIN = 22, 1, EEPROM
    I_GAIN = 23, 1, EEPROM
    MIN_STARTUP_FORCE = 24, 2, EEPROM
    CW_DEAD_ZONE = 26, 1, EEPROM
    CCW_DEAD_ZONE = 27, 1, EEPROM
    PROTECTION_CURRENT = 28, 2, EEPROM
    ANGULAR_RESOLUTION = 30, 1, EEPROM
    HOMING_OFFSET = 31, 2, EEPROM, 11
    OPERATING_MODE = 33, 1, EEPROM
    PROTECTIVE_TORQUE = 34, 1, EEPROM
    PROTECTION_TIME = 35, 1, EEPROM
    OVERLOAD_TORQUE = 36, 1, EEPROM
    TORQUE_ENABLE = 40, 1, RAM
    ACCELERATION = 41, 1, RAM
    GOAL_POSITION = 42, 2, RAM, 15
    GOAL_TIME = 44, 2, RAM
    GOAL_VELOCITY = 46, 2, RAM, 15
    TORQUE_LIMIT = 48, 2, RAM
    LOCK = 55, 1, RAM
    PRESENT_POSITION = 56, 2, READ_ONLY, 15
    PRESENT_VELOCITY = 58, 2, READ_ONLY, 15
    PRESENT_LOAD = 60, 2, READ_ONLY, 10
    PRESENT_VOLTAGE = 62, 1, READ_ONLY
    PRESENT_TEMPERATURE = 63, 1, READ_ONLY
    STATUS = 65, 1, READ_ONLY
    MOVING = 66, 1, READ_ONLY
    GOAL_POSITION_ECHO = 67, 2, READ_ONLY, 15
    PRESENT_CURRENT = 69, 2, READ_ONLY, 15


# Baud rate of each value of register BAUD_RATE.
BAUDRATES = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)

# Register MODEL_NUMBER of the servos whose registers are these: Feetech's STS series.
MODELS: Mapping[str, int] = {"sts3215": 777, "sts3250": 2825}

GOAL_ADDRESS = Register.ACCELERATION

VOLT_PER_UNIT = 0.1
PERCENT = 100.0
PERMILLE = 1000.0
AMPERE_PER_UNIT = 0.0065
PROTECTION_TIME_UNIT_S = 0.01

# Current of a stalled STS3215 C001 at full duty (Feetech's data sheet: 2.4 A at 6 V, 2.7 A at 7.4 V).
STALL_CURRENT_A = 2.7

FREE_SPEED_RAD_S = 5.5  # its speed without load at 7.4 V (Feetech's data sheet)
TICKS_S2_PER_ACCELERATION_UNIT = 100  # the acceleration register counts in steps of 100 ticks/s^2

TABLE = RegisterTable(Register)

# Identity and EPROM, all below the SRAM, in one transaction; its even length keeps it apart from the telemetry's.
SETTINGS = tuple(register for register in Register if register < Register.TORQUE_ENABLE)
SETTINGS_BLOCK = Block(int(Register.FIRMWARE_MAJOR), Register.TORQUE_ENABLE - Register.FIRMWARE_MAJOR, SETTINGS)

# Settings that can be written and outlive a power cut.
EPROM = tuple(register for register in SETTINGS if register.area is EEPROM)

# Commands that a servo holds.
CONTROL = TABLE.block(Register.TORQUE_ENABLE, Register.LOCK)

# All measurements, and as one struct, parsed hundreds of times a second, without the async flag, MOVING and the echo of
# the goal.
TELEMETRY = TABLE.block(Register.PRESENT_POSITION, Register.PRESENT_CURRENT)
_TELEMETRY = struct.Struct("<HHHBBxBxxxH")
_SIGN_10, _SIGN_15 = 1 << 10, 1 << 15


def parse_telemetry(data: bytes) -> Telemetry:
    """Parse the block :data:`TELEMETRY`; raises ValueError for another number of bytes."""
    if len(data) != TELEMETRY.length:
        raise ValueError(f"the telemetry block has {TELEMETRY.length} bytes, not {len(data)}")

    position, velocity, load, volts, temperature, status, current = _TELEMETRY.unpack(data)
    # Sign and magnitude; bits above the sign are ignored.
    duty = (load & (_SIGN_10 - 1)) / PERMILLE
    return Telemetry(
        position_ticks=position if position < _SIGN_15 else _SIGN_15 - position,
        velocity_ticks_s=velocity if velocity < _SIGN_15 else _SIGN_15 - velocity,
        load=-duty if load & _SIGN_10 else duty,
        current_a=(current if current < _SIGN_15 else _SIGN_15 - current) * AMPERE_PER_UNIT,
        voltage_v=volts * VOLT_PER_UNIT,
        temperature_c=temperature,
        status=status,
    )

"""Control table of Dynamixel's XL430-W250 and XL330-M288: addresses, sizes, signs, units and models.

Addresses, ranges and units follow the tables "Control Table of EEPROM Area" and "of RAM Area" in ROBOTIS's e-manual,
pages XL430-W250 and XL330-M288. Both share every address used here but two: only the XL330 has CURRENT_LIMIT (38) and
GOAL_CURRENT (102), and address 126 holds its present current where the XL430 has an estimated load. Values are little
endian, signed ones in two's complement. The EEPROM can be written only while torque is off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

from robot.hardware.interface import StatusFlag
from robot.hardware.servos.registers import Area as Area
from robot.hardware.servos.registers import Layout, RegisterTable


class Register(IntEnum):
    """Address of a register's first byte."""

    MODEL_NUMBER = 0
    FIRMWARE_VERSION = 6
    ID = 7
    BAUD_RATE = 8
    RETURN_DELAY_TIME = 9
    DRIVE_MODE = 10
    OPERATING_MODE = 11
    HOMING_OFFSET = 20
    TEMPERATURE_LIMIT = 31
    MAX_VOLTAGE_LIMIT = 32
    MIN_VOLTAGE_LIMIT = 34
    PWM_LIMIT = 36
    CURRENT_LIMIT = 38
    VELOCITY_LIMIT = 44
    MAX_POSITION_LIMIT = 48
    MIN_POSITION_LIMIT = 52
    SHUTDOWN = 63
    TORQUE_ENABLE = 64
    LED = 65
    STATUS_RETURN_LEVEL = 68
    HARDWARE_ERROR_STATUS = 70
    POSITION_P_GAIN = 84
    BUS_WATCHDOG = 98
    GOAL_PWM = 100
    GOAL_CURRENT = 102
    PROFILE_ACCELERATION = 108
    PROFILE_VELOCITY = 112
    GOAL_POSITION = 116
    MOVING = 122
    PRESENT_PWM = 124
    PRESENT_CURRENT = 126
    PRESENT_VELOCITY = 128
    PRESENT_POSITION = 132
    PRESENT_INPUT_VOLTAGE = 144
    PRESENT_TEMPERATURE = 146


LAYOUT: Mapping[Register, Layout] = MappingProxyType(
    {
        Register.MODEL_NUMBER: Layout(2, Area.READ_ONLY),
        Register.FIRMWARE_VERSION: Layout(1, Area.READ_ONLY),
        Register.ID: Layout(1, Area.EEPROM),
        Register.BAUD_RATE: Layout(1, Area.EEPROM),
        Register.RETURN_DELAY_TIME: Layout(1, Area.EEPROM),
        Register.DRIVE_MODE: Layout(1, Area.EEPROM),
        Register.OPERATING_MODE: Layout(1, Area.EEPROM),
        Register.HOMING_OFFSET: Layout(4, Area.EEPROM, signed=True),
        Register.TEMPERATURE_LIMIT: Layout(1, Area.EEPROM),
        Register.MAX_VOLTAGE_LIMIT: Layout(2, Area.EEPROM),
        Register.MIN_VOLTAGE_LIMIT: Layout(2, Area.EEPROM),
        Register.PWM_LIMIT: Layout(2, Area.EEPROM),
        Register.CURRENT_LIMIT: Layout(2, Area.EEPROM),
        Register.VELOCITY_LIMIT: Layout(4, Area.EEPROM),
        Register.MAX_POSITION_LIMIT: Layout(4, Area.EEPROM),
        Register.MIN_POSITION_LIMIT: Layout(4, Area.EEPROM),
        Register.SHUTDOWN: Layout(1, Area.EEPROM),
        Register.TORQUE_ENABLE: Layout(1, Area.RAM),
        Register.LED: Layout(1, Area.RAM),
        Register.STATUS_RETURN_LEVEL: Layout(1, Area.RAM),
        Register.HARDWARE_ERROR_STATUS: Layout(1, Area.READ_ONLY),
        Register.POSITION_P_GAIN: Layout(2, Area.RAM),
        Register.BUS_WATCHDOG: Layout(1, Area.RAM, signed=True),
        Register.GOAL_PWM: Layout(2, Area.RAM, signed=True),
        Register.GOAL_CURRENT: Layout(2, Area.RAM, signed=True),
        Register.PROFILE_ACCELERATION: Layout(4, Area.RAM),
        Register.PROFILE_VELOCITY: Layout(4, Area.RAM),
        Register.GOAL_POSITION: Layout(4, Area.RAM, signed=True),
        Register.MOVING: Layout(1, Area.READ_ONLY),
        Register.PRESENT_PWM: Layout(2, Area.READ_ONLY, signed=True),
        Register.PRESENT_CURRENT: Layout(2, Area.READ_ONLY, signed=True),
        Register.PRESENT_VELOCITY: Layout(4, Area.READ_ONLY, signed=True),
        Register.PRESENT_POSITION: Layout(4, Area.READ_ONLY, signed=True),
        Register.PRESENT_INPUT_VOLTAGE: Layout(2, Area.READ_ONLY),
        Register.PRESENT_TEMPERATURE: Layout(1, Area.READ_ONLY),
    }
)


@dataclass(frozen=True)
class Model:
    """Model of a servo.

    Attributes:
        name: name in servo tables and calibrations.
        number: register MODEL_NUMBER.
        stall_current_ma: stall current at the usual supply, 1.47 A at 5 V for the XL330-M288 and 1.4 A at 12 V for the
            XL430-W250 [mA].
        stall_torque_nm: stall torque at that supply [Nm].
        has_current: True if it measures and limits its current.
        watchdog_firmware: firmware from which it has the bus watchdog; e-manual, Bus Watchdog (98).
    """

    name: str
    number: int
    stall_current_ma: int
    stall_torque_nm: float
    has_current: bool
    watchdog_firmware: int


MODELS: Mapping[str, Model] = MappingProxyType(
    {
        model.name: model
        for model in (
            Model("xl430-w250", 1060, 1400, 1.5, has_current=False, watchdog_firmware=38),
            Model("xl330-m288", 1200, 1470, 0.52, has_current=True, watchdog_firmware=0),
        )
    }
)


class OperatingMode(IntEnum):
    """Values of register OPERATING_MODE in which a servo follows position goals.

    A servo in POSITION counts within one turn, keeps to its position limits, and ignores a homing offset beyond
    +-1024 ticks (e-manual, Homing Offset (20)). The others count several turns, up to 256 to each side.
    """

    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5


MAX_HOMING_OFFSET_IN_POSITION_MODE = 1024

# Register DRIVE_MODE: 0 is the normal direction, profiles by velocity, and torque by TORQUE_ENABLE alone.
PLAIN_DRIVE_MODE = 0

# Register BUS_WATCHDOG: unit, and the value that it has after it has stopped the servo.
WATCHDOG_UNIT_S = 0.02
WATCHDOG_TRIPPED = -1

VOLT_PER_UNIT = 0.1
AMPERE_PER_UNIT = 0.001

# Full motor duty in registers GOAL_PWM and PRESENT_PWM.
FULL_PWM = 885

# 0.229 rev/min in ticks of 4096 a turn, and 214.577 rev/min^2.
TICKS_S_PER_VELOCITY_UNIT = 0.229 / 60.0 * 4096.0
TICKS_S2_PER_ACCELERATION_UNIT = 214.577 / 3600.0 * 4096.0

# Bits of HARDWARE_ERROR_STATUS; each that is set in SHUTDOWN switches torque off, until a reboot.
HARDWARE_ERRORS: Mapping[int, StatusFlag] = MappingProxyType(
    {
        0x01: StatusFlag.VOLTAGE,
        0x04: StatusFlag.TEMPERATURE,
        0x08: StatusFlag.ENCODER,
        # "Electrical shock, or insufficient power to operate the motor."
        0x10: StatusFlag.CURRENT,
        0x20: StatusFlag.OVERLOAD,
    }
)


def status_of(hardware_error: int) -> StatusFlag:
    """Convert register HARDWARE_ERROR_STATUS to status flags."""
    status = StatusFlag(0)
    for bit, flag in HARDWARE_ERRORS.items():
        if hardware_error & bit:
            status |= flag
    return status


TABLE = RegisterTable(LAYOUT)
value_range, encode, decode = TABLE.value_range, TABLE.encode, TABLE.decode

# Blocks of measurements: what changes at every tick, and all up to the temperature. The two trajectory registers in
# between (136 to 143) are not used.
MOTION = TABLE.block(Register.PRESENT_PWM, Register.PRESENT_POSITION)
TELEMETRY = TABLE.block(Register.PRESENT_PWM, Register.PRESENT_TEMPERATURE)
MOTION_ADDRESS = MOTION.address

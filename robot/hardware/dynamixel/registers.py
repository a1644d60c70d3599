"""Control table of Dynamixel's XL430-W250 and XL330-M288: addresses, sizes, signs, units and models.

Addresses, ranges and units follow the tables "Control Table of EEPROM Area" and "of RAM Area" in ROBOTIS's e-manual,
pages XL430-W250 and XL330-M288. Both share every address used here but two: only the XL330 has CURRENT_LIMIT (38) and
GOAL_CURRENT (102), and address 126 holds its present current where the XL430 has an estimated load. Values are little
endian, signed ones in two's complement. The EEPROM can be written only while torque is off.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from robot.hardware.interface import StatusFlag
from robot.hardware.servos.registers import TWOS_COMPLEMENT, Area, RegisterEnum, RegisterTable

READ_ONLY, EEPROM, RAM = Area.READ_ONLY, Area.EEPROM, Area.RAM


class Register(RegisterEnum):
    """Registers: address of the first byte, size in bytes, memory area, and sign."""

    MODEL_NUMBER = 0, 2, READ_ONLY
    FIRMWARE_VERSION = 6, 1, READ_ONLY
    ID = 7, 1, EEPROM
    BAUD_RATE = 8, 1, EEPROM
    RETURN_DELAY_TIME = 9, 1, EEPROM
    DRIVE_MODE = 10, 1, EEPROM
    OPERATING_MODE = 11, 1, EEPROM
    HOMING_OFFSET = 20, 4, EEPROM, TWOS_COMPLEMENT
    TEMPERATURE_LIMIT = 31, 1, EEPROM
    MAX_VOLTAGE_LIMIT = 32, 2, EEPROM
    MIN_VOLTAGE_LIMIT = 34, 2, EEPROM
    PWM_LIMIT = 36, 2, EEPROM
    CURRENT_LIMIT = 38, 2, EEPROM
    VELOCITY_LIMIT = 44, 4, EEPROM
    MAX_POSITION_LIMIT = 48, 4, EEPROM
    MIN_POSITION_LIMIT = 52, 4, EEPROM
    SHUTDOWN = 63, 1, EEPROM
    TORQUE_ENABLE = 64, 1, RAM
    LED = 65, 1, RAM
    STATUS_RETURN_LEVEL = 68, 1, RAM
    HARDWARE_ERROR_STATUS = 70, 1, READ_ONLY
    POSITION_P_GAIN = 84, 2, RAM
    BUS_WATCHDOG = 98, 1, RAM, TWOS_COMPLEMENT
    GOAL_PWM = 100, 2, RAM, TWOS_COMPLEMENT
    GOAL_CURRENT = 102, 2, RAM, TWOS_COMPLEMENT
    PROFILE_ACCELERATION = 108, 4, RAM
    PROFILE_VELOCITY = 112, 4, RAM
    GOAL_POSITION = 116, 4, RAM, TWOS_COMPLEMENT
    MOVING = 122, 1, READ_ONLY
    PRESENT_PWM = 124, 2, READ_ONLY, TWOS_COMPLEMENT
    PRESENT_CURRENT = 126, 2, READ_ONLY, TWOS_COMPLEMENT
    PRESENT_VELOCITY = 128, 4, READ_ONLY, TWOS_COMPLEMENT
    PRESENT_POSITION = 132, 4, READ_ONLY, TWOS_COMPLEMENT
    PRESENT_INPUT_VOLTAGE = 144, 2, READ_ONLY
    PRESENT_TEMPERATURE = 146, 1, READ_ONLY


@dataclass(frozen=True)
class Model:
    """Model of a servo."""

    name: str  # name in servo tables and calibrations
    number: int  # register MODEL_NUMBER
    # Stall current at the usual supply, 1.47 A at 5 V for the XL330-M288 and 1.4 A at 12 V for the XL430-W250 [mA].
    stall_current_ma: int
    stall_torque_nm: float  # stall torque at that supply [Nm]
    free_speed_rad_s: float  # no-load speed at that supply, 61 rev/min and 103 rev/min [rad/s]
    has_current: bool  # True if it measures and limits its current
    watchdog_firmware: int  # firmware from which it has the bus watchdog; e-manual, Bus Watchdog (98)


MODELS: Mapping[str, Model] = {
    model.name: model
    for model in (
        Model("xl430-w250", 1060, 1400, 1.5, 6.4, has_current=False, watchdog_firmware=38),
        Model("xl330-m288", 1200, 1470, 0.52, 10.8, has_current=True, watchdog_firmware=0),
    )
}


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

FULL_PWM = 885  # full motor duty in registers GOAL_PWM and PRESENT_PWM

# 0.229 rev/min in ticks of 4096 a turn, and 214.577 rev/min^2.
TICKS_S_PER_VELOCITY_UNIT = 0.229 / 60.0 * 4096.0
TICKS_S2_PER_ACCELERATION_UNIT = 214.577 / 3600.0 * 4096.0

# Bits of HARDWARE_ERROR_STATUS; each that is set in SHUTDOWN switches torque off, until a reboot.
HARDWARE_ERRORS: Mapping[int, StatusFlag] = {
    0x01: StatusFlag.VOLTAGE,
    0x04: StatusFlag.TEMPERATURE,
    0x08: StatusFlag.ENCODER,
    # "Electrical shock, or insufficient power to operate the motor."
    0x10: StatusFlag.CURRENT,
    0x20: StatusFlag.OVERLOAD,
}


def status_of(hardware_error: int) -> StatusFlag:
    """Convert register HARDWARE_ERROR_STATUS to status flags."""
    status = StatusFlag(0)
    for bit, flag in HARDWARE_ERRORS.items():
        if hardware_error & bit:
            status |= flag
    return status


TABLE = RegisterTable(Register)

# Blocks of measurements: what changes at every tick, and all up to the temperature. The two trajectory registers in
# between (136 to 143) are not used.
MOTION = TABLE.block(Register.PRESENT_PWM, Register.PRESENT_POSITION)
TELEMETRY = TABLE.block(Register.PRESENT_PWM, Register.PRESENT_TEMPERATURE)

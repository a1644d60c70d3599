"""Settings that a servo keeps in its EPROM, read in one transaction, with the quantities that depend on them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from robot.hardware.feetech.registers import (
    AMPERE_PER_UNIT,
    LAYOUT,
    PERMILLE,
    VOLT_PER_UNIT,
    Area,
    Register,
)
from robot.hardware.servos.registers import Block

# Everything below the SRAM: identity, and the EPROM.
SETTINGS_ADDRESS = Register.FIRMWARE_MAJOR
SETTINGS_BYTES = Register.TORQUE_ENABLE - Register.FIRMWARE_MAJOR

# Registers of the block that this program knows.
SETTINGS = tuple(register for register, layout in LAYOUT.items() if register < Register.TORQUE_ENABLE)

# Those of them that can be written and outlive a power cut.
EPROM = tuple(register for register in SETTINGS if LAYOUT[register].area is Area.EEPROM)

# All settings in one transaction. Its even length keeps it apart from the telemetry's.
SETTINGS_BLOCK = Block(SETTINGS_ADDRESS, SETTINGS_BYTES, SETTINGS)

PERCENT = 100.0

# Unit of register PROTECTION_TIME.
PROTECTION_TIME_UNIT_S = 0.01


@dataclass(frozen=True)
class ServoSettings:
    """Settings of one servo."""

    values: Mapping[Register, int]  # value of each of :data:`SETTINGS`

    def __getitem__(self, register: Register) -> int:
        """Return the value of a register."""
        return self.values[register]

    @property
    def firmware(self) -> tuple[int, int]:
        """Major and minor version of the firmware."""
        return self[Register.FIRMWARE_MAJOR], self[Register.FIRMWARE_MINOR]

    @property
    def angle_limits_ticks(self) -> tuple[int, int]:
        """Lowest and highest goal; (0, 0) means none."""
        return self[Register.MIN_ANGLE_LIMIT], self[Register.MAX_ANGLE_LIMIT]

    @property
    def max_voltage_v(self) -> float:
        """Highest supply, which differs between the 7.4 V and the 12 V variant [V]."""
        return self[Register.MAX_VOLTAGE] * VOLT_PER_UNIT

    @property
    def max_torque(self) -> float:
        """Share of full duty that the torque limit has after power-up."""
        return self[Register.MAX_TORQUE] / PERMILLE

    @property
    def overload_torque(self) -> float:
        """Share of full duty from which the overload's timer runs; infinite where nothing is set.

        A servo with a threshold of 0 would always be overloaded.
        """
        return self[Register.OVERLOAD_TORQUE] / PERCENT or math.inf

    @property
    def protection_time_s(self) -> float:
        """Time above the overload torque after which the overload latches; infinite where nothing is set [s]."""
        return self[Register.PROTECTION_TIME] * PROTECTION_TIME_UNIT_S or math.inf

    @property
    def protection_current_a(self) -> float:
        """Current that must not last; infinite where nothing is set [A]."""
        return self[Register.PROTECTION_CURRENT] * AMPERE_PER_UNIT or math.inf

    def by_name(self) -> dict[str, int]:
        """Return the values by the names of their registers, as for people."""
        return {register.name: value for register, value in self.values.items()}

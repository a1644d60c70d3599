"""All registers of one servo, by name: what a scan, a setup and a backup read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import CONTROL, TABLE, VOLT_PER_UNIT, Register
from robot.hardware.feetech.settings import SETTINGS, SETTINGS_BLOCK, ServoSettings
from robot.hardware.interface import Steps
from robot.hardware.servos import bus as servo_bus

# All documented registers, in blocks that the bus reads elsewhere too: a servo need not answer any longer read.
BLOCKS = (SETTINGS_BLOCK, CONTROL, TABLE.block(Register.PRESENT_POSITION, Register.PRESENT_CURRENT))


@dataclass(frozen=True)
class ServoRegisters:
    """Value of every register of one servo."""

    servo_id: int
    registers: Mapping[Register, int]

    def __getitem__(self, register: Register) -> int:
        return self.registers[register]

    @property
    def settings(self) -> ServoSettings:
        """Settings that the servo keeps."""
        return ServoSettings({register: self[register] for register in SETTINGS})

    @property
    def firmware(self) -> str:
        """Version, as ``3.10``."""
        return f"{self[Register.FIRMWARE_MAJOR]}.{self[Register.FIRMWARE_MINOR]}"

    @property
    def voltage_v(self) -> float:
        """Supply [V]."""
        return self[Register.PRESENT_VOLTAGE] * VOLT_PER_UNIT

    @property
    def voltage_limits_v(self) -> tuple[float, float]:
        """Registers MIN_VOLTAGE and MAX_VOLTAGE, which differ between the 7.4 V and the 12 V variant [V]."""
        return self[Register.MIN_VOLTAGE] * VOLT_PER_UNIT, self[Register.MAX_VOLTAGE] * VOLT_PER_UNIT


def read_registers(bus: Bus, servo_id: int) -> Steps[dict[Register, int]]:
    """Read every register of a servo, as a sequence."""
    values: dict[Register, int] = {}
    for block in BLOCKS:
        values |= yield from servo_bus.read_registers(bus, servo_id, block)
    return values

"""Table of a servo family's registers (address, size, sign, memory area), their codec, and the measurements in them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Generic, Self, TypeVar


class Area(Enum):
    """Memory area of a register."""

    READ_ONLY = "read only"
    EEPROM = "EEPROM"
    RAM = "RAM"


TWOS_COMPLEMENT = -1  # sign of a register in two's complement, in place of the bit of sign and magnitude


@dataclass(frozen=True)
class Layout:
    """Storage of a register, little endian."""

    size: int  # bytes, 1, 2 or 4
    area: Area
    sign: int | None = None  # bit that marks a negative value, TWOS_COMPLEMENT, or None for an unsigned register

    @property
    def value_range(self) -> tuple[int, int]:
        """Lowest and highest value."""
        bits = 8 * self.size
        if self.sign == TWOS_COMPLEMENT:
            return -(1 << bits - 1), (1 << bits - 1) - 1
        if self.sign is None:
            return 0, (1 << bits) - 1
        highest = (1 << self.sign) - 1
        return -highest, highest


class RegisterEnum(IntEnum):
    """Registers of a family: a member is the address of a register's first byte, and has its layout."""

    layout: Layout

    def __new__(cls, address: int, size: int = 1, area: Area = Area.RAM, sign: int | None = None) -> Self:
        """Make a member, of address, size, memory area and sign."""
        register = int.__new__(cls, address)
        register._value_ = address
        register.layout = Layout(size, area, sign)
        return register


RegisterT = TypeVar("RegisterT", bound=RegisterEnum)


@dataclass(frozen=True)
class Block(Generic[RegisterT]):
    """Registers that are read in one transaction."""

    address: int  # of the first byte
    length: int  # bytes
    registers: tuple[RegisterT, ...]  # within, in the order of their addresses


class RegisterTable(Generic[RegisterT]):
    """Registers of a family in the order of their addresses, those that every servo has by their names."""

    def __init__(self, registers: type[RegisterT]) -> None:
        self.layout = {register: register.layout for register in registers}
        self._ranges = {register: layout.value_range for register, layout in self.layout.items()}
        self.model_number = registers["MODEL_NUMBER"]
        self.torque_enable = registers["TORQUE_ENABLE"]
        self.goal_position = registers["GOAL_POSITION"]
        self.present_position = registers["PRESENT_POSITION"]
        self.homing_offset = registers["HOMING_OFFSET"]

    def value_range(self, register: RegisterT) -> tuple[int, int]:
        """Return the lowest and highest value that a register can hold."""
        return self._ranges[register]

    def encode(self, register: RegisterT, value: int) -> bytes:
        """Encode a value as the bytes of its register; raises ValueError for a value that it cannot hold."""
        layout, (lowest, highest) = self.layout[register], self._ranges[register]
        if not lowest <= value <= highest:
            raise ValueError(f"{register.name} holds {lowest} to {highest}, not {value}")
        if layout.sign == TWOS_COMPLEMENT:
            return value.to_bytes(layout.size, "little", signed=True)
        raw = value if layout.sign is None or value >= 0 else -value | 1 << layout.sign
        return raw.to_bytes(layout.size, "little")

    def decode(self, register: RegisterT, data: bytes) -> int:
        """Decode the bytes of a register; raises ValueError for another number of them."""
        layout = self.layout[register]
        if len(data) != layout.size:
            raise ValueError(f"{register.name} has {layout.size} bytes, not {len(data)}")
        raw = int.from_bytes(data, "little", signed=layout.sign == TWOS_COMPLEMENT)
        if layout.sign is None or layout.sign == TWOS_COMPLEMENT:
            return raw
        magnitude = raw & ((1 << layout.sign) - 1)
        return -magnitude if raw >> layout.sign & 1 else magnitude

    def block(self, first: RegisterT, last: RegisterT | None = None) -> Block[RegisterT]:
        """Return the block of all registers from the first to the last one; of the first alone without a last one."""
        last = first if last is None else last
        within = tuple(register for register in self.layout if first <= register <= last)
        return Block(int(first), last + self.layout[last].size - first, within)

    def parse(self, block: Block[RegisterT], data: bytes) -> dict[RegisterT, int]:
        """Decode the registers of a block; raises ValueError for another number of bytes."""
        if len(data) != block.length:
            raise ValueError(f"the block from {block.registers[0].name} has {block.length} bytes, not {len(data)}")
        starts = {register: register - block.address for register in block.registers}
        return {
            register: self.decode(register, data[start : start + self.layout[register].size])
            for register, start in starts.items()
        }


# Six hundred are created a second, and a frozen one takes three times as long.
@dataclass(slots=True)
class Telemetry:
    """Measurements of one servo; signs are of the servo's rotation."""

    position_ticks: int  # present position; the tracker takes the turns out that the servo has counted
    velocity_ticks_s: float  # present velocity [ticks/s]
    load: float  # share of full motor duty
    current_a: float  # motor current; NaN for a servo that does not measure it [A]
    voltage_v: float  # supply; NaN in a reply without it [V]
    temperature_c: float  # temperature of the motor; NaN in a reply without it [degC]
    status: int = 0  # bits of :class:`robot.hardware.interface.StatusFlag`
    reports_error: bool = False  # True for a servo whose error register must be read
    turns_ticks: int = 0  # whole turns that were added for the calibrated position

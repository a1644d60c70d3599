"""Table of a servo family's registers (address, size, sign, memory area), their codec, and the measurements in them."""

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Generic, Self, TypeVar


class Area(Enum):
    """Memory area of a register."""

    READ_ONLY = "read only"
    EEPROM = "EEPROM"
    RAM = "RAM"


RETURN_DELAY_UNIT_US = 2  # unit of the register of return delay in both makers' tables [us]

TWOS_COMPLEMENT = -1  # sign of a register in two's complement, in place of the bit of sign and magnitude


class RegisterEnum(IntEnum):
    """Registers of a family: a member is the address of a register's first byte, and stored little endian."""

    size: int  # bytes, 1, 2 or 4
    area: Area
    sign: int | None  # bit that marks a negative value, TWOS_COMPLEMENT, or None for an unsigned register
    value_range: tuple[int, int]  # lowest and highest value

    def __new__(cls, address: int, size: int = 1, area: Area = Area.RAM, sign: int | None = None) -> Self:
        """Make a member, of address, size, memory area and sign."""
        register = int.__new__(cls, address)
        register._value_ = address
        register.size, register.area, register.sign = size, area, sign
        if sign is None:
            register.value_range = 0, (1 << 8 * size) - 1
        elif sign == TWOS_COMPLEMENT:
            register.value_range = -(1 << 8 * size - 1), (1 << 8 * size - 1) - 1
        else:
            register.value_range = 1 - (1 << sign), (1 << sign) - 1
        return register

    def encode(self, value: int) -> bytes:
        """Encode a value as the bytes of the register; raises ValueError for a value that it cannot hold."""
        lowest, highest = self.value_range
        if not lowest <= value <= highest:
            raise ValueError(f"{self.name} holds {lowest} to {highest}, not {value}")
        if self.sign == TWOS_COMPLEMENT:
            return value.to_bytes(self.size, "little", signed=True)
        raw = value if self.sign is None or value >= 0 else -value | 1 << self.sign
        return raw.to_bytes(self.size, "little")

    def decode(self, data: bytes) -> int:
        """Decode the bytes of the register; raises ValueError for another number of them."""
        if len(data) != self.size:
            raise ValueError(f"{self.name} has {self.size} bytes, not {len(data)}")
        raw = int.from_bytes(data, "little", signed=self.sign == TWOS_COMPLEMENT)
        if self.sign is None or self.sign == TWOS_COMPLEMENT:
            return raw
        magnitude = raw & ((1 << self.sign) - 1)
        return -magnitude if raw >> self.sign & 1 else magnitude


RegisterT = TypeVar("RegisterT", bound=RegisterEnum)


@dataclass(frozen=True)
class Block(Generic[RegisterT]):
    """Registers that are read in one transaction."""

    address: int  # of the first byte
    length: int  # bytes
    registers: tuple[RegisterT, ...]  # within, in the order of their addresses

    def parse(self, data: bytes) -> dict[RegisterT, int]:
        """Decode the registers of the block; raises ValueError for another number of bytes."""
        if len(data) != self.length:
            raise ValueError(f"the block from {self.registers[0].name} has {self.length} bytes, not {len(data)}")
        starts = {register: register - self.address for register in self.registers}
        return {register: register.decode(data[start : start + register.size]) for register, start in starts.items()}


class RegisterTable(Generic[RegisterT]):
    """Registers of a family in the order of their addresses, those that every servo has by their names."""

    def __init__(self, registers: type[RegisterT]) -> None:
        self.registers = tuple(registers)
        self.model_number = registers["MODEL_NUMBER"]
        self.torque_enable = registers["TORQUE_ENABLE"]
        self.goal_position = registers["GOAL_POSITION"]
        self.present_position = registers["PRESENT_POSITION"]
        self.homing_offset = registers["HOMING_OFFSET"]

    def block(self, first: RegisterT, last: RegisterT | None = None) -> Block[RegisterT]:
        """Return the block of all registers from the first to the last one; of the first alone without a last one."""
        last = first if last is None else last
        within = tuple(register for register in self.registers if first <= register <= last)
        return Block(int(first), last + last.size - first, within)


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

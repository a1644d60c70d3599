"""Table of a servo family's registers: address, size, sign and memory area of each, and the codec of their values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Generic, TypeVar

RegisterT = TypeVar("RegisterT", bound=IntEnum)


class Area(Enum):
    """Memory area of a register."""

    READ_ONLY = "read only"
    EEPROM = "EEPROM"
    RAM = "RAM"


@dataclass(frozen=True)
class Layout:
    """Storage of a register, little endian.

    Attributes:
        size: bytes, 1, 2 or 4.
        area: memory area.
        sign_bit: bit that marks a negative value of sign and magnitude; None for a register without such a bit.
        signed: True for two's complement.
    """

    size: int
    area: Area
    sign_bit: int | None = None
    signed: bool = False


@dataclass(frozen=True)
class Block(Generic[RegisterT]):
    """Registers that are read in one transaction.

    Attributes:
        address: of the first byte.
        length: bytes.
        registers: registers within, in the order of their addresses.
    """

    address: int
    length: int
    registers: tuple[RegisterT, ...]


class RegisterTable(Generic[RegisterT]):
    """Registers of a family.

    The driver finds the registers that every servo has by their names: MODEL_NUMBER, TORQUE_ENABLE, GOAL_POSITION,
    PRESENT_POSITION and HOMING_OFFSET.

    Args:
        layout: storage of each register, in the order of the addresses.

    Attributes:
        layout: as given.
    """

    def __init__(self, layout: Mapping[RegisterT, Layout]) -> None:
        self.layout = layout
        self._ranges = {register: _value_range(each) for register, each in layout.items()}
        named = {register.name: register for register in layout}
        self.model_number = named["MODEL_NUMBER"]
        self.torque_enable = named["TORQUE_ENABLE"]
        self.goal_position = named["GOAL_POSITION"]
        self.present_position = named["PRESENT_POSITION"]
        self.homing_offset = named["HOMING_OFFSET"]

    def value_range(self, register: RegisterT) -> tuple[int, int]:
        """Return the lowest and highest value that a register can hold."""
        return self._ranges[register]

    def encode(self, register: RegisterT, value: int) -> bytes:
        """Encode a value as the bytes of its register.

        Raises:
            ValueError: the register cannot hold the value.
        """
        layout, (lowest, highest) = self.layout[register], self._ranges[register]
        if not lowest <= value <= highest:
            raise ValueError(f"{register.name} holds {lowest} to {highest}, not {value}")
        if layout.sign_bit is not None and value < 0:
            value = -value | 1 << layout.sign_bit
        return value.to_bytes(layout.size, "little", signed=layout.signed)

    def decode(self, register: RegisterT, data: bytes) -> int:
        """Decode the bytes of a register.

        Raises:
            ValueError: ``data`` is not as long as the register.
        """
        layout = self.layout[register]
        if len(data) != layout.size:
            raise ValueError(f"{register.name} has {layout.size} bytes, not {len(data)}")
        raw = int.from_bytes(data, "little", signed=layout.signed)
        if layout.sign_bit is None:
            return raw
        magnitude = raw & ((1 << layout.sign_bit) - 1)
        return -magnitude if raw >> layout.sign_bit & 1 else magnitude

    def block(self, first: RegisterT, last: RegisterT | None = None) -> Block[RegisterT]:
        """Return the block of all registers from the first to the last one; of the first alone without a last one."""
        last = first if last is None else last
        within = tuple(register for register in self.layout if first <= register <= last)
        return Block(int(first), last + self.layout[last].size - first, within)

    def parse(self, block: Block[RegisterT], data: bytes) -> dict[RegisterT, int]:
        """Decode the registers of a block.

        Raises:
            ValueError: ``data`` is not as long as the block.
        """
        if len(data) != block.length:
            raise ValueError(f"the block from {block.registers[0].name} has {block.length} bytes, not {len(data)}")
        starts = {register: register - block.address for register in block.registers}
        return {
            register: self.decode(register, data[start : start + self.layout[register].size])
            for register, start in starts.items()
        }


def _value_range(layout: Layout) -> tuple[int, int]:
    bits = 8 * layout.size
    if layout.signed:
        return -(1 << bits - 1), (1 << bits - 1) - 1
    if layout.sign_bit is None:
        return 0, (1 << bits) - 1
    highest = (1 << layout.sign_bit) - 1
    return -highest, highest

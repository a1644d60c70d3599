"""A servo's register file: 87 bytes, of which those of the EPROM outlive a power cut."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from robot.hardware.feetech.registers import LAYOUT, Area, Register, decode, encode, value_range

# The last documented address is 86; whatever is asked beyond reads as zero.
MEMORY_BYTES = 87

MODEL_STS3215 = 777
FIRMWARE_MAJOR_MINOR = bytes([3, 10])

# Feetech's memory table V3.6, what a new servo holds; angle limits and id are the arm's.
FACTORY_EPROM: Mapping[Register, int] = MappingProxyType(
    {
        Register.RESPONSE_LEVEL: 1,
        Register.MAX_ANGLE_LIMIT: 4095,
        Register.MAX_TEMPERATURE: 70,
        Register.MAX_VOLTAGE: 80,
        Register.MIN_VOLTAGE: 40,
        Register.MAX_TORQUE: 1000,
        Register.PHASE: 12,
        Register.UNLOADING_CONDITION: 44,
        Register.LED_ALARM_CONDITION: 47,
        Register.P_GAIN: 32,
        Register.D_GAIN: 32,
        Register.MIN_STARTUP_FORCE: 16,
        Register.CW_DEAD_ZONE: 1,
        Register.CCW_DEAD_ZONE: 1,
        Register.PROTECTION_CURRENT: 500,
        Register.ANGULAR_RESOLUTION: 1,
        Register.PROTECTIVE_TORQUE: 20,
        Register.PROTECTION_TIME: 200,
        Register.OVERLOAD_TORQUE: 80,
    }
)

# EPROM ends where SRAM begins, also between the documented registers.
_EPROM_ADDRESSES = range(Register.ID, Register.TORQUE_ENABLE)
_READ_ONLY_ADDRESSES = frozenset(
    register + offset
    for register, layout in LAYOUT.items()
    if layout.area is Area.READ_ONLY
    for offset in range(layout.size)
)
_REGISTER_AT: Mapping[int, Register] = MappingProxyType(
    {register + offset: register for register, layout in LAYOUT.items() for offset in range(layout.size)}
)


class Memory:
    """The registers of one servo, from power-up on.

    Args:
        eprom: what its EPROM holds; registers not named are 0.
    """

    def __init__(self, eprom: Mapping[Register, int]) -> None:
        self._bytes = bytearray(MEMORY_BYTES)
        self._values: dict[Register, int] = {}  # decoded once: the bus asks for them at every packet
        self._bytes[0:2] = FIRMWARE_MAJOR_MINOR
        for register, value in {Register.MODEL_NUMBER: MODEL_STS3215, **eprom}.items():
            self.set(register, value)
        self._backup = self._eprom = self._present_eprom()
        self.power_up()

    def power_up(self) -> None:
        """Start as after a power cut: EPROM as last stored, torque off, goal 0, the torque limit as in EPROM."""
        self._bytes[:] = self._eprom + bytes(MEMORY_BYTES - len(self._eprom))
        self._values.clear()
        self.set(Register.TORQUE_LIMIT, self.value(Register.MAX_TORQUE))
        self.set(Register.LOCK, 1)

    def value(self, register: Register) -> int:
        """Value of a register."""
        value = self._values.get(register)
        if value is None:
            value = decode(register, bytes(self._bytes[register : register + LAYOUT[register].size]))
            self._values[register] = value
        return value

    def set(self, register: Register, value: int) -> None:
        """Set a register, read-only or not."""
        self._bytes[register : register + LAYOUT[register].size] = encode(register, value)
        self._values[register] = value

    def show(self, register: Register, value: int) -> None:
        """Set a measured register, which shows its largest value when it cannot hold the true one."""
        if self._values.get(register) == value:
            return
        lowest, highest = value_range(register)
        self.set(register, max(lowest, min(highest, value)))

    def read(self, address: int, length: int) -> bytes:
        """Read bytes; what lies beyond the memory is zero."""
        return bytes(self._bytes[address : address + length]).ljust(length, b"\0")

    def write(self, address: int, data: bytes) -> bool:
        """Write bytes as an instruction does; returns whether any register may hold another value now.

        Read-only bytes keep their value. EPROM changes act at once, but outlive a power cut only while LOCK is 0.
        """
        # A goal is told a hundred times a second, also while the arm rests.
        if self._bytes[address : address + len(data)] == data:
            return False
        unlocked = self._bytes[Register.LOCK] == 0
        for at, byte in enumerate(data, start=address):
            if Register.ID <= at < MEMORY_BYTES and at not in _READ_ONLY_ADDRESSES:
                self._bytes[at] = byte
                if at in _REGISTER_AT:
                    self._values.pop(_REGISTER_AT[at], None)
        if unlocked:
            self.store()
        return True

    def store(self) -> None:
        """Let the EPROM as it is outlive a power cut, locked or not."""
        self._eprom = self._present_eprom()

    def back_up(self) -> None:
        """Keep the EPROM as it is for :meth:`restore`."""
        self._backup = self._present_eprom()

    def restore(self) -> None:
        """Bring back the EPROM last backed up, or what it held at first; the id stays."""
        servo_id = self.value(Register.ID)
        self._bytes[: len(self._backup)] = self._backup
        self._values.clear()
        self.set(Register.ID, servo_id)
        self.store()

    def _present_eprom(self) -> bytes:
        return bytes(self._bytes[: _EPROM_ADDRESSES.stop])

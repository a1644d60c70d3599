"""One STS3215 servo: its register file, and the plant that the registers drive."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from robot.emulator.plant import NO_LOAD_TICKS_S, Drive, Plant
from robot.registers import (
    AMPERE_PER_UNIT,
    LAYOUT,
    TICKS_S2_PER_ACCELERATION_UNIT,
    Area,
    Register,
    decode,
    encode,
    value_range,
)

# The last documented address is 86; whatever is asked beyond reads as zero.
MEMORY_BYTES = 87

MODEL_STS3215 = 777
FIRMWARE_MAJOR_MINOR = bytes([3, 10])

# The SO-101's usual supply of 5 V, in 0.1 V.
SUPPLY_UNITS = 50
TEMPERATURE_C = 32

# Acceleration 0 means the most the servo has; lerobot writes this to its limit register.
MAX_ACCELERATION = 254

# A joint slower than this stands still as far as register MOVING is concerned.
STANDSTILL_TICKS_S = 3.0

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


class Servo:
    """A servo on the bus, from power-up on.

    Args:
        servo_id: its id.
        plant: the joint it moves, in ticks of its encoder.
        angle_limits_ticks: registers MIN_ANGLE_LIMIT and MAX_ANGLE_LIMIT.
        homing_offset_ticks: register HOMING_OFFSET.
    """

    def __init__(
        self, servo_id: int, plant: Plant, angle_limits_ticks: tuple[int, int], homing_offset_ticks: int = 0
    ) -> None:
        self.plant = plant
        self._memory = bytearray(MEMORY_BYTES)
        self._memory[0:2] = FIRMWARE_MAJOR_MINOR
        self._set(Register.MODEL_NUMBER, MODEL_STS3215)
        self._set(Register.ID, servo_id)
        for register, value in FACTORY_EPROM.items():
            self._set(register, value)
        self._set(Register.MIN_ANGLE_LIMIT, angle_limits_ticks[0])
        self._set(Register.MAX_ANGLE_LIMIT, angle_limits_ticks[1])
        self._set(Register.HOMING_OFFSET, homing_offset_ticks)
        self._eprom = bytes(self._memory[: _EPROM_ADDRESSES.stop])
        self.power_up()

    def power_up(self) -> None:
        """Start as after a power cut: EPROM as last stored, torque off.

        The goal is 0, wherever the arm is: who switches torque on without setting it sees the arm jump.
        """
        self._memory[:] = self._eprom + bytes(MEMORY_BYTES - len(self._eprom))
        self._set(Register.TORQUE_LIMIT, self.value(Register.MAX_TORQUE))
        self._set(Register.LOCK, 1)
        self._drive = self._drive_from_registers()

    @property
    def servo_id(self) -> int:
        """The id it answers to."""
        return self._memory[Register.ID]

    @property
    def error(self) -> int:
        """The ERR byte of its replies."""
        return self._memory[Register.STATUS]

    @property
    def present_ticks(self) -> int:
        """Register PRESENT_POSITION: the encoder less the homing offset."""
        return round(self.plant.position_ticks) - self.value(Register.HOMING_OFFSET)

    def value(self, register: Register) -> int:
        """Value of a register other than the measured ones."""
        return decode(register, bytes(self._memory[register : register + LAYOUT[register].size]))

    def step(self, duration_s: float) -> None:
        """Let time pass [s]."""
        self.plant.step(duration_s, self._drive)

    def read(self, address: int, length: int) -> bytes:
        """Read memory; what lies beyond it is zero."""
        self._measure()
        return bytes(self._memory[address : address + length]).ljust(length, b"\0")

    def write(self, address: int, data: bytes) -> None:
        """Write memory as an instruction does.

        Read-only bytes keep their value. EPROM changes act at once, but outlive a power cut only while LOCK
        is 0.
        """
        unlocked = self._memory[Register.LOCK] == 0
        for at, byte in enumerate(data, start=address):
            if Register.ID <= at < MEMORY_BYTES and at not in _READ_ONLY_ADDRESSES:
                self._memory[at] = byte
        if unlocked:
            self._eprom = bytes(self._memory[: _EPROM_ADDRESSES.stop])
        self._drive = self._drive_from_registers()

    def _set(self, register: Register, value: int) -> None:
        self._memory[register : register + LAYOUT[register].size] = encode(register, value)

    def _show(self, register: Register, value: int) -> None:
        """Set a measured register, which shows its largest value when it cannot hold the true one."""
        lowest, highest = value_range(register)
        self._set(register, max(lowest, min(highest, value)))

    def _measure(self) -> None:
        """Bring the read-only registers up to date."""
        plant, drive = self.plant, self._drive
        self._show(Register.PRESENT_POSITION, self.present_ticks)
        self._show(Register.PRESENT_VELOCITY, round(plant.velocity_ticks_s))
        self._show(Register.PRESENT_LOAD, round(plant.duty_permille))
        self._show(Register.PRESENT_VOLTAGE, SUPPLY_UNITS)
        self._show(Register.PRESENT_TEMPERATURE, TEMPERATURE_C)
        driven = drive.torque_permille > 0.0
        self._show(Register.MOVING, int(driven and abs(plant.velocity_ticks_s) > STANDSTILL_TICKS_S))
        self._show(Register.GOAL_POSITION_ECHO, round(drive.goal_ticks) - self.value(Register.HOMING_OFFSET))
        self._show(Register.PRESENT_CURRENT, round(plant.current_a / AMPERE_PER_UNIT))

    def _drive_from_registers(self) -> Drive:
        lowest, highest = self.value(Register.MIN_ANGLE_LIMIT), self.value(Register.MAX_ANGLE_LIMIT)
        goal = self.value(Register.GOAL_POSITION)
        if (lowest, highest) != (0, 0):  # both 0 is multi-turn mode, without limits
            goal = max(lowest, min(highest, goal))
        acceleration = self.value(Register.ACCELERATION) or MAX_ACCELERATION
        torque_on = self.value(Register.TORQUE_ENABLE) == 1
        return Drive(
            goal_ticks=goal + self.value(Register.HOMING_OFFSET),
            velocity_ticks_s=abs(self.value(Register.GOAL_VELOCITY)) or NO_LOAD_TICKS_S,
            acceleration_ticks_s2=acceleration * TICKS_S2_PER_ACCELERATION_UNIT,
            torque_permille=self.value(Register.TORQUE_LIMIT) if torque_on else 0,
            p_gain=self.value(Register.P_GAIN),
        )

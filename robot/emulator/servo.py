"""Emulated STS3215 servo: its registers, the plant that they drive, and its protection. Pure: time is passed in."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from robot.emulator.plant import NO_LOAD_TICKS_S, Drive, Motor, Plant
from robot.emulator.populations import SUPPLY_V
from robot.hardware.feetech.registers import (
    AMPERE_PER_UNIT,
    LAYOUT,
    MODELS,
    TICKS_S2_PER_ACCELERATION_UNIT,
    VOLT_PER_UNIT,
    Area,
    Register,
    decode,
    encode,
    value_range,
)
from robot.hardware.interface import StatusFlag

# Register ACCELERATION 0 means the greatest one; lerobot writes this value to the limit register.
MAX_ACCELERATION = 254

# Register PHASE, bit 4: the position counts on beyond one turn of the encoder, instead of beginning again.
PHASE_MULTI_TURN = 0x10
TICKS_PER_TURN = 4096

# Register MOVING is 0 for a slower joint.
STANDSTILL_TICKS_S = 3.0

# This value in register TORQUE_ENABLE makes the present position the middle; torque stays as it was.
TORQUE_ENABLE_MAKES_MIDDLE = 128
MIDDLE_TICKS = 2048

# Heat and protection change slowly: interval of their steps, and that of a joint at rest.
PROTECTION_STEP_S = 0.01
RESTING_PROTECTION_STEP_S = 0.04

PERMILLE_PER_PERCENT = 10
PROTECTION_TIME_UNIT_S = 0.01

# Factory value of register 38, which is not emulated.
OVERCURRENT_TIME_S = 2.0

FULL_DUTY_PERMILLE = 1000.0

# The last documented address is 86; addresses beyond it read as zero.
MEMORY_BYTES = 87

FIRMWARE_MAJOR_MINOR = bytes([3, 10])

# Values of a new servo, from Feetech's memory table V3.6; angle limits and id are the arm's.
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

# The EPROM ends where the SRAM begins, including addresses that are not documented.
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


class Servo:
    """Servo on the bus, from power-up on.

    Args:
        plant: joint that it moves, in encoder ticks.
        eprom: registers that differ from those of a new servo; the angle limits are in ticks of PRESENT_POSITION.
        joint: name of the joint.
        zero_ticks: position of the encoder where the calibration has its tick 0.

    Attributes:
        plant: as given.
        joint: as given.
        zero_ticks: as given.
        mirrored: True if the horn is mounted mirrored, which no register shows; see :meth:`mirror`.
        connected: False while its cable is unplugged: it has no power, and is not on the wire.
        powers_up_holding: True if power-ups leave torque on, at the present position.
        powers_up_unlocked: True if power-ups leave the EPROM unlocked.
        motor: temperature of the motor, which may be set.
        protection: timers, latches and error bits, some of which may be forced.
        voltage_v: supply [V], which may be set.
        changes: number of writes that changed a register.
        servo_id: register ID.
        baudrate_code: register BAUD_RATE.
    """

    def __init__(self, plant: Plant, eprom: Mapping[Register, int], *, joint: str = "", zero_ticks: int = 0) -> None:
        self.plant = plant
        self.joint = joint
        self.zero_ticks = zero_ticks
        self.connected = True
        self.mirrored = False
        self.motor = Motor()
        self.protection = Protection()
        self.voltage_v = SUPPLY_V
        self.powers_up_holding = self.powers_up_unlocked = False
        self._memory = Memory({**FACTORY_EPROM, **eprom})
        # Time since the latest step of heat and protection.
        self._unprotected_s = 0.0
        self.changes = 0
        self._shown: tuple[object, ...] | None = None
        self.power_up()

    def power_up(self, *, holding: bool = False) -> None:
        """Start as after a power cut: EPROM as last stored, torque off.

        The goal is 0 at any position: switching torque on without setting it makes the arm jump. Only a servo that
        powers up holding has its position as the goal.

        Args:
            holding: True to power up holding this time, whatever :attr:`powers_up_holding` says.
        """
        self._memory.power_up()
        self._kept: tuple[int, bytes] | None = None
        self.protection.power_up()
        if self.powers_up_unlocked:
            self._memory.set(Register.LOCK, 0)
        if self.connected and (holding or self.powers_up_holding):
            self._memory.show(Register.GOAL_POSITION, self.present_ticks)
            self._memory.set(Register.TORQUE_ENABLE, 1)
        self._follow_registers()

    def unplug(self) -> None:
        """Pull its cable: the servo loses its power."""
        self.connected = False
        self.power_up()

    def plug_in(self) -> None:
        """Plug its cable in; a servo that has power already goes on."""
        if not self.connected:
            self.connected = True
            self.power_up()

    @property
    def visible(self) -> tuple[object, ...]:
        """Everything that its measured registers depend on; while it is unchanged they read the same."""
        plant = self.plant
        return (
            plant.position_ticks,
            plant.velocity_ticks_s,
            plant.duty_permille,
            self.voltage_v,
            round(self.motor.temperature_c),
            self.protection.status,
            self.changes,
        )

    @property
    def error(self) -> int:
        """ERR byte of its replies."""
        return int(self.protection.status)

    @property
    def present_ticks(self) -> int:
        """Register PRESENT_POSITION: the encoder less the homing offset."""
        return self._shown_ticks(self.plant.position_ticks)

    @property
    def joint_ticks(self) -> float:
        """Position of the joint in ticks of the calibration."""
        plant = self.plant
        mirror = plant.lower_stop_ticks + plant.upper_stop_ticks
        position = mirror - plant.position_ticks if self.mirrored else plant.position_ticks
        return position - self.zero_ticks

    def mirror(self) -> None:
        """Mount the horn mirrored, or take that back: the joint stays, and the encoder turns the other way from it."""
        self.mirrored = not self.mirrored
        plant = self.plant
        plant.position_ticks = plant.lower_stop_ticks + plant.upper_stop_ticks - plant.position_ticks
        plant.gravity_permille = -plant.gravity_permille

    def encoder_ticks(self, shown_ticks: float) -> float:
        """Return the encoder's position for one of PRESENT_POSITION: the nearest that the joint can reach."""
        plant = self.plant
        here = shown_ticks + self.value(Register.HOMING_OFFSET) + self._turn * TICKS_PER_TURN
        turns = (here, here - TICKS_PER_TURN, here + TICKS_PER_TURN)
        reachable = [ticks for ticks in turns if plant.lower_stop_ticks <= ticks <= plant.upper_stop_ticks]
        return min(reachable or turns[:1], key=lambda ticks: abs(ticks - plant.position_ticks))

    def value(self, register: Register) -> int:
        """Return the value of a register other than the measured ones."""
        return self._memory.value(register)

    def step(self, duration_s: float) -> None:
        """Advance by ``duration_s`` [s]."""
        if not self._turn_begins_ticks <= self.plant.position_ticks < self._turn_ends_ticks:
            self._drive = self._drive_from_registers()
        self.plant.step(duration_s, self._drive)
        self._unprotected_s += duration_s
        if self._unprotected_s >= (RESTING_PROTECTION_STEP_S if self.plant.at_rest else PROTECTION_STEP_S):
            self.update_protection()

    def read(self, address: int, length: int) -> bytes:
        """Read memory; addresses beyond it are zero."""
        self._measure()
        return self._memory.read(address, length)

    def write(self, address: int, data: bytes) -> None:
        """Write memory as an instruction does; see :meth:`robot.emulator.servo.Memory.write`."""
        torque = self.value(Register.TORQUE_ENABLE)
        at = Register.TORQUE_ENABLE - address
        if self.protection.refuses_torque_off and torque and 0 <= at < len(data) and not data[at]:
            data = data[:at] + bytes([torque]) + data[at + 1 :]
        if not self._memory.write(address, data):
            return
        self.changes += 1
        asked = self.value(Register.TORQUE_ENABLE)
        if asked == TORQUE_ENABLE_MAKES_MIDDLE:
            self._memory.set(Register.TORQUE_ENABLE, torque)
            self.make_middle()
        elif torque and not asked:
            self.protection.torque_off()
        if address < Register.TORQUE_ENABLE:
            self._follow_registers()
        else:
            self._drive = self._drive_from_registers()

    def keep_write(self, address: int, data: bytes) -> None:
        """Buffer a write (REG_WRITE) until :meth:`take_kept_write`; only the last one is kept."""
        self._kept = (address, data)

    def take_kept_write(self) -> tuple[int, bytes] | None:
        """Carry out the buffered write and return it; None if there is none."""
        kept, self._kept = self._kept, None
        if kept is not None:
            self.write(*kept)
        return kept

    def make_middle(self) -> None:
        """Store the homing offset with which the present position reads 2048, or as near as the register allows."""
        lowest, highest = value_range(Register.HOMING_OFFSET)
        offset = round(self.plant.position_ticks) % TICKS_PER_TURN - MIDDLE_TICKS
        self._memory.set(Register.HOMING_OFFSET, max(lowest, min(highest, offset)))
        self._memory.store()
        self._follow_registers()

    def back_up(self) -> None:
        """Back the EPROM up for :meth:`restore`."""
        self._memory.back_up()

    def restore(self) -> None:
        """Restore the EPROM of the latest backup, or the initial one; the id stays."""
        self._memory.restore()
        self._follow_registers()

    def update_protection(self) -> None:
        """Bring motor temperature and protection up to the present."""
        plant, duration_s, self._unprotected_s = self.plant, self._unprotected_s, 0.0
        self.motor.step(duration_s, plant.current_a)
        measured = Measured(plant.duty_permille, plant.current_a, self.motor.temperature_c, self.voltage_v)
        before = self.protection.status
        self.protection.step(duration_s, measured, self._thresholds)
        if self.protection.status != before:
            self._drive = self._drive_from_registers()

    def _measure(self) -> None:
        """Bring the read-only registers up to date."""
        plant, drive, memory = self.plant, self._drive, self._memory
        seen = self.visible
        if seen == self._shown:
            return
        self._shown = seen
        memory.show(Register.PRESENT_POSITION, self.present_ticks)
        memory.show(Register.PRESENT_VELOCITY, round(plant.velocity_ticks_s))
        memory.show(Register.PRESENT_LOAD, round(plant.duty_permille))
        memory.show(Register.PRESENT_VOLTAGE, round(self.voltage_v / VOLT_PER_UNIT))
        memory.show(Register.PRESENT_TEMPERATURE, round(self.motor.temperature_c))
        memory.show(Register.STATUS, self.error)
        driven = drive.torque_permille > 0.0
        memory.show(Register.MOVING, int(driven and abs(plant.velocity_ticks_s) > STANDSTILL_TICKS_S))
        memory.show(Register.GOAL_POSITION_ECHO, self._goal_ticks)
        memory.show(Register.PRESENT_CURRENT, round(plant.current_a / AMPERE_PER_UNIT))

    def _shown_ticks(self, encoder_ticks: float) -> int:
        counted = round(encoder_ticks) - self.value(Register.HOMING_OFFSET)
        return counted if self._counts_on else counted % TICKS_PER_TURN

    @property
    def _counts_on(self) -> bool:
        return bool(self.value(Register.PHASE) & PHASE_MULTI_TURN)

    @property
    def _turn(self) -> int:
        """Turn of the encoder in which the position lies; 0 while the position counts on."""
        offset = self.value(Register.HOMING_OFFSET)
        return 0 if self._counts_on else (round(self.plant.position_ticks) - offset) // TICKS_PER_TURN

    def _follow_registers(self) -> None:
        value = self.value
        self.servo_id, self.baudrate_code = value(Register.ID), value(Register.BAUD_RATE)
        self._shown = None
        self.changes += 1
        self._thresholds = Thresholds(
            voltage_v=(value(Register.MIN_VOLTAGE) * VOLT_PER_UNIT, value(Register.MAX_VOLTAGE) * VOLT_PER_UNIT),
            temperature_c=value(Register.MAX_TEMPERATURE),
            overload_permille=value(Register.OVERLOAD_TORQUE) * PERMILLE_PER_PERCENT,
            overload_s=value(Register.PROTECTION_TIME) * PROTECTION_TIME_UNIT_S,
            protective_permille=value(Register.PROTECTIVE_TORQUE) * PERMILLE_PER_PERCENT,
            current_a=value(Register.PROTECTION_CURRENT) * AMPERE_PER_UNIT,
            unloading=StatusFlag(value(Register.UNLOADING_CONDITION)),
        )
        self._drive = self._drive_from_registers()

    def _drive_from_registers(self) -> Drive:
        lowest, highest = self.value(Register.MIN_ANGLE_LIMIT), self.value(Register.MAX_ANGLE_LIMIT)
        goal = self.value(Register.GOAL_POSITION)
        if (lowest, highest) != (0, 0):  # both 0 is multi-turn mode, without limits
            goal = max(lowest, min(highest, goal))
        self._goal_ticks = goal
        # A goal lies in the turn that is read: the servo does not take the short way across the seam.
        zero = self.value(Register.HOMING_OFFSET) + self._turn * TICKS_PER_TURN
        self._turn_begins_ticks = -math.inf if self._counts_on else zero - 0.5
        self._turn_ends_ticks = math.inf if self._counts_on else zero - 0.5 + TICKS_PER_TURN
        acceleration = self.value(Register.ACCELERATION) or MAX_ACCELERATION
        torque_on = self.value(Register.TORQUE_ENABLE) == 1
        torque_left = min(self.value(Register.TORQUE_LIMIT), self.protection.duty_left_permille(self._thresholds))
        return Drive(
            goal_ticks=goal + zero,
            velocity_ticks_s=abs(self.value(Register.GOAL_VELOCITY)) or NO_LOAD_TICKS_S,
            acceleration_ticks_s2=acceleration * TICKS_S2_PER_ACCELERATION_UNIT,
            torque_permille=torque_left if torque_on else 0,
            p_gain=self.value(Register.P_GAIN),
        )


class Memory:
    """Register file of one servo: 87 bytes, of which the EPROM outlives a power cut.

    Args:
        eprom: values of the EPROM; registers not named are 0.
    """

    def __init__(self, eprom: Mapping[Register, int]) -> None:
        self._bytes = bytearray(MEMORY_BYTES)
        self._values: dict[Register, int] = {}  # decoded once: the bus asks for them at every packet
        self._bytes[0:2] = FIRMWARE_MAJOR_MINOR
        for register, value in {Register.MODEL_NUMBER: MODELS["sts3215"], **eprom}.items():
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
        """Return the value of a register."""
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
        """Set a measured register; a value beyond its range saturates."""
        if self._values.get(register) == value:
            return
        lowest, highest = value_range(register)
        self.set(register, max(lowest, min(highest, value)))

    def read(self, address: int, length: int) -> bytes:
        """Read bytes; addresses beyond the memory are zero."""
        return bytes(self._bytes[address : address + length]).ljust(length, b"\0")

    def write(self, address: int, data: bytes) -> bool:
        """Write bytes as an instruction does.

        Read-only bytes keep their value. EPROM changes act at once, but outlive a power cut only while LOCK is 0.

        Returns:
            True when a register may have changed.
        """
        # Goals are written a hundred times a second, also while the arm rests.
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
        """Store the present EPROM, locked or not, so that it outlives a power cut."""
        self._eprom = self._present_eprom()

    def back_up(self) -> None:
        """Back the present EPROM up for :meth:`restore`."""
        self._backup = self._present_eprom()

    def restore(self) -> None:
        """Restore the EPROM of the latest backup, or the initial one; the id stays."""
        servo_id = self.value(Register.ID)
        self._bytes[: len(self._backup)] = self._backup
        self._values.clear()
        self.set(Register.ID, servo_id)
        self.store()

    def _present_eprom(self) -> bytes:
        return bytes(self._bytes[: _EPROM_ADDRESSES.stop])


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the protection, from the EPROM.

    Attributes:
        voltage_v: lowest and highest supply [V].
        temperature_c: highest temperature [degC].
        overload_permille: duty from which the overload timer runs [0.1 %].
        overload_s: time after which the overload latches [s].
        protective_permille: duty left after an overload [0.1 %].
        current_a: greatest current [A].
        unloading: error bits that cut torque.
    """

    voltage_v: tuple[float, float]
    temperature_c: float
    overload_permille: float
    overload_s: float
    protective_permille: float
    current_a: float
    unloading: StatusFlag


@dataclass(frozen=True)
class Measured:
    """Measurements of the servo.

    Attributes:
        duty_permille: motor duty, signed [0.1 %].
        current_a: motor current, signed [A].
        temperature_c: temperature of the motor [degC].
        voltage_v: supply [V].
    """

    duty_permille: float
    current_a: float
    temperature_c: float
    voltage_v: float


class Protection:
    """Timers and latches of one servo's protection, and the torque that its error bits leave.

    Overload and overcurrent last until torque is switched off, or until a power cycle if ``latches``; the other errors
    last as long as their cause.

    Attributes:
        latches: True if the servo ignores torque off after an overload, as is reported of some: it goes on with the
            torque that is left, and every reply has the error bit, until a power cycle.
        forced: error bits forced by a command.
        status: error bits, register STATUS.
    """

    def __init__(self) -> None:
        self.latches = False
        self.forced = self.status = self._latched = StatusFlag(0)
        self._overload_s = self._overcurrent_s = 0.0

    def step(self, duration_s: float, measured: Measured, limits: Thresholds) -> None:
        """Advance by ``duration_s`` [s] with the measurements at its end."""
        overloaded = abs(measured.duty_permille) >= limits.overload_permille
        self._overload_s = self._overload_s + duration_s if overloaded else 0.0
        self._overcurrent_s = self._overcurrent_s + duration_s if abs(measured.current_a) > limits.current_a else 0.0
        if self._overload_s > limits.overload_s:
            self._latched |= StatusFlag.OVERLOAD
        if self._overcurrent_s > OVERCURRENT_TIME_S:
            self._latched |= StatusFlag.CURRENT
        self.status = self._latched | self.forced
        if not limits.voltage_v[0] <= measured.voltage_v <= limits.voltage_v[1]:
            self.status |= StatusFlag.VOLTAGE
        if measured.temperature_c > limits.temperature_c:
            self.status |= StatusFlag.TEMPERATURE

    @property
    def refuses_torque_off(self) -> bool:
        """True while an overload is latched that only a power cycle clears."""
        return self.latches and bool(self._latched)

    def duty_left_permille(self, limits: Thresholds) -> float:
        """Return the largest duty that the error bits leave [0.1 %]."""
        effective = self.status & limits.unloading
        if effective & ~StatusFlag.OVERLOAD:
            return 0.0
        return limits.protective_permille if effective else FULL_DUTY_PERMILLE

    def torque_off(self) -> None:
        """Clear the latches that switching torque off clears."""
        if not self.latches:
            self.power_up()

    def power_up(self) -> None:
        """Clear timers and latches."""
        self._overload_s = self._overcurrent_s = 0.0
        self.status &= ~self._latched | self.forced
        self._latched = StatusFlag(0)

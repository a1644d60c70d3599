"""Emulated servo, alike in every family: memory, plant, heat and protection. Pure: time is passed in."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Generic

from robot.emulator.plant import Drive, Motor, Plant
from robot.hardware.interface import StatusFlag
from robot.hardware.servos.registers import RETURN_DELAY_UNIT_US, RegisterT, RegisterTable

FULL_DUTY_PERMILLE = 1000.0


class Memory(Generic[RegisterT]):
    """Bytes of a servo's registers; all are 0 at first."""

    def __init__(self, table: RegisterTable[RegisterT], size: int) -> None:
        self._bytes = bytearray(size)
        # Decoded once, by address: the bus asks for them at every packet.
        self._values: list[int | None] = [None] * size
        self.register_at = {
            register + offset: register for register in table.registers for offset in range(register.size)
        }

    def value(self, register: RegisterT) -> int:
        value = self._values[register]
        if value is None:
            value = register.decode(self.read(register, register.size))
            self._values[register] = value
        return value

    def set(self, register: RegisterT, value: int) -> None:
        """Set a register; a value beyond its range saturates."""
        if self._values[register] == value:
            return
        lowest, highest = register.value_range
        value = max(lowest, min(highest, value))
        self._bytes[register : register + register.size] = register.encode(value)
        self._values[register] = value

    def read(self, address: int, length: int) -> bytes:
        """Read bytes; addresses beyond the memory are zero."""
        return bytes(self._bytes[address : address + length]).ljust(length, b"\0")

    def write(self, address: int, data: bytes) -> None:
        """Replace bytes; those beyond the memory are dropped."""
        for at, byte in enumerate(data[: max(0, len(self._bytes) - address)], start=address):
            self._bytes[at] = byte
            if at in self.register_at:
                self._values[self.register_at[at]] = None

    def decode_block(self, address: int, data: bytes) -> dict[RegisterT, int]:
        """Return the values of the registers that lie wholly inside the bytes of a block."""
        values = {}
        for at in range(address, address + len(data)):
            register = self.register_at.get(at)
            if register is not None and register == at and at + register.size <= address + len(data):
                values[register] = register.decode(data[at - address :][: register.size])
        return values


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of a servo's protection."""

    voltage_v: tuple[float, float]  # lowest and highest supply [V]
    temperature_c: float  # highest temperature [degC]
    load_permille: float  # load from which the overload timer runs [0.1 %]
    overload_s: float  # time after which an overload is detected [s]
    current_a: float  # greatest current [A]
    overcurrent_s: float  # time after which a greater current is detected [s]
    latching: StatusFlag  # errors that outlast their cause


class Protection:
    """Timers and latches of one servo's protection; errors are bits of ``StatusFlag``."""

    def __init__(self) -> None:
        # True if only a power cycle clears latched errors; otherwise switching torque off clears them too.
        self.latches = False
        self.forced = 0  # errors forced by a command
        self.status = 0  # present errors
        self.latched = 0  # errors that outlast their cause
        self._overload_s = self._overcurrent_s = 0.0

    def step(
        self, duration_s: float, limits: Thresholds, load_permille: float, current_a: float, heat_c: float, volts: float
    ) -> None:
        """Advance by a time [s] with the measurements at its end, each in the unit of its threshold."""
        detected = 0
        self._overload_s = self._overload_s + duration_s if abs(load_permille) >= limits.load_permille else 0.0
        if self._overload_s > limits.overload_s:
            detected |= StatusFlag.OVERLOAD
        self._overcurrent_s = self._overcurrent_s + duration_s if abs(current_a) > limits.current_a else 0.0
        if self._overcurrent_s > limits.overcurrent_s:
            detected |= StatusFlag.CURRENT
        if not limits.voltage_v[0] <= volts <= limits.voltage_v[1]:
            detected |= StatusFlag.VOLTAGE
        if heat_c > limits.temperature_c:
            detected |= StatusFlag.TEMPERATURE
        if detected:
            self.latched |= detected & limits.latching
        self.status = detected | self.latched | self.forced

    def latch(self, errors: StatusFlag) -> None:
        """Detect errors that outlast their cause."""
        self.latched |= errors

    def torque_off(self) -> None:
        if not self.latches:
            self.power_up()

    def power_up(self) -> None:
        self._overload_s = self._overcurrent_s = 0.0
        self.status &= ~self.latched | self.forced
        self.latched = 0


class EmulatedServo(ABC, Generic[RegisterT]):
    """Servo on the bus."""

    table: RegisterTable[RegisterT]  # registers, among them ID and BAUD_RATE
    memory_bytes: int  # first address beyond the memory
    return_delay: RegisterT  # register of the time before a reply
    torque_limit: RegisterT  # register of the limit of the motor's duty
    full_torque: int  # its value for full duty
    baudrates: Sequence[int]  # bits per second of each value of BAUD_RATE

    servo_id: int  # register ID
    baudrate: int  # bits per second, 0 for a rate that no host has
    return_delay_s: float  # time that it waits before a reply [s]
    duty_permille_per_nm: float  # duty that a torque at the joint calls for [0.1 % per Nm]
    stall_torque_nm: float  # largest torque at the joint [Nm]
    backlash_ticks: float = 0.0  # play of the gear, which physics has
    _drive: Drive
    _thresholds: Thresholds

    def __init__(self, plant: Plant, joint: str, zero_ticks: int) -> None:
        self.plant = plant  # joint that it moves, in encoder ticks
        self.joint = joint  # name of the joint
        self.zero_ticks = zero_ticks  # position of the encoder where the calibration has its tick 0
        self.mirrored = False  # True if the horn is mounted mirrored, which no register shows
        self.connected = True  # False while its cable is unplugged: it has no power, and is not on the wire
        self.motor = Motor()
        self.protection = Protection()
        self.voltage_v = 0.0  # supply [V]
        self.memory = Memory(self.table, self.memory_bytes)
        self.kept_write: tuple[int, bytes] | None = None  # address and bytes of the latest REG_WRITE until an ACTION
        self._measured_at: tuple[float, ...] = ()  # state whose measurements the memory has; empty for none

    @abstractmethod
    def power_up(self) -> None:
        """Start as after a power cut, with torque off."""

    @abstractmethod
    def write(self, address: int, data: bytes) -> int:
        """Write memory as an instruction does; return the number of the error, 0 for none."""

    @property
    @abstractmethod
    def present_ticks(self) -> int:
        """Register PRESENT_POSITION."""

    def acknowledges(self, code: int) -> bool:  # noqa: ARG002 - a servo may be set to answer fewer instructions
        """Return True if it replies to an instruction of this code."""
        return True

    @abstractmethod
    def maintain(self, code: int) -> bool:
        """Carry out an instruction of this family alone; return False if there is no such one."""

    @abstractmethod
    def _measured(self) -> Iterable[tuple[RegisterT, int]]:
        """Return the measured registers and their values."""

    @abstractmethod
    def _thresholds_from_registers(self) -> Thresholds: ...

    @abstractmethod
    def _drive_from_registers(self) -> Drive: ...

    @property
    def error(self) -> int:
        """ERR byte of its replies, without an error of the instruction."""
        return self.protection.status

    @property
    def torque_limit_permille(self) -> int:
        return round(abs(self.value(self.torque_limit)) / self.full_torque * FULL_DUTY_PERMILLE)

    def ping(self) -> bytes:
        return b""

    @property
    def listens(self) -> bool:
        """True while it has power and has started."""
        return self.connected

    def hear(self) -> None:
        """Note an instruction on the bus, for which a watchdog waits."""

    def unplug(self) -> None:
        """Pull its cable: the servo loses its power."""
        self.connected = False
        self.power_up()

    def plug_in(self) -> None:
        """Plug its cable in; a servo that has power already goes on."""
        if not self.connected:
            self.connected = True
            self.power_up()

    def mirror(self) -> None:
        """Mount the horn mirrored, or take that back: the joint stays, and the encoder turns the other way from it."""
        self.mirrored = not self.mirrored
        plant = self.plant
        plant.position_ticks = plant.lower_stop_ticks + plant.upper_stop_ticks - plant.position_ticks
        plant.gravity_permille = -plant.gravity_permille

    @property
    def joint_ticks(self) -> float:
        """Position of the joint in ticks of the calibration."""
        plant = self.plant
        mirror = plant.lower_stop_ticks + plant.upper_stop_ticks
        position = mirror - plant.position_ticks if self.mirrored else plant.position_ticks
        return position - self.zero_ticks

    def value(self, register: RegisterT) -> int:
        """Return the value of a register other than the measured ones."""
        return self.memory.value(register)

    def hold(self, torque_share: float | None = None) -> None:
        """Hold the present position, as an arm process leaves a servo, at a share of full duty; None for its limit."""
        if torque_share is not None:
            self.memory.set(self.torque_limit, round(torque_share * self.full_torque))
        self.memory.set(self.table.goal_position, self.present_ticks)
        self.set(self.table.torque_enable, 1)

    def named(self, name: str) -> int:
        """Return the value of a register by its name, such as TORQUE_ENABLE and GOAL_POSITION of every family."""
        return self.value(type(self.table.torque_enable)[name])

    def set(self, register: RegisterT, value: int) -> None:
        """Set a register other than the measured ones, read-only or not."""
        self.memory.set(register, value)
        self._follow_registers()

    def read(self, address: int, length: int) -> bytes:
        """Read memory; addresses without a register are zero."""
        plant = self.plant
        # At rest the host reads the same values a hundred times a second.
        state = (
            plant.position_ticks,
            plant.velocity_ticks_s,
            plant.duty_permille,
            round(self.motor.temperature_c),
            self.voltage_v,
        )
        if state != self._measured_at:
            self._measured_at = state
            for register, value in self._measured():
                self.memory.set(register, value)
        return self.memory.read(address, length)

    def step(self, duration_s: float) -> None:
        self.plant.step(duration_s, self._drive)
        self.update_protection(duration_s)

    def update_protection(self, duration_s: float = 0.0) -> None:
        current_a, before = self.plant.current_a, self.protection.status
        self.motor.step(duration_s, current_a)
        heat_c, volts = self.motor.temperature_c, self.voltage_v
        self.protection.step(duration_s, self._thresholds, self._load_permille, current_a, heat_c, volts)
        if self.protection.status != before:
            self._follow_status()

    @property
    def _load_permille(self) -> float:
        return self.plant.duty_permille

    def _follow_registers(self) -> None:
        self.servo_id, baud_rate = self.named("ID"), self.named("BAUD_RATE")
        self.baudrate = self.baudrates[baud_rate] if baud_rate < len(self.baudrates) else 0
        self.return_delay_s = self.value(self.return_delay) * RETURN_DELAY_UNIT_US * 1e-6
        self._thresholds = self._thresholds_from_registers()
        self._follow_drive()

    def _follow_write(self, address: int) -> None:
        if address < self.table.torque_enable:
            self._follow_registers()
        else:
            self._follow_drive()

    def _follow_drive(self) -> None:
        """Bring drive and measurements up to date, which depend on every register."""
        self._drive = self._drive_from_registers()
        self._measured_at = ()

    def _follow_status(self) -> None:
        self._follow_registers()

"""Emulated Dynamixel servo: its control table, the plant that it drives, and its protection. Pure: time is passed in.

Access, ranges and error numbers follow the e-manual's control tables of the XL430-W250 and XL330-M288 and its page
DYNAMIXEL Protocol 2.0, as far as they state them. Where they do not, the emulation is the harsher of what could be: the
goal after power-up is 0 at any position, torque on does not move the goal to the position, and a servo whose watchdog
is cleared goes on to its old goal.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

from robot.calibration import TICKS_PER_TURN
from robot.emulator.plant import NO_LOAD_TICKS_S, STALL_CURRENT_A, Drive, Motor, Plant
from robot.hardware.dynamixel.packets import ALERT
from robot.hardware.dynamixel.registers import (
    AMPERE_PER_UNIT,
    FULL_PWM,
    HARDWARE_ERRORS,
    LAYOUT,
    MAX_HOMING_OFFSET_IN_POSITION_MODE,
    MOTION_ADDRESS,
    TICKS_S2_PER_ACCELERATION_UNIT,
    TICKS_S_PER_VELOCITY_UNIT,
    VOLT_PER_UNIT,
    WATCHDOG_TRIPPED,
    WATCHDOG_UNIT_S,
    Area,
    Model,
    OperatingMode,
    Register,
    decode,
    encode,
    value_range,
)
from robot.hardware.interface import StatusFlag

# Error numbers of a status packet.
DATA_RANGE_ERROR = 4
DATA_LENGTH_ERROR = 5
DATA_LIMIT_ERROR = 6
ACCESS_ERROR = 7

# The last documented address is 227, of the XL330; addresses without a register read as 0.
MEMORY_BYTES = 256

FIRMWARE = 52

# The Koch's supplies: 12 V for the XL430, 5 V for the XL330.
SUPPLY_V: Mapping[str, float] = {"xl430-w250": 12.0, "xl330-m288": 5.0}

# Registers of the XL330 alone.
_CURRENT_REGISTERS = frozenset({Register.CURRENT_LIMIT, Register.GOAL_CURRENT})

# "Goal values", which are read-only while the watchdog has stopped the servo.
_GOALS = frozenset({Register.GOAL_PWM, Register.GOAL_CURRENT, Register.GOAL_POSITION})

# Furthest goal of the modes that count turns.
MOST_EXTENDED_TICKS = 1_048_575

# Gain of :class:`robot.emulator.plant.Plant` with which a servo follows with a lag of 20 ms.
STIFFNESS = 32

# An acceleration of 0 is unlimited.
UNLIMITED_TICKS_S2 = 1e7

# Share of the stall current that counts as overload, and the time that it must last; the e-manual states neither.
OVERLOAD_SHARE = 0.95
OVERLOAD_S = 1.0

FULL_PERMILLE = 1000.0
MOVING_TICKS_S = 10 * TICKS_S_PER_VELOCITY_UNIT

# Measured registers: PRESENT_PWM to PRESENT_POSITION, and PRESENT_INPUT_VOLTAGE with PRESENT_TEMPERATURE.
_MOTION = struct.Struct("<hhii")
_CLIMATE = struct.Struct("<HB")

# Reboot: time without an answer.
REBOOT_S = 0.25

_DEFAULTS: Mapping[str, Mapping[Register, int]] = {
    "xl430-w250": {
        Register.TEMPERATURE_LIMIT: 72,
        Register.MAX_VOLTAGE_LIMIT: 140,
        Register.MIN_VOLTAGE_LIMIT: 60,
        Register.VELOCITY_LIMIT: 265,
        Register.SHUTDOWN: 52,
    },
    "xl330-m288": {
        Register.TEMPERATURE_LIMIT: 70,
        Register.MAX_VOLTAGE_LIMIT: 70,
        Register.MIN_VOLTAGE_LIMIT: 35,
        Register.CURRENT_LIMIT: 1750,
        Register.VELOCITY_LIMIT: 445,
        Register.SHUTDOWN: 53,
    },
}


class DynamixelServo:
    """Servo on the bus, from power-up on.

    Args:
        servo_id: register ID.
        model: its model.
        plant: joint that it moves, in ticks of its encoder, which is absolute within one turn.
        position_limits_ticks: registers MIN_POSITION_LIMIT and MAX_POSITION_LIMIT.
        homing_offset_ticks: register HOMING_OFFSET.
        mode: register OPERATING_MODE.

    Attributes:
        plant: as given.
        model: as given.
        motor: temperature of the motor, which may be set.
        voltage_v: supply [V], which may be set.
        servo_id: register ID.
        writes: number of accepted writes.
    """

    def __init__(
        self,
        servo_id: int,
        model: Model,
        plant: Plant,
        position_limits_ticks: tuple[int, int] = (0, TICKS_PER_TURN - 1),
        homing_offset_ticks: int = 0,
        mode: OperatingMode = OperatingMode.EXTENDED_POSITION,
    ) -> None:
        self.servo_id = servo_id
        self.model = model
        self.plant = plant
        self.motor = Motor()
        self.voltage_v = SUPPLY_V[model.name]
        self.writes = 0
        self._values: dict[Register, int] = {
            Register.MODEL_NUMBER: model.number,
            Register.FIRMWARE_VERSION: FIRMWARE,
            Register.ID: servo_id,
            Register.BAUD_RATE: 3,
            Register.OPERATING_MODE: mode,
            Register.HOMING_OFFSET: homing_offset_ticks,
            Register.PWM_LIMIT: FULL_PWM,
            Register.MIN_POSITION_LIMIT: position_limits_ticks[0],
            Register.MAX_POSITION_LIMIT: position_limits_ticks[1],
            **_DEFAULTS[model.name],
        }
        self._memory = bytearray(MEMORY_BYTES)
        for register, value in self._values.items():
            self._store(register, value)
        self.power_up()

    def power_up(self, off_s: float = 0.0) -> None:
        """Start as after a power cut: EEPROM as it was, RAM as after power-up, torque off, the count of turns lost.

        Args:
            off_s: time until it answers again [s].
        """
        for register, layout in LAYOUT.items():
            if layout.area is not Area.EEPROM and register not in (Register.MODEL_NUMBER, Register.FIRMWARE_VERSION):
                self._store(register, 0)
        self._store(Register.STATUS_RETURN_LEVEL, 2)
        self._reset_limits()
        self._off_s = off_s
        self._heard_s = self._overload_s = 0.0
        self._forced = 0
        self._forget_turns()
        self._drive = self._drive_from_registers()

    @property
    def answers(self) -> bool:
        """False while it starts anew."""
        return self._off_s <= 0.0

    @property
    def error(self) -> int:
        """ERR byte of its replies, without an error of the instruction."""
        return ALERT if self.value(Register.HARDWARE_ERROR_STATUS) else 0

    @property
    def present_ticks(self) -> int:
        """Register PRESENT_POSITION."""
        return round(self.plant.position_ticks) - self._turns_ticks + self._offset_ticks

    def value(self, register: Register) -> int:
        """Return the value of a register other than the measured ones."""
        return self._values.get(register, 0)

    def has(self, register: Register) -> bool:
        """Return True for a register of this model."""
        return self.model.has_current or register not in _CURRENT_REGISTERS

    def set(self, register: Register, value: int) -> None:
        """Set a register other than the measured ones, read-only or not."""
        self._store(register, value)
        self._drive = self._drive_from_registers()

    def hold(self, goal_pwm: int | None = None) -> None:
        """Hold the present position, as an arm process leaves a servo.

        Args:
            goal_pwm: register GOAL_PWM; None for its limit.
        """
        self.set(Register.GOAL_POSITION, self.present_ticks)
        if goal_pwm is not None:
            self.set(Register.GOAL_PWM, goal_pwm)
        self.set(Register.TORQUE_ENABLE, 1)

    def fail(self, hardware_error: int) -> None:
        """Detect hardware errors, bits of HARDWARE_ERROR_STATUS, until the next reboot."""
        self._forced |= hardware_error
        self._detect(hardware_error)

    def hear(self) -> None:
        """Note an instruction on the bus, for which the watchdog waits."""
        self._heard_s = 0.0

    def step(self, duration_s: float) -> None:
        """Advance by ``duration_s`` [s]."""
        self._off_s = max(0.0, self._off_s - duration_s)
        self.plant.step(duration_s, self._drive)
        self._heard_s += duration_s
        watchdog = self.value(Register.BUS_WATCHDOG)
        if watchdog > 0 and self.value(Register.TORQUE_ENABLE) and self._heard_s > watchdog * WATCHDOG_UNIT_S:
            self._store(Register.BUS_WATCHDOG, WATCHDOG_TRIPPED)
            self._store(Register.PROFILE_VELOCITY, 0)
            self._store(Register.PROFILE_ACCELERATION, 0)
            self._drive = self._drive_from_registers()
        self._protect(duration_s)

    def read(self, address: int, length: int) -> bytes:
        """Read memory; addresses without a register are zero."""
        self._measure()
        return bytes(self._memory[address : address + length]).ljust(length, b"\0")

    def write(self, address: int, data: bytes) -> int:
        """Write whole registers as an instruction does, or none of them.

        Returns:
            Number of the error, 0 for none.
        """
        wanted: dict[Register, int] = {}
        at = 0
        while at < len(data):
            if address + at not in LAYOUT:
                return ACCESS_ERROR
            register = Register(address + at)
            size = LAYOUT[register].size
            if at + size > len(data):
                return DATA_LENGTH_ERROR
            wanted[register] = decode(register, data[at : at + size])
            at += size
        for register, value in wanted.items():
            if error := self._refusal(register, value):
                return error
        self._take(wanted)
        return 0

    def _take(self, wanted: Mapping[Register, int]) -> None:
        self.writes += 1
        if all(self.value(register) == value for register, value in wanted.items()):
            # Goals are written a hundred times a second, also while the arm rests.
            return
        for register, value in wanted.items():
            self._store(register, value)
        self.servo_id = self.value(Register.ID)
        if Register.OPERATING_MODE in wanted:
            self._reset_limits()
            self._store(Register.PROFILE_VELOCITY, 0)
            self._store(Register.PROFILE_ACCELERATION, 0)
            self._forget_turns()
        self._drive = self._drive_from_registers()

    def _reset_limits(self) -> None:
        """Set the limits of the torque to their greatest values."""
        self._store(Register.GOAL_PWM, self.value(Register.PWM_LIMIT))
        if self.model.has_current:
            self._store(Register.GOAL_CURRENT, self.value(Register.CURRENT_LIMIT))

    def _store(self, register: Register, value: int) -> None:
        self._values[register] = value
        self._memory[register : register + LAYOUT[register].size] = encode(register, value)

    def _refusal(self, register: Register, value: int) -> int:
        """Return the number of the error of a write, 0 for none."""
        layout, on = LAYOUT[register], bool(self.value(Register.TORQUE_ENABLE))
        if layout.area is Area.READ_ONLY or not self.has(register) or (layout.area is Area.EEPROM and on):
            return ACCESS_ERROR
        if self.value(Register.BUS_WATCHDOG) == WATCHDOG_TRIPPED and register in _GOALS:
            return DATA_RANGE_ERROR
        shut_down = self.value(Register.HARDWARE_ERROR_STATUS) & self.value(Register.SHUTDOWN)
        if register is Register.TORQUE_ENABLE and value and shut_down:
            return ACCESS_ERROR
        if register is Register.BUS_WATCHDOG and not 0 <= value <= 127:
            return DATA_RANGE_ERROR
        lowest, highest = self._limits(register)
        return 0 if lowest <= value <= highest else DATA_LIMIT_ERROR

    def _limits(self, register: Register) -> tuple[int, int]:
        if register is Register.GOAL_PWM:
            limit = self.value(Register.PWM_LIMIT)
            return -limit, limit
        if register is Register.GOAL_CURRENT:
            limit = self.value(Register.CURRENT_LIMIT)
            return -limit, limit
        if register is Register.GOAL_POSITION:
            if self.value(Register.OPERATING_MODE) == OperatingMode.POSITION:
                return self.value(Register.MIN_POSITION_LIMIT), self.value(Register.MAX_POSITION_LIMIT)
            return -MOST_EXTENDED_TICKS, MOST_EXTENDED_TICKS
        if register is Register.TORQUE_ENABLE:
            return 0, 1
        return value_range(register)

    @property
    def _offset_ticks(self) -> int:
        """Homing offset that acts: in position mode one beyond its range is ignored."""
        offset = self.value(Register.HOMING_OFFSET)
        in_position_mode = self.value(Register.OPERATING_MODE) == OperatingMode.POSITION
        return 0 if in_position_mode and abs(offset) > MAX_HOMING_OFFSET_IN_POSITION_MODE else offset

    def _forget_turns(self) -> None:
        """Count turns anew: the position is within one turn of the encoder."""
        self._turns_ticks = math.floor(self.plant.position_ticks / TICKS_PER_TURN) * TICKS_PER_TURN

    def _drive_from_registers(self) -> Drive:
        stopped = self.value(Register.BUS_WATCHDOG) == WATCHDOG_TRIPPED
        goal = self.value(Register.GOAL_POSITION) - self._offset_ticks + self._turns_ticks
        share = abs(self.value(Register.GOAL_PWM)) / FULL_PWM
        if self.value(Register.OPERATING_MODE) == OperatingMode.CURRENT_BASED_POSITION:
            share = min(share, abs(self.value(Register.GOAL_CURRENT)) / self.model.stall_current_ma)
        velocity = self.value(Register.PROFILE_VELOCITY) * TICKS_S_PER_VELOCITY_UNIT
        acceleration = self.value(Register.PROFILE_ACCELERATION) * TICKS_S2_PER_ACCELERATION_UNIT
        return Drive(
            goal_ticks=self.plant.position_ticks if stopped else goal,
            velocity_ticks_s=velocity or NO_LOAD_TICKS_S,
            acceleration_ticks_s2=acceleration or UNLIMITED_TICKS_S2,
            torque_permille=share * FULL_PERMILLE if self.value(Register.TORQUE_ENABLE) else 0.0,
            p_gain=STIFFNESS,
        )

    def _protect(self, duration_s: float) -> None:
        self.motor.step(duration_s, self.plant.current_a)
        overloaded = abs(self.plant.current_a) >= OVERLOAD_SHARE * STALL_CURRENT_A
        self._overload_s = self._overload_s + duration_s if overloaded else 0.0
        error = self._forced
        if self._overload_s > OVERLOAD_S:
            error |= _BITS[StatusFlag.OVERLOAD]
        if self.motor.temperature_c > self.value(Register.TEMPERATURE_LIMIT):
            error |= _BITS[StatusFlag.TEMPERATURE]
        lowest, highest = self.value(Register.MIN_VOLTAGE_LIMIT), self.value(Register.MAX_VOLTAGE_LIMIT)
        if not lowest <= round(self.voltage_v / VOLT_PER_UNIT) <= highest:
            error |= _BITS[StatusFlag.VOLTAGE]
        if error:
            self._detect(error)

    def _detect(self, error: int) -> None:
        """Keep hardware errors until a reboot; those of SHUTDOWN switch torque off."""
        self._store(Register.HARDWARE_ERROR_STATUS, self.value(Register.HARDWARE_ERROR_STATUS) | error)
        if error & self.value(Register.SHUTDOWN) and self.value(Register.TORQUE_ENABLE):
            self.set(Register.TORQUE_ENABLE, 0)

    def _measure(self) -> None:
        """Bring the measured registers up to date."""
        plant = self.plant
        self._memory[Register.MOVING] = int(abs(plant.velocity_ticks_s) > MOVING_TICKS_S)
        _MOTION.pack_into(
            self._memory,
            MOTION_ADDRESS,
            round(plant.duty_permille / FULL_PERMILLE * FULL_PWM),
            self._current_or_load(),
            round(plant.velocity_ticks_s / TICKS_S_PER_VELOCITY_UNIT),
            self.present_ticks,
        )
        volts, degrees = round(self.voltage_v / VOLT_PER_UNIT), round(self.motor.temperature_c)
        _CLIMATE.pack_into(self._memory, Register.PRESENT_INPUT_VOLTAGE, volts, degrees)

    def _current_or_load(self) -> int:
        """Return address 126: the XL330's current [mA], the XL430's estimated load [0.1 %]."""
        if not self.model.has_current:
            return round(self.plant.duty_permille)
        stall_a = self.model.stall_current_ma * AMPERE_PER_UNIT
        return round(self.plant.current_a / STALL_CURRENT_A * stall_a / AMPERE_PER_UNIT)


_BITS: Mapping[StatusFlag, int] = {flag: bit for bit, flag in HARDWARE_ERRORS.items()}

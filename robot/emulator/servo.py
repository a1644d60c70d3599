"""One STS3215 servo: its registers, the plant that they drive, and the protection that comes between."""

from __future__ import annotations

from robot.emulator.heat import Motor
from robot.emulator.memory import FACTORY_EPROM, Memory
from robot.emulator.plant import NO_LOAD_TICKS_S, Drive, Plant
from robot.emulator.protection import Measured, Protection, Thresholds
from robot.hardware.feetech.registers import (
    AMPERE_PER_UNIT,
    TICKS_S2_PER_ACCELERATION_UNIT,
    VOLT_PER_UNIT,
    Register,
    value_range,
)
from robot.hardware.interface import StatusFlag

# The SO-101's usual supply [V].
SUPPLY_V = 5.0

# Acceleration 0 means the most the servo has; lerobot writes this to its limit register.
MAX_ACCELERATION = 254

# A joint slower than this stands still as far as register MOVING is concerned.
STANDSTILL_TICKS_S = 3.0

# TORQUE_ENABLE with this value makes the present position the middle, and drives nothing.
TORQUE_ENABLE_MAKES_MIDDLE = 128
MIDDLE_TICKS = 2048

# Heat and protection change slowly: they are looked after once in a while, of a joint at rest less often.
UPKEEP_S = 0.01
RESTING_UPKEEP_S = 0.04

PERMILLE_PER_PERCENT = 10
PROTECTION_TIME_UNIT_S = 0.01


class Servo:
    """A servo on the bus, from power-up on.

    Args:
        servo_id: its id.
        plant: the joint that it moves, in encoder ticks.
        angle_limits_ticks: registers MIN_ANGLE_LIMIT and MAX_ANGLE_LIMIT, in ticks of PRESENT_POSITION.
        homing_offset_ticks: register HOMING_OFFSET.

    Attributes:
        powers_up_holding: whether the next power-up leaves torque on, at the position where it is.
        motor: its temperature, which may be set.
        protection: its complaints; some may be forced on it.
        voltage_v: its supply [V], which may be set.
        changes: count of the writes that changed a register.
        servo_id: the id it answers to.
        baudrate_code: register BAUD_RATE.
    """

    def __init__(
        self, servo_id: int, plant: Plant, angle_limits_ticks: tuple[int, int], homing_offset_ticks: int = 0
    ) -> None:
        self.plant = plant
        self.motor = Motor()
        self.protection = Protection()
        self.voltage_v = SUPPLY_V
        self.powers_up_holding = False
        arm = {
            Register.ID: servo_id,
            Register.MIN_ANGLE_LIMIT: angle_limits_ticks[0],
            Register.MAX_ANGLE_LIMIT: angle_limits_ticks[1],
            Register.HOMING_OFFSET: homing_offset_ticks,
        }
        self._memory = Memory({**FACTORY_EPROM, **arm})
        self._unkept_s = 0.0
        self.changes = 0
        self._shown: tuple[object, ...] | None = None
        self.power_up()

    def power_up(self, *, holding: bool = False) -> None:
        """Start as after a power cut: EPROM as last stored, torque off.

        The goal is 0, wherever the arm is: who switches torque on without setting it sees the arm jump. Only a servo
        that powers up holding has the goal where it is.

        Args:
            holding: whether it does so this time, whatever :attr:`powers_up_holding` says.
        """
        self._memory.power_up()
        self._kept: tuple[int, bytes] | None = None
        self.protection.power_up()
        if holding or self.powers_up_holding:
            self._memory.show(Register.GOAL_POSITION, self.present_ticks)
            self._memory.set(Register.TORQUE_ENABLE, 1)
        self._follow_registers()

    @property
    def visible(self) -> tuple[object, ...]:
        """All that its measured registers depend on; the same as before means that they read the same."""
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
        """The ERR byte of its replies."""
        return int(self.protection.status)

    @property
    def present_ticks(self) -> int:
        """Register PRESENT_POSITION: the encoder less the homing offset."""
        return round(self.plant.position_ticks) - self.value(Register.HOMING_OFFSET)

    def value(self, register: Register) -> int:
        """Value of a register other than the measured ones."""
        return self._memory.value(register)

    def step(self, duration_s: float) -> None:
        """Let time pass [s]."""
        self.plant.step(duration_s, self._drive)
        self._unkept_s += duration_s
        if self._unkept_s >= (RESTING_UPKEEP_S if self.plant.at_rest else UPKEEP_S):
            self.keep_up()

    def read(self, address: int, length: int) -> bytes:
        """Read memory; what lies beyond it is zero."""
        self._measure()
        return self._memory.read(address, length)

    def write(self, address: int, data: bytes) -> None:
        """Write memory as an instruction does; see :meth:`robot.emulator.memory.Memory.write`."""
        torque = self.value(Register.TORQUE_ENABLE)
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
        """Keep a write until :meth:`take_kept_write`; only the last one is kept."""
        self._kept = (address, data)

    def take_kept_write(self) -> tuple[int, bytes] | None:
        """Carry out the write that was kept and return it; None if there is none."""
        kept, self._kept = self._kept, None
        if kept is not None:
            self.write(*kept)
        return kept

    def make_middle(self) -> None:
        """Choose the homing offset, for good, so that the present position reads 2048, or as near as it reaches."""
        lowest, highest = value_range(Register.HOMING_OFFSET)
        offset = round(self.plant.position_ticks) - MIDDLE_TICKS
        self._memory.set(Register.HOMING_OFFSET, max(lowest, min(highest, offset)))
        self._memory.store()
        self._follow_registers()

    def back_up(self) -> None:
        """Keep the EPROM for :meth:`restore`."""
        self._memory.back_up()

    def restore(self) -> None:
        """Bring back the EPROM last backed up, or the first; the id stays."""
        self._memory.restore()
        self._follow_registers()

    def keep_up(self) -> None:
        """Let motor and protection follow what happened, now."""
        plant, duration_s, self._unkept_s = self.plant, self._unkept_s, 0.0
        self.motor.step(duration_s, plant.current_a)
        measured = Measured(plant.duty_permille, plant.current_a, self.motor.temperature_c, self.voltage_v)
        before = self.protection.status
        self.protection.step(duration_s, measured, self._thresholds)
        if self.protection.status != before:
            self._drive = self._drive_from_registers()

    def _measure(self) -> None:
        """Bring the read-only registers up to date; those of an arm at rest are."""
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
        memory.show(Register.GOAL_POSITION_ECHO, round(drive.goal_ticks) - self.value(Register.HOMING_OFFSET))
        memory.show(Register.PRESENT_CURRENT, round(plant.current_a / AMPERE_PER_UNIT))

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
        acceleration = self.value(Register.ACCELERATION) or MAX_ACCELERATION
        torque_on = self.value(Register.TORQUE_ENABLE) == 1
        torque_left = min(self.value(Register.TORQUE_LIMIT), self.protection.duty_left_permille(self._thresholds))
        return Drive(
            goal_ticks=goal + self.value(Register.HOMING_OFFSET),
            velocity_ticks_s=abs(self.value(Register.GOAL_VELOCITY)) or NO_LOAD_TICKS_S,
            acceleration_ticks_s2=acceleration * TICKS_S2_PER_ACCELERATION_UNIT,
            torque_permille=torque_left if torque_on else 0,
            p_gain=self.value(Register.P_GAIN),
        )

"""What must not go on: looks at every reading, and says which fault it means.

Independent of everything that commands the arm. Pure: readings and time come in, a fault or none comes out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robot.calibration import RAD_PER_TICK
from robot.faults import Fault, FaultCode
from robot.servos.registers import StatusBit, status_names
from robot.servos.telemetry import FREE_SPEED_RAD_S, JUMP_RAD, Measured
from robot.trajectory import Vector

Flags = NDArray[np.bool_]

TRACKING_ERROR_RAD = 0.35
TRACKING_TIME_S = 0.2

# A joint that pushes without moving is stalled, well before the servo's own overload timer of 2 s runs out. Far
# behind its goal, near its torque limit or drawing 60 % of the stall current, and all but standing still.
STALL_ERROR_RAD = 60 * RAD_PER_TICK
STALL_SPEED_RAD_S = 30 * RAD_PER_TICK
STALL_LOAD_SHARE = 0.8
STALL_CURRENT_A = 1.5
STALL_TIME_S = 0.3

# Ten missed cycles. The servos still follow their last goals meanwhile.
STALE_AFTER_S = 0.1

# The servo's electronics reset not far below; it lasts longer than the dip of a motor starting.
MIN_VOLTAGE_V = 4.5
LOW_VOLTAGE_TIME_S = 0.2
VOLTAGE_BIT_TIME_S = 2.0

# What register MAX_VOLTAGE holds in a new 7.4 V servo.
DEFAULT_MAX_VOLTAGE_V = 8.0

_STATUS_FAULTS = (
    (StatusBit.TEMPERATURE, FaultCode.OVERHEATED),
    (StatusBit.OVERLOAD, FaultCode.OVERLOAD),
    (StatusBit.CURRENT, FaultCode.OVERCURRENT),
    (StatusBit.ENCODER, FaultCode.ENCODER_ERROR),
)


@dataclass(frozen=True)
class Temperatures:
    """Steps of heat, each of them the lowest temperature that counts [degC]."""

    warn_c: float = 55.0
    slow_c: float = 60.0
    stop_c: float = 65.0


class Persistence:
    """How long a condition of each joint has held without a break."""

    def __init__(self, joints: int) -> None:
        self._never = np.full(joints, np.inf)
        self._since_s = self._never

    def lasting(self, condition: Flags, now_s: float) -> Vector:
        """Note the condition; returns how long it has held, -inf where it does not hold [s]."""
        if not condition.any():
            self._since_s = self._never
            return -self._never
        self._since_s = np.where(condition, np.minimum(self._since_s, now_s), np.inf)
        return np.asarray(now_s - self._since_s)


class Guards:
    """The guards of one arm.

    Args:
        joint_names: order of every array.
        temperatures: when heat is a fault.
        max_voltage_v: what each servo's register MAX_VOLTAGE holds, shape (joints,) [V].
    """

    def __init__(
        self,
        joint_names: tuple[str, ...],
        temperatures: Temperatures | None = None,
        max_voltage_v: Vector | None = None,
    ) -> None:
        self._names = joint_names
        self._temperatures = temperatures or Temperatures()
        joints = len(joint_names)
        self._max_voltage_v = np.full(joints, DEFAULT_MAX_VOLTAGE_V) if max_voltage_v is None else max_voltage_v
        self._none: Flags = np.zeros(joints, dtype=bool)
        self._last_position_rad: Vector | None = None
        self._last_read_s: Vector = np.zeros(joints)
        self.restart()

    def restart(self) -> None:
        """Forget for how long anything has lasted."""
        joints = len(self._names)
        self._behind, self._pushing = Persistence(joints), Persistence(joints)
        self._low, self._complaining = Persistence(joints), Persistence(joints)
        self.stalled = self._none
        self.lost = self._none

    def check(
        self, goal_rad: Vector, measured: Measured, torque_limit: Vector, now_s: float, yielding: Flags | None = None
    ) -> Fault | None:
        """Look at one tick's readings.

        Sets ``stalled`` and ``lost``, the joints that push in vain and those too far behind.

        Args:
            goal_rad: what the servos were told, shape (joints,) [rad].
            measured: what they are doing.
            torque_limit: the share of full duty that they may use, shape (joints,).
            now_s: monotonic time [s].
            yielding: joints for which a stall is no fault, shape (joints,).

        Returns:
            The gravest fault, or None.
        """
        error = np.abs(measured.position_rad - goal_rad)
        self.stalled = self._stalling(error, measured, torque_limit, now_s)
        self.lost = self._behind.lasting(error > TRACKING_ERROR_RAD, now_s) >= TRACKING_TIME_S
        resisting = self._none if yielding is None else yielding
        complaints = _STATUS_FAULTS if measured.status.any() else ()
        findings = (
            *((measured.status & bit != 0, code) for bit, code in complaints),
            (measured.temperature_c >= self._temperatures.stop_c, FaultCode.OVERHEATED),
            (self._jumped(measured, now_s), FaultCode.POSITION_JUMP),
            (measured.age_s > STALE_AFTER_S, FaultCode.SERVO_SILENT),
            (self._badly_supplied(measured, now_s), FaultCode.VOLTAGE_LOW),
            (self.stalled & ~resisting, FaultCode.STALLED),
            (self.lost & ~resisting, FaultCode.TRACKING_LOST),
        )
        for flags, code in findings:
            if flags.any():
                return self._fault(code, int(np.argmax(np.where(flags, error + 1.0, 0.0))), error, measured)
        return None

    def warnings(self, measured: Measured, joint: int) -> tuple[str, ...]:
        """What to look after at one joint, short of a fault, a sentence each."""
        said = []
        if measured.temperature_c[joint] >= self._temperatures.slow_c:
            said.append(f"motions run at half speed at {measured.temperature_c[joint]:.0f} degC")
        elif measured.temperature_c[joint] >= self._temperatures.warn_c:
            said.append(f"warm: {measured.temperature_c[joint]:.0f} degC")
        if names := status_names(int(measured.status[joint])):
            said.append(f"the servo complains of {', '.join(names)}")
        if measured.age_s[joint] > STALE_AFTER_S:
            said.append(f"no answer for {measured.age_s[joint]:.1f} s")
        return tuple(said)

    def _stalling(self, error: Vector, measured: Measured, torque_limit: Vector, now_s: float) -> Flags:
        far = error > STALL_ERROR_RAD
        if not far.any():
            return self._pushing.lasting(far, now_s) > 0.0
        loaded = np.abs(measured.load) > STALL_LOAD_SHARE * torque_limit
        pushing = loaded | (np.abs(measured.current_a) > STALL_CURRENT_A)
        standing = np.abs(measured.velocity_rad_s) < STALL_SPEED_RAD_S
        lasting_s = self._pushing.lasting(far & pushing & standing, now_s)
        return np.asarray(lasting_s >= STALL_TIME_S)

    def _badly_supplied(self, measured: Measured, now_s: float) -> Flags:
        low, complaining = measured.voltage_v < MIN_VOLTAGE_V, measured.status & StatusBit.VOLTAGE != 0
        low_s, complaining_s = self._low.lasting(low, now_s), self._complaining.lasting(complaining, now_s)
        return np.asarray((low_s >= LOW_VOLTAGE_TIME_S) | (complaining_s >= VOLTAGE_BIT_TIME_S))

    def _jumped(self, measured: Measured, now_s: float) -> Flags:
        """Joints that cannot have turned from their last reading to this one in the time between."""
        read_s = now_s - measured.age_s
        last_rad, gap_s = self._last_position_rad, np.maximum(read_s - self._last_read_s, 0.0)
        self._last_position_rad, self._last_read_s = measured.position_rad, read_s
        if last_rad is None:
            return self._none
        return np.asarray(np.abs(measured.position_rad - last_rad) > JUMP_RAD + FREE_SPEED_RAD_S * gap_s)

    def _fault(self, code: FaultCode, joint: int, error: Vector, measured: Measured) -> Fault:
        name, volts = self._names[joint], measured.voltage_v[joint]
        if code is FaultCode.VOLTAGE_LOW and volts > self._max_voltage_v[joint]:
            code = FaultCode.VOLTAGE_HIGH
        says = {
            FaultCode.OVERHEATED: f"is at {measured.temperature_c[joint]:.0f} degC",
            FaultCode.OVERLOAD: "is overloaded, and its servo has cut its torque",
            FaultCode.OVERCURRENT: f"draws too much current, {measured.current_a[joint]:.1f} A at last",
            FaultCode.ENCODER_ERROR: "has a servo that complains of its encoder",
            FaultCode.POSITION_JUMP: "seems to have jumped: its encoder or horn has slipped",
            FaultCode.SERVO_SILENT: f"has a servo that has not answered for {measured.age_s[joint]:.2f} s",
            FaultCode.VOLTAGE_LOW: f"has {volts:.1f} V; it needs {MIN_VOLTAGE_V} V at least",
            FaultCode.VOLTAGE_HIGH: f"has {volts:.1f} V, above the {self._max_voltage_v[joint]:.1f} V of its servo",
            FaultCode.STALLED: f"pushes in vain, {error[joint]:.2f} rad short of its goal",
            FaultCode.TRACKING_LOST: f"is {error[joint]:.2f} rad behind its goal: blocked, or too weak for the load",
        }
        return Fault(code, f"joint {name} {says[code]}", name, measured.stamp_s)

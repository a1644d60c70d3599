"""Guards: check every reading for faults, independently of the commands to the arm. Pure: time is passed in."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from operator import and_
from typing import Self

import numpy as np

from robot.faults import Fault, FaultCode, ServoAlert, ServoWarning
from robot.hardware.interface import Actuation, Flags, Measured, StatusFlag, status_names
from robot.messages import GuardLimits
from robot.trajectory import Vector

# A joint is stalled when it is far behind its goal (5 deg), near its torque limit or drawing much current, and all but
# standing still (3 deg/s).
STALL_ERROR_RAD = 0.092
STALL_SPEED_RAD_S = 0.046
STALL_LOAD_SHARE = 0.8

ALL_SILENT_AFTER_S = 0.03  # three missed cycles: when every reading is older, the bus is silent, not one servo

# Longer than the voltage dip of a starting motor.
LOW_VOLTAGE_TIME_S = 0.2
VOLTAGE_BIT_TIME_S = 2.0

# Of the distance at which a joint counts as being at its goal, 0.06 rad, a third is backlash (0.9 to 1.0 deg were
# measured); the rest is droop under load (1.8 to 2.6 deg), in inverse proportion to the gain.
DROOP_SHARE = 2.0 / 3.0
LARGEST_TOLERANCE_RAD = 0.3  # the most that goal_tolerance_rad may be set to

# Share of a protection's threshold that is used: the load is measured in steps of 0.1 %, and ripples.
MARGIN = 0.8

# A joint that is loaded beyond its protection's threshold is relieved after this share of the protection's time.
RELIEF_SHARE = 0.5

STALL_SHARE = 0.25  # a stall is reported well before the protection of the servo latches

_STATUS_FAULTS = (
    (StatusFlag.TEMPERATURE, FaultCode.OVERHEATED),
    (StatusFlag.OVERLOAD, FaultCode.OVERLOAD),
    (StatusFlag.CURRENT, FaultCode.OVERCURRENT),
    (StatusFlag.ENCODER, FaultCode.ENCODER_ERROR),
)

_VOLTAGE_BIT = int(StatusFlag.VOLTAGE)  # plain: an operation on a flag is slow

_SENTENCES = {
    FaultCode.OVERHEATED: "joint {name} is at {temperature_c:.0f} degC",
    FaultCode.OVERLOAD: "joint {name} is overloaded, and its servo has cut its torque",
    FaultCode.OVERCURRENT: "joint {name} draws too much current, {current_a:.1f} A at last",
    FaultCode.ENCODER_ERROR: "joint {name} has a servo that complains of its encoder",
    FaultCode.POSITION_JUMP: "joint {name} seems to have jumped: its encoder or horn has slipped",
    FaultCode.SERVO_SILENT: "joint {name} has a servo that has not answered for {age_s:.2f} s",
    FaultCode.BUS_SILENT: "no servo has answered for {age_s:.2f} s",
    FaultCode.VOLTAGE_LOW: "joint {name} has {volts:.1f} V; it needs {least_volts:g} V at least",
    FaultCode.VOLTAGE_HIGH: "joint {name} has {volts:.1f} V, above the {most_volts:.1f} V of its servo",
    FaultCode.STALLED: "joint {name} is stalled, {error_rad:.2f} rad short of its goal",
    FaultCode.TRACKING_LOST: "joint {name} is {error_rad:.2f} rad behind its goal: blocked, or too weak for the load",
}


@dataclass(frozen=True)
class ActuatorThresholds:
    """Thresholds of the joints, each of shape (joints,), which follow from the strength to which an actuator is set.

    A servo with half the position gain droops twice as far, and a servo that protects itself from 25 % of its torque on
    must not be asked to hold with more. The settings of the program hold for servos as the factory leaves them.
    """

    goal_tolerance_rad: Vector  # greatest distance of a settled joint from its goal [rad]
    sustained_torque: Vector  # share of full duty that a joint may use for ever
    # Time above it after which a joint is limited to it; infinite where that is never needed [s].
    relieve_after_s: Vector
    stall_current_a: Vector  # current above which a joint that all but stands still is stalled [A]
    stall_time_s: Vector  # time for which that must last [s]
    free_speed_rad_s: Vector  # greatest speed of the joint [rad/s]
    jump_rad: Vector  # way beyond which two readings in a row are no motion [rad]

    @classmethod
    def of(cls, limits: GuardLimits, actuation: Actuation, full_torque: Vector) -> Self:
        """Adapt the program's limits to the actuators."""
        # A higher gain than the factory's does not make the gears stiffer.
        softness = 1.0 / np.clip(actuation.stiffness, 1e-2, 1.0)
        tolerance = limits.goal_tolerance_rad * (1.0 + DROOP_SHARE * (softness - 1.0))
        threshold = np.minimum(actuation.overload_torque, actuation.overload_current_a / actuation.stall_current_a)
        harmless = threshold >= full_torque
        return cls(
            goal_tolerance_rad=np.minimum(tolerance, LARGEST_TOLERANCE_RAD),
            sustained_torque=np.where(harmless, full_torque, MARGIN * threshold),
            relieve_after_s=np.where(harmless, np.inf, RELIEF_SHARE * actuation.overload_time_s),
            stall_current_a=np.minimum(limits.stall_current_a, MARGIN * actuation.overload_current_a),
            stall_time_s=np.minimum(limits.stall_time_s, STALL_SHARE * actuation.overload_time_s),
            free_speed_rad_s=actuation.free_speed_rad_s,
            jump_rad=actuation.jump_rad,
        )


class Persistence:
    """Timer of a condition for each joint."""

    def __init__(self, joints: int) -> None:
        self._never = [math.inf] * joints
        self._not_at_all = [-math.inf] * joints
        self._since_s = self._never

    def lasting(self, condition: Sequence[bool], now_s: float) -> list[float]:
        """Update the condition of each joint; return for how long it has held, -inf where it does not [s]."""
        if True not in condition:
            self._since_s = self._never
            return self._not_at_all
        each = zip(self._since_s, condition, strict=True)
        self._since_s = [min(since_s, now_s) if holds else math.inf for since_s, holds in each]
        return [now_s - since_s for since_s in self._since_s]

    def restart(self, joints: Collection[int]) -> None:
        self._since_s = [math.inf if joint in joints else since_s for joint, since_s in enumerate(self._since_s)]


class Guards:
    """Guards of one arm; the highest supply of a servo is infinite without such a limit, shape (joints,) [V].

    They reckon with plain numbers: for six joints an operation on arrays costs more than all of the arithmetic.
    """

    def __init__(
        self, joint_names: tuple[str, ...], max_voltage_v: Vector, limits: GuardLimits, thresholds: ActuatorThresholds
    ) -> None:
        self._names = joint_names
        self.limits = limits
        self.thresholds = thresholds
        self._stall_time_s: list[float] = thresholds.stall_time_s.tolist()
        self._jump_rad: list[float] = thresholds.jump_rad.tolist()
        # No joint nearer to its goal can be stalled or lost.
        self._near_goal_rad = min(STALL_ERROR_RAD, limits.tracking_error_rad)
        self._max_voltage_v = max_voltage_v
        self._last: tuple[Measured, float] | None = None
        self.restart()

    def restart(self) -> None:
        joints = len(self._names)
        self._behind, self._pushing = Persistence(joints), Persistence(joints)
        self._low, self._flagged = Persistence(joints), Persistence(joints)
        self.stalled = [False] * joints  # of each joint: it pushes without moving
        self.lost = [False] * joints  # of each joint: it is too far behind its goal
        self._idle = True  # no timer runs

    def forgive(self, joints: Collection[int]) -> None:
        """Restart the timers of joints that push or are behind their goals, by index: their goals come back to them."""
        for timer in (self._behind, self._pushing):
            timer.restart(joints)

    def check(
        self, goal_rad: Vector, measured: Measured, torque_limit: Vector, now_s: float, yielding: Flags | None = None
    ) -> Fault | None:
        """Check one tick's readings; return the gravest fault, or None. A stall of yielding joints is no fault."""
        last, self._last = self._last, (measured, now_s)
        positions = zip(measured.position_rad.tolist(), goal_rad.tolist(), strict=True)
        errors = [abs(at - goal) for at, goal in positions]
        if last is not None and self._sound(errors, measured, last[0]):
            if not self._idle:
                self.restart()
            return None
        self._idle = False
        self.stalled = self._stalling(errors, measured, torque_limit, now_s)
        behind_s = self._behind.lasting([error > self.limits.tracking_error_rad for error in errors], now_s)
        self.lost = [lasting_s >= self.limits.tracking_time_s for lasting_s in behind_s]
        firm = [True] * len(errors) if yielding is None else (~yielding).tolist()
        status, stop_c = measured.status.tolist(), self.limits.stop_temperature_c
        findings = (
            *(([bool(word & bit) for word in status], code) for bit, code in (_STATUS_FAULTS if any(status) else ())),
            ([degrees >= stop_c for degrees in measured.temperature_c.tolist()], FaultCode.OVERHEATED),
            ([] if last is None else self._jumped(measured, now_s, *last), FaultCode.POSITION_JUMP),
            ([age_s > self.limits.silent_after_s for age_s in measured.age_s.tolist()], FaultCode.SERVO_SILENT),
            (self._badly_supplied(measured.voltage_v.tolist(), status, now_s), FaultCode.VOLTAGE_LOW),
            (list(map(and_, self.stalled, firm)), FaultCode.STALLED),
            (list(map(and_, self.lost, firm)), FaultCode.TRACKING_LOST),
        )
        for flags, code in findings:
            if any(flags):
                return self._fault(code, flags, errors, measured)
        return None

    def warnings(self, measured: Measured, joint: int) -> tuple[ServoWarning, ...]:
        warnings = []
        temperature_c, age_s = measured.temperature_c[joint], measured.age_s[joint]
        if temperature_c >= self.limits.slow_temperature_c:
            warnings.append(ServoWarning(ServoAlert.SLOWED, f"motions run at half speed at {temperature_c:.0f} degC"))
        elif temperature_c >= self.limits.warn_temperature_c:
            warnings.append(ServoWarning(ServoAlert.WARM, f"warm: {temperature_c:.0f} degC"))
        flags = status_names(int(measured.status[joint]))
        warnings += [ServoWarning(ServoAlert(name), f"the servo complains of {name}") for name in flags]
        if age_s > self.limits.silent_after_s:
            warnings.append(ServoWarning(ServoAlert.NO_ANSWER, f"no answer for {age_s:.1f} s"))
        return tuple(warnings)

    def _sound(self, errors: Sequence[float], measured: Measured, before: Measured) -> bool:
        """Return True where nothing is a fault, now or if it lasts: so in nearly every tick, in a third of the time."""
        limits = self.limits
        ways = zip(measured.position_rad.tolist(), before.position_rad.tolist(), self._jump_rad, strict=True)
        return (
            all(error <= self._near_goal_rad for error in errors)
            and all(abs(at - was) <= jump_rad for at, was, jump_rad in ways)
            and not any(measured.status.tolist())
            and not any(degrees >= limits.stop_temperature_c for degrees in measured.temperature_c.tolist())
            and not any(volts < limits.min_voltage_v for volts in measured.voltage_v.tolist())
            and not any(age_s > limits.silent_after_s for age_s in measured.age_s.tolist())
        )

    def _jumped(self, measured: Measured, now_s: float, before: Measured, before_s: float) -> list[bool]:
        ways = zip(measured.position_rad.tolist(), before.position_rad.tolist(), self._jump_rad, strict=True)
        further_rad = [abs(at - was) - jump_rad for at, was, jump_rad in ways]
        if max(further_rad) <= 0.0:
            return []
        gaps_s = now_s - measured.age_s - (before_s - before.age_s)
        return [bool(jumped) for jumped in np.array(further_rad) > self.thresholds.free_speed_rad_s * gaps_s]

    def _stalling(self, errors: Sequence[float], measured: Measured, torque_limit: Vector, now_s: float) -> list[bool]:
        stalling = [error > STALL_ERROR_RAD for error in errors]
        if True in stalling:
            loaded = np.abs(measured.load) > STALL_LOAD_SHARE * torque_limit
            pushing = loaded | (np.abs(measured.current_a) > self.thresholds.stall_current_a)
            standing = np.abs(measured.velocity_rad_s) < STALL_SPEED_RAD_S
            stalling = (np.array(stalling) & pushing & standing).tolist()
        each = zip(self._pushing.lasting(stalling, now_s), self._stall_time_s, strict=True)
        return [lasting_s >= time_s for lasting_s, time_s in each]

    def _badly_supplied(self, volts: Sequence[float], status: Sequence[int], now_s: float) -> list[bool]:
        low_s = self._low.lasting([each_v < self.limits.min_voltage_v for each_v in volts], now_s)
        flagged_s = self._flagged.lasting([word & _VOLTAGE_BIT != 0 for word in status], now_s)
        each = zip(low_s, flagged_s, strict=True)
        return [low >= LOW_VOLTAGE_TIME_S or flagged >= VOLTAGE_BIT_TIME_S for low, flagged in each]

    def _fault(self, code: FaultCode, flags: Sequence[bool], errors: Sequence[float], measured: Measured) -> Fault:
        joint = max((joint for joint, flag in enumerate(flags) if flag), key=errors.__getitem__)
        if code is FaultCode.SERVO_SILENT and measured.age_s.min() > ALL_SILENT_AFTER_S:
            code = FaultCode.BUS_SILENT
        volts, most_volts = measured.voltage_v[joint], self._max_voltage_v[joint]
        if code is FaultCode.VOLTAGE_LOW and volts > most_volts:
            code = FaultCode.VOLTAGE_HIGH
        sentence = _SENTENCES[code].format(
            name=self._names[joint],
            error_rad=errors[joint],
            temperature_c=measured.temperature_c[joint],
            current_a=measured.current_a[joint],
            age_s=measured.age_s.min() if code is FaultCode.BUS_SILENT else measured.age_s[joint],
            volts=volts,
            most_volts=most_volts,
            least_volts=self.limits.min_voltage_v,
        )
        return Fault(code, sentence, "" if code is FaultCode.BUS_SILENT else self._names[joint], measured.stamp_s)

"""Family of servos as the driver sees it: a table of registers, the bus that carries its packets, and a few methods.

A new family is one module with its table, its bus (:class:`robot.hardware.servos.bus.ServoBus`) and its subclass of
:class:`ServoFamily`; the default of a method is right for a servo without that feature.

A :class:`ServoMap` converts between joints and servos. A servo that counts turns forgets them when it loses its supply:
its position may differ from the calibrated one by whole turns. No joint turns further than half a turn from the middle
of its calibrated range, so the turns are those that bring a position nearest to that middle.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from robot.calibration import TICKS_PER_TURN, Calibration, JointCalibration
from robot.description.limits import FASTEST_TICKS_S, JointBounds
from robot.errors import OrderRefused
from robot.faults import ServoWarning
from robot.hardware.interface import CALIBRATION_NOT_KEPT, Actuation, StatusFlag, Steps
from robot.hardware.servos.bus import ServoBus, StatusFrame
from robot.hardware.servos.registers import Block, RegisterEnum, RegisterTable, Telemetry
from robot.messages import GuardLimits
from robot.trajectory import Vector

Values: TypeAlias = Mapping[Any, int]
"""Values of registers."""


class Limit(NamedTuple):
    """Register that limits a servo's torque, and its value."""

    register: RegisterEnum
    value: int


class Watchdog(NamedTuple):
    """Watchdog with which a servo stops where it is when the bus falls silent."""

    register: RegisterEnum  # its register; 0 disarms it
    armed: int  # value that arms it
    tripped: int  # value that it has after it has stopped the servo
    silence_s: float  # time without an instruction that trips it [s]


@dataclass(frozen=True)
class ServoFound:
    """Servo as surveyed."""

    model: int  # register MODEL_NUMBER
    values: Values  # values of the registers that the survey reads
    turns_ticks: int = 0  # whole turns to add to its positions for the calibrated ones
    warnings: tuple[ServoWarning, ...] = ()
    expected: Values = field(default_factory=dict)  # values that registers should have which have another


@dataclass(frozen=True)
class Difference:
    """Register of a servo that differs from the calibration."""

    joint: str
    servo_id: int
    register: RegisterEnum
    calibrated: int
    in_servo: int


def label(joint: JointCalibration) -> str:
    """Return a joint and the id of its servo for people."""
    return f"{joint.joint} (id {joint.servo_id})"


class ServoFamily(ABC):
    """Family of an arm's servos."""

    bus: ClassVar[type[ServoBus]]  # kind of its bus
    registers: ClassVar[RegisterTable[Any]]  # its registers
    motion: ClassVar[Block[Any]]  # block of measurements that is read at every tick
    telemetry: ClassVar[Block[Any]]  # block of all measurements, with supply and temperature
    read_back: ClassVar[tuple[Block[Any], ...]]  # blocks that are compared with what was written, in turn
    goal_address: ClassVar[int]  # address of the block that ends with the goal's data (:meth:`around_goal`)
    goal_within_ticks: ClassVar[int] = 0  # largest difference between a goal that was written and the one read back
    counts_turns: ClassVar[bool] = False  # True for servos that count turns until they lose their supply
    jump_rad: ClassVar[float] = 0.46  # way that no servo makes in a cycle of 10 ms (46 rad/s) [rad]
    watchdog: ClassVar[Watchdog | None] = None  # watchdog of its servos; None without one
    error_register: ClassVar[RegisterEnum | None] = None  # register with the error that a reply announces
    latched_status: ClassVar[StatusFlag] = StatusFlag.OVERLOAD  # status flags that last until :meth:`clear_error`
    torque_on_clears_errors: ClassVar[bool] = False  # True for servos that must be driven again to be free of an error
    assumes_no_offsets: ClassVar[bool] = False  # True if a calibration without homing offsets means offsets of 0
    none_answers_advice: ClassVar[str] = ": is the arm powered?"  # likely cause when no servo answers
    # What to do with an arm without calibration, and with one whose servos have another calibration.
    calibrate_advice: ClassVar[str] = "name a calibration (arm.calibration, --calibration NAME)"
    recalibrate_advice: ClassVar[str] = "Write the calibration to the servos, or calibrate the arm again"

    # Survey.

    @abstractmethod
    def check_model(self, joint: JointCalibration, model: int) -> None:
        """Raise StartupError for a servo whose model cannot be driven."""

    @abstractmethod
    def survey_blocks(self, joint: JointCalibration) -> Sequence[Block[Any]]:
        """Return the blocks of a survey, with TORQUE_ENABLE, GOAL_POSITION, HOMING_OFFSET and a turn's position."""

    @abstractmethod
    def check_settings(self, joint: JointCalibration, values: Values) -> None:
        """Raise StartupError for a servo whose settings make its positions uncertain."""

    def compare(self, joints: Sequence[JointCalibration], found: Mapping[int, ServoFound]) -> dict[int, ServoFound]:
        """Return the servos of an arm, by id, with warnings about their settings."""
        return dict(found)

    @abstractmethod
    def position_limits_ticks(self, values: Values) -> tuple[int, int]:
        """Return the lowest and highest position that a servo's settings allow [ticks]."""

    def goal_limits_ticks(self, values: Values, certain_ticks: tuple[int, int]) -> tuple[int, int]:
        """Return the lowest and highest goal that a servo takes, where its turns are certain [ticks]."""
        return self.position_limits_ticks(values)

    @abstractmethod
    def max_voltage_v(self, values: Values) -> float:
        """Return the highest supply that a servo is set to; infinite without such a setting [V]."""

    @abstractmethod
    def free_speed_rad_s(self, joint: JointCalibration) -> float:
        """Return the speed of a joint's servo without load at full duty [rad/s]."""

    def actuation(self, joints: Sequence[JointCalibration], found: Mapping[int, ServoFound]) -> Actuation:
        """Return the strength of an arm's servos, which were found by id."""
        free_speed_rad_s = np.array([self.free_speed_rad_s(joint) for joint in joints])
        return Actuation.unprotected(free_speed_rad_s, np.full(len(joints), self.jump_rad))

    def settings(self, values: Values) -> dict[str, int]:
        """Return the surveyed settings that reports on a servo show, by the names of their registers."""
        return {}

    def has_watchdog(self, joint: JointCalibration, values: Values) -> bool:
        """Return True for a servo that has the family's watchdog."""
        return self.watchdog is not None

    # Driving.

    @abstractmethod
    def parse_telemetry(self, frame: StatusFrame, joint: JointCalibration) -> Telemetry:
        """Parse the reply to a read of :attr:`motion` or :attr:`telemetry`."""

    def status_of(self, error: int) -> StatusFlag:
        """Convert :attr:`error_register` to status flags."""
        return StatusFlag(error)

    def around_goal(self, speed_ticks_s: float) -> tuple[bytes, bytes]:
        """Return the bytes before and after a goal in the block at :attr:`goal_address`, for a speed [ticks/s]."""
        return b"", b""

    def profile(self, speed_ticks_s: float) -> Values:
        """Return the registers to write before a servo follows goals, for a speed [ticks/s]."""
        return {}

    @abstractmethod
    def limit(self, joint: JointCalibration, values: Values, share: float) -> Limit:
        """Return the limit of a servo's torque for a share of full duty, within the servo's own limits."""

    def prepare(self, bus: ServoBus, joint: JointCalibration, values: Values) -> Steps[Values]:
        """Bring a relaxed servo into the mode in which it is driven; return its registers."""
        yield from ()
        return values

    @abstractmethod
    def clear_error(self, bus: ServoBus, joint: JointCalibration) -> Steps[None]:
        """Clear a latched error, and torque; raises StartupError for a servo that keeps it, and NoReply."""

    @abstractmethod
    def has_restarted(self, found: ServoFound, values: Values, limit: Limit) -> bool:
        """Return True for a driven servo whose registers, a block of :attr:`read_back`, are as after power-up."""

    # Calibration.

    def read_differences(self, bus: ServoBus, calibration: Calibration) -> Steps[list[Difference]]:
        """Compare a calibration with the servos' registers; raises OrderRefused for servos that keep none."""
        yield 0.0
        raise OrderRefused(CALIBRATION_NOT_KEPT)

    def write_differences(self, bus: ServoBus, changes: Sequence[Difference]) -> Steps[None]:
        """Write what :meth:`read_differences` has found into servos whose torque is off."""
        yield from ()


VELOCITY_CAP_FACTOR = 1.3  # a servo may be this much faster than its joint, so that it can catch up

# Distance of a joint's limits from the place half a turn from its middle, where its turns become ambiguous (18 deg).
SEAM_TICKS = 200


class ServoMap:
    """Servos of an arm in the calibration's order; the joints' greatest velocities become their velocity caps.

    Attributes:
        found: servos by id, as the latest survey has found them.
        soft_limits_ticks: lowest and highest calibrated position allowed, by id; from the first survey on.
    """

    def __init__(
        self, family: ServoFamily, calibration: Calibration, bounds: JointBounds, limits: GuardLimits | None = None
    ) -> None:
        self.joints = calibration.joints
        self.names = tuple(joint.joint for joint in self.joints)
        self.ids = tuple(joint.servo_id for joint in self.joints)
        self.by_id = {joint.servo_id: joint for joint in self.joints}
        self.speed_ticks_s = {
            joint.servo_id: min(FASTEST_TICKS_S, abs(joint.ticks_s_from_rad_s(float(speed))) * VELOCITY_CAP_FACTOR)
            for joint, speed in zip(self.joints, bounds.max_velocity, strict=True)
        }
        self.full_torque = full_torque(calibration, limits or GuardLimits())  # shares of full duty, shape (joints,)
        self.found: dict[int, ServoFound] = {}
        self.soft_limits_ticks: dict[int, tuple[int, int]] = {}
        self._goal: RegisterEnum = family.registers.goal_position
        self._around_goal = {servo: family.around_goal(speed) for servo, speed in self.speed_ticks_s.items()}
        self._counts_turns = family.counts_turns
        self._middle_ticks = {joint.servo_id: (joint.range_min + joint.range_max) / 2.0 for joint in self.joints}
        self._offset_rad = [joint.rad_from_ticks(0.0) for joint in self.joints]
        self._rad_per_tick = [joint.rad_s_from_ticks_s(1.0) for joint in self.joints]
        self._sign = [math.copysign(1.0, scale) for scale in self._rad_per_tick]

    def by_servo(self, values: Vector) -> dict[int, float]:
        """Return the values of an array, shape (joints,), by servo id."""
        return dict(zip(self.ids, values.tolist(), strict=True))

    def label(self, servo_id: int) -> str:
        """Return a servo's joint and id for people."""
        return label(self.by_id[servo_id])

    def turns_ticks(self, servo_id: int, present_ticks: int) -> int:
        """Return the whole turns that bring a servo's present position into its calibrated range [ticks]."""
        if not self._counts_turns:
            return 0
        return round((self._middle_ticks[servo_id] - present_ticks) / TICKS_PER_TURN) * TICKS_PER_TURN

    def certain_ticks(self, servo_id: int) -> tuple[int, int]:
        """Return the lowest and highest calibrated position at which a servo's turns are certain [ticks]."""
        middle, half = self._middle_ticks[servo_id], TICKS_PER_TURN // 2 - SEAM_TICKS
        return math.ceil(middle - half), math.floor(middle + half)

    def goal_block(self, servo_id: int, goal_ticks: int) -> bytes:
        """Build the block at the family's ``goal_address`` for a goal in the servo's own turns [ticks]."""
        head, tail = self._around_goal[servo_id]
        return head + self._goal.encode(goal_ticks) + tail

    def goal_blocks(self, goal_rad: Vector, turns_ticks: Mapping[int, int]) -> dict[int, bytes]:
        """Build all servos' blocks for goals, shape (joints,) [rad], less their turns by id [ticks]."""
        each = zip(self.ids, goal_rad.tolist(), self._offset_rad, self._rad_per_tick, strict=True)
        goals = {servo: round((goal - offset) / scale) for servo, goal, offset, scale in each}
        return {servo: self.goal_block(servo, ticks - turns_ticks.get(servo, 0)) for servo, ticks in goals.items()}

    def positions_rad(self, ticks: Iterable[float]) -> list[float]:
        """Convert calibrated positions in the order of the joints from ticks to radians."""
        each = zip(ticks, self._offset_rad, self._rad_per_tick, strict=True)
        return [offset + position * scale for position, offset, scale in each]

    def velocities_rad_s(self, ticks_s: Iterable[float]) -> list[float]:
        """Convert velocities in the order of the joints from ticks/s to rad/s."""
        return [speed * scale for speed, scale in zip(ticks_s, self._rad_per_tick, strict=True)]

    def signed(self, values: Iterable[float]) -> list[float]:
        """Give loads or currents of the servos' rotation, in the order of the joints, the joints' signs."""
        return [value * sign for value, sign in zip(values, self._sign, strict=True)]

    def rad_from_ticks(self, ticks: Mapping[int, int]) -> Vector:
        """Convert calibrated positions by servo id [ticks] to an array, shape (joints,) [rad]."""
        return np.array(self.positions_rad([ticks[servo] for servo in self.ids]))

    def ticks_range(self, bounds: JointBounds) -> dict[int, tuple[int, int]]:
        """Return the lowest and highest calibrated position of each servo within the soft limits, by id [ticks]."""
        ranges = {}
        for joint, lower, upper in zip(self.joints, bounds.lower_rad, bounds.upper_rad, strict=True):
            ends = joint.ticks_from_rad(float(lower)), joint.ticks_from_rad(float(upper))
            ranges[joint.servo_id] = min(ends), max(ends)
        return ranges


def full_torque(calibration: Calibration, limits: GuardLimits) -> Vector:
    """Return the share of full duty that each joint may use at most, shape (joints,)."""
    return np.array(
        [limits.gripper_torque_limit if joint.servo.gripper else limits.torque_limit for joint in calibration.joints]
    )

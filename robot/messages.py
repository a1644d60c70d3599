"""How hard the servos may push, and what is borne before a motion has failed.

What the server and the arm process say to each other: plain data, SI units, radians.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from robot.description.model import RobotModel
from robot.faults import Fault
from robot.hardware.config import HardwareConfig
from robot.hardware.interface import BusCounters
from robot.trajectory import Trajectory, Vector


class Frequent:
    """A message sent many times a second: its arrays travel as lists, a third of the work of pickling them."""

    def __getstate__(self) -> dict[str, Any]:
        """What travels."""
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what has travelled."""
        vars(self).update((name, np.array(value) if type(value) is list else value) for name, value in state.items())


@dataclass(frozen=True)
class GuardLimits:
    """How far, how much and how long.

    Attributes:
        torque_limit: share of full duty that the servos may use, register TORQUE_LIMIT.
        gripper_torque_limit: the same for that of the gripper.
        tracking_error_rad: a joint this far behind its goal is lost [rad].
        tracking_time_s: for so long it may be [s].
        stall_current_a: a servo that draws more and all but stands still is stalled [A].
        stall_time_s: for so long it may be [s].
        min_voltage_v: less is a fault [V].
        goal_tolerance_rad: how near its joints must come to the end of a motion [rad].
        settle_timeout_s: time for that, from the end of the motion on [s].
    """

    # Less than all, so that a servo's own overload protection stays the last resort.
    torque_limit: float = 0.8
    # So that it does not burn on its grip.
    gripper_torque_limit: float = 0.5
    tracking_error_rad: float = 0.35
    tracking_time_s: float = 0.2
    # 60 % of the stall current.
    stall_current_a: float = 1.5
    # Well before the servo's own overload timer of 2 s runs out.
    stall_time_s: float = 0.3
    # The electronics of a 7.4 V servo reset not far below.
    min_voltage_v: float = 4.5
    # Backlash (0.9-1.0 deg) plus droop under load (1.8-2.6 deg) of real arms.
    goal_tolerance_rad: float = 0.06
    settle_timeout_s: float = 1.0


class EndState(Enum):
    """What becomes of the arm when nobody drives it any more."""

    HOLD = "hold"
    RELAX = "relax"


class EmergencyPolicy(Enum):
    """What an emergency stop does: cut torque, with the arm falling, or stop within one tick and hold."""

    TORQUE_OFF = "torque_off"
    HOLD = "hold"


@dataclass(frozen=True)
class ArmConfig:
    """All that the arm process needs to know.

    Attributes:
        robot: joints and their soft limits.
        hardware: the arm's actuators, real or simulated.
        state_rate_hz: how often states go to the server [Hz].
        start_enabled: whether the arm is made to hold as soon as it is connected; else it stays relaxed.
        watchdog_s: silence of the server after which the arm is stopped [s]; a simulated arm waits longer.
        on_server_lost: what becomes of the arm then, and when the server's process is gone.
        on_exit: what becomes of the arm when the server ends in good order.
        on_emergency_stop: what an emergency stop does.
        warn_temperature_c: servos above it are told of [degC].
        slow_temperature_c: motions slow down while a servo is above it [degC].
        stop_temperature_c: a servo above it is a fault [degC].
        guard_limits: how hard the servos may push, and what is borne before a motion has failed.
        fault: one that an earlier arm process had latched and nobody has reset.
    """

    robot: RobotModel
    hardware: HardwareConfig
    state_rate_hz: float = 50.0
    start_enabled: bool = True
    watchdog_s: float = 0.5
    on_server_lost: EndState = EndState.HOLD
    on_exit: EndState = EndState.HOLD
    on_emergency_stop: EmergencyPolicy = EmergencyPolicy.TORQUE_OFF
    warn_temperature_c: float = 55.0
    slow_temperature_c: float = 60.0
    stop_temperature_c: float = 65.0
    guard_limits: GuardLimits = field(default_factory=GuardLimits)
    fault: Fault | None = None


@dataclass(frozen=True)
class Continuation:
    """Where a motion takes the place of another one without a stop: for some time both are the same.

    Attributes:
        motion_id: the other, which is in progress.
        from_s: the time on it at which this one begins [s].
    """

    motion_id: int
    from_s: float


@dataclass(frozen=True)
class Execute:
    """Play a trajectory; the arm must hold, near its first position.

    Attributes:
        gripping: whether a joint that stalls on the way has gripped something, which ends the motion well; else a
            stall is a fault.
        torque_share: share of its torque limit that the joints of the motion may use, in (0, 1].
        continues: the motion whose place it takes; None to begin at rest.
    """

    motion_id: int
    trajectory: Trajectory
    gripping: bool = False
    torque_share: float = 1.0
    continues: Continuation | None = None


@dataclass(frozen=True)
class Stop:
    """Brake along the path.

    Attributes:
        motion_id: the motion to stop; None stops every motion in progress.
    """

    motion_id: int | None = None


@dataclass(frozen=True)
class Stream:
    """Follow the velocities that come as :class:`Setpoint` under the same number, at rest until the first."""

    motion_id: int
    joint_names: tuple[str, ...]


@dataclass(frozen=True)
class Setpoint:
    """Velocities for a stream's joints, in its order, shape (joints,) [rad/s].

    They hold until the next ones come, for a short time: then the joints are brought to rest, and the stream ends.
    Setpoints for a stream that has ended are not heeded.
    """

    motion_id: int
    velocity_rad_s: Vector


class Course(Enum):
    """Which way a motion is played along its path."""

    FORWARD = "forward"
    PAUSED = "paused"
    BACK = "back"


@dataclass(frozen=True)
class Pace:
    """How motions are played; grips are not concerned.

    Attributes:
        speed_factor: share of the planned speed, 0 to 1.
        course: which way; forward again when no motion is in progress any more.
    """

    speed_factor: float = 1.0
    course: Course = Course.FORWARD


@dataclass(frozen=True)
class ChangePace:
    """Play motions otherwise from now on; None leaves as it is. The speed factor also holds for motions to come."""

    speed_factor: float | None = None
    course: Course | None = None


@dataclass(frozen=True)
class Heartbeat:
    """The server is alive; it says so ten times a second when it has nothing else to say."""


class Order(Enum):
    """What the server may ask of the arm besides motions."""

    ENABLE = "enable"
    RELAX = "relax"
    EMERGENCY_STOP = "emergency_stop"
    RESET_FAULT = "reset_fault"


@dataclass(frozen=True)
class Command:
    """One order; its number comes back with :class:`CommandDone`."""

    number: int
    order: Order


@dataclass(frozen=True)
class Shutdown:
    """Brake, then end the process; the servos hold their last goal."""


class Mode(Enum):
    """What the arm is doing: the states of its machine."""

    DISCONNECTED = "disconnected"
    CONNECTED = "connected"
    RELAXED = "relaxed"
    HOLDING = "holding"
    MOVING = "moving"
    FAULT = "fault"


class Outcome(Enum):
    """How a motion ended."""

    REACHED = "reached"
    STOPPED = "stopped"
    REFUSED = "refused"
    TRACKING_LOST = "tracking lost"
    NOT_SETTLED = "not settled"
    BUS_LOST = "bus lost"
    PROCESS_LOST = "process lost"
    FAULT = "fault"
    GRIPPED = "gripped"


@dataclass(frozen=True)
class MotionEnded:
    """The one answer to an :class:`Execute`, and to a :class:`Stream`."""

    motion_id: int
    outcome: Outcome
    message: str


@dataclass(frozen=True)
class CommandDone:
    """The one answer to a :class:`Command`: whether it was carried out, and a sentence."""

    number: int
    done: bool
    message: str


@dataclass(frozen=True)
class Commanded(Frequent):
    """Where the joints of a stream were told to be, at every tick.

    Attributes:
        at_s: time since the stream began [s].
        position_rad: in the stream's order, shape (joints,) [rad].
        velocity_rad_s: shape (joints,) [rad/s].
    """

    motion_id: int
    at_s: float
    position_rad: Vector
    velocity_rad_s: Vector


@dataclass(frozen=True)
class ArmState(Frequent):
    """The arm at one moment.

    Attributes:
        stamp_s: wall-clock time of the reading [s since the epoch].
        reason: why the arm is disconnected, or connected but refused by its checks; empty otherwise. A connected arm
            without a reason is still being checked or switched on.
        fault: what must be reset before the arm moves again.
        joint_names: order of the arrays.
        position_rad: measured, shape (joints,).
        velocity_rad_s: measured, shape (joints,).
        age_s: how long before ``stamp_s`` each joint was asked for its reading, shape (joints,) [s].
        load: share of full motor duty, signed, -1..1, shape (joints,).
        current_a: motor current, signed, shape (joints,) [A].
        goal_rad: commanded, shape (joints,).
        motion_id: the motion in progress, of several the one with most joints; or None.
        fraction: share of the motion that is done, 0..1.
        remaining_s: time left to the end of the motion [s].
        pace: how motions are played.
        lateness_s: by how much the latest ticks started late, one value each [s].
        clock_s: time of the control loop, which on a simulated arm passes no faster than the loop runs [s].
        driven: whether the arm is made to hold or move; else torque is off.
    """

    stamp_s: float
    mode: Mode
    joint_names: tuple[str, ...]
    reason: str = ""
    position_rad: Vector | None = None
    velocity_rad_s: Vector | None = None
    age_s: Vector | None = None
    load: Vector | None = None
    current_a: Vector | None = None
    goal_rad: Vector | None = None
    motion_id: int | None = None
    fraction: float = 0.0
    remaining_s: float = 0.0
    pace: Pace = Pace()
    lateness_s: tuple[float, ...] = field(default=())
    fault: Fault | None = None
    clock_s: float = 0.0
    driven: bool = False


@dataclass(frozen=True)
class JointHealth:
    """One joint's actuator, as ``/diagnostics`` shows it; NaN for what the hardware does not measure.

    Attributes:
        hardware_id: its actuator, as ``servo 3``.
        status: bits of :class:`robot.hardware.interface.StatusFlag`.
        age_s: time since its last good reply [s].
        silent_cycles: cycles in which it did not answer, since the bus was opened.
        warnings: findings to look after, a sentence each.
    """

    joint: str
    hardware_id: str
    position_rad: float
    temperature_c: float
    voltage_v: float
    current_a: float
    load: float
    torque_enabled: bool | None
    status: int
    age_s: float
    silent_cycles: int
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class ArmHealth:
    """The arm's condition, once a second.

    Attributes:
        stamp_s: wall-clock time [s since the epoch].
        port: the arm's port; ``simulated`` or ``ideal`` where there is none.
        joints: one each, in the order of the arm's arrays.
        bus: counters of the bus since it was opened; None for hardware without one.
        lateness_s: start of the ticks after their deadlines in the last second: p50, p99, greatest [s].
        round_trip_s: time that block reads took in the last second: p50, p99, greatest [s].
        real_time: whether the process has real-time priority.
        real_time_factor: seconds of the arm's time that passed in one of the machine's; below 1 a simulated arm runs
            slower because the machine is busy.
        limits_rad: soft limits that are kept, shape (joints, 2) [rad].
    """

    stamp_s: float
    mode: Mode
    port: str
    joints: tuple[JointHealth, ...]
    bus: BusCounters | None
    lateness_s: tuple[float, float, float]
    round_trip_s: tuple[float, float, float]
    real_time: bool
    real_time_factor: float = 1.0
    limits_rad: Vector | None = None
    fault: Fault | None = None
    reason: str = ""

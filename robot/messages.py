"""Messages between the server and the arm process: plain data in SI units and radians.

First the server's (configuration, motions, streams, pace, orders), then the arm's (ends of motions, answers to orders,
states, health).
"""

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from typing import Any

import numpy as np

from robot.calibration import Calibration
from robot.description.model import RobotModel
from robot.faults import Fault, ServoWarning
from robot.hardware.config import HardwareConfig
from robot.physics.bodies import BodyStates
from robot.trajectory import Trajectory, Vector

log = logging.getLogger("armbridge.arm")

# Least speed limit: below it a joint moves less than a servo's tick in a period of the control loop.
MIN_SPEED_LIMIT = 0.01


class Frequent:
    """Base of messages sent many times a second: arrays are pickled as lists, which costs a third."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update((name, np.array(value) if type(value) is list else value) for name, value in state.items())


def within(default: float, lowest: float, highest: float) -> Any:
    """Make the field of a number that the arm process takes within a range only: see :func:`checked`."""
    return field(default=default, metadata={"range": (lowest, highest)})


@dataclass(frozen=True)
class GuardLimits:
    """Torque limits, thresholds of the guards, and tolerances of a motion's end."""

    # Share of full duty that the servos may use, register TORQUE_LIMIT: below 1, so that a servo's own overload
    # protection stays the last resort; with less than 0.3 the arm does not hold itself.
    torque_limit: float = within(0.8, 0.3, 0.8)
    # The same for the gripper's servo, which holds for long: with more it overheats.
    gripper_torque_limit: float = within(0.5, 0.2, 0.5)
    tracking_error_rad: float = within(0.35, 0.1, 1.0)  # distance to its goal beyond which a joint has lost track [rad]
    tracking_time_s: float = within(0.2, 0.05, 1.0)  # time for which that must last to be a fault [s]
    # Current above which a servo that all but stands still is stalled: 60 % of the stall current [A].
    stall_current_a: float = within(1.5, 0.3, 2.7)
    # Time for which that must last to be a fault; the servo's own overload timer runs out at 2 s [s].
    stall_time_s: float = within(0.3, 0.1, 1.5)
    # Age of a servo's last answer beyond which it is silent, which is a fault: ten missed cycles, since single packets
    # get lost; the servos follow their last goals meanwhile, unseen [s].
    silent_after_s: float = within(0.1, 0.05, 1.0)
    # Voltage below which the supply is a fault: servos of 7.4 V need 4 V, servos of 12 V run from 9 V on [V].
    min_voltage_v: float = within(4.5, 4.0, 11.0)
    # Greatest distance of a settled joint from the end of a motion: backlash (0.9-1.0 deg) plus droop under load
    # (1.8-2.6 deg) of real arms [rad].
    goal_tolerance_rad: float = within(0.06, 0.02, 0.3)
    settle_timeout_s: float = within(1.0, 0.1, 10.0)  # time to settle, from the end of the motion on [s]
    # Temperatures of warning, slower motions and fault, each inclusive; servos protect themselves at 70 degC [degC].
    warn_temperature_c: float = within(55.0, 30.0, 70.0)
    slow_temperature_c: float = within(60.0, 30.0, 70.0)
    stop_temperature_c: float = within(65.0, 30.0, 70.0)


# Longest times of the arm's end, counted in ticks, after which its process ends in any state [s]. Braking takes a
# second at most, relaxing 1.5 s, checking that torque is off up to a second where a servo does not answer. Parking
# comes before that: an SO-101 needs 2 to 5 s from one end of its workspace.
END_TIMEOUT_S = 5.0
PARKING_TIMEOUT_S = 15.0

# A starved arm has fewer ticks a second. By its clock its end takes no longer than this [s]: systemd and Docker end the
# process after 30 s, as they are set up in the docs.
END_LIMIT_S = 25.0

# Advice on a real arm whose process ended with torque on, or perhaps on.
TORQUE_LEFT_ON = "Hold the arm, and switch the servos' supply off, or start the server again and relax it"


class EndState(Enum):
    """Policy for the arm when the server has ended; PARK plays the kept trajectory, where it can, then relaxes."""

    HOLD = "hold"
    RELAX = "relax"
    PARK = "park"


class EmergencyPolicy(Enum):
    """Policy of emergency stops: cut torque, so that the arm falls, or stop within one tick and hold."""

    TORQUE_OFF = "torque_off"
    HOLD = "hold"


@dataclass(frozen=True)
class ArmConfig:
    """Configuration of the arm process."""

    robot: RobotModel
    hardware: HardwareConfig
    # A slower one would lose count of a joint that a hand turns across the seam while it is calibrated.
    state_rate_hz: float = within(50.0, 10.0, 100.0)
    start_enabled: bool = True  # True to enable the arm once it is connected; else it stays relaxed
    # Silence of the server after which the arm is stopped; a simulated arm waits longer. The shortest timeout tolerates
    # two missed heartbeats [s].
    watchdog_s: float = within(0.5, 0.3, 10.0)
    on_server_lost: EndState = EndState.HOLD  # policy for the arm then, and when the server's process is gone
    on_exit: EndState = EndState.HOLD
    on_emergency_stop: EmergencyPolicy = EmergencyPolicy.TORQUE_OFF
    guard_limits: GuardLimits = field(default_factory=GuardLimits)
    # Share of the joints' velocity limits that no motion exceeds, until it is changed.
    speed_limit: float = within(1.0, MIN_SPEED_LIMIT, 1.0)
    fault: Fault | None = None  # fault latched by an earlier arm process and not yet reset
    last_stop: int = 0  # stop epoch of the last stop before the process began
    stopped: bool = False  # True if nothing was asked of the arm since that stop


def checked(config: ArmConfig) -> ArmConfig:
    """Return the configuration with every number that is out of its range replaced by its default."""
    guard_limits = replace(config.guard_limits, **_corrections(config.guard_limits))
    return replace(config, guard_limits=guard_limits, **_corrections(config))


def _corrections(values: ArmConfig | GuardLimits) -> dict[str, Any]:
    """Return the defaults of the values that are out of their ranges, by field; NaN is out of every range."""
    found = {}
    for each in filter(lambda each: each.metadata, fields(values)):
        least, most = each.metadata["range"]
        if not least <= getattr(values, each.name) <= most:
            log.error("%s must be %g to %g; it is taken as %g", each.name, least, most, each.default)
            found[each.name] = each.default
    return found


@dataclass(frozen=True)
class Continuation:
    """Point at which a motion is spliced into another one without a stop; both coincide for some time."""

    motion_id: int  # motion in progress that is replaced
    from_s: float  # time on it at which the new one begins [s]
    leaves_s: float = 0.0  # monotonic time at which the new one leaves its path; a tick comes soon after [s]


@dataclass(frozen=True)
class Execute:
    """Command to play a trajectory; the arm must hold near its first position."""

    motion_id: int
    trajectory: Trajectory  # trajectory of some joints; the others hold
    # True if a joint that stalls on the way has gripped something, which ends the motion well; otherwise a stall is a
    # fault.
    gripping: bool = False
    torque_share: float = 1.0  # share of its torque limit that the joints of the motion may use, in (0, 1]
    continues: Continuation | None = None  # motion in progress to splice into; None to begin at rest
    epoch: int = 0  # stop epoch in which the motion was requested (robot.stop_epochs)


@dataclass(frozen=True)
class ParkingPlan:
    """Trajectory to the rest pose, found free of collisions in the scene of its time."""

    trajectory: Trajectory
    held_rad: Mapping[str, float]  # goal of every joint of the arm at its start; it is played from there alone [rad]


@dataclass(frozen=True)
class KeepParking:
    """Command to keep a parking trajectory in place of the former; None when the former became invalid."""

    plan: ParkingPlan | None


@dataclass(frozen=True)
class Stop:
    """Command to brake along the path."""

    motion_id: int | None = None  # motion to stop; None stops every motion in progress
    epoch: int = 0  # stop epoch that a stop of all motion begins: the arm refuses requests from earlier epochs


@dataclass(frozen=True)
class Stream:
    """Command to follow the velocities of :class:`Setpoint` messages of the same number; at rest until the first."""

    motion_id: int
    joint_names: tuple[str, ...]  # joints that follow, order of the setpoints
    epoch: int = 0
    gripping: bool = False  # as in Execute


@dataclass(frozen=True)
class Setpoint:
    """Velocities for a stream's joints, valid for a short time; without a next one the stream ends at rest."""

    motion_id: int
    velocity_rad_s: Vector  # in the stream's order, shape (joints,) [rad/s]


class PlaybackDirection(Enum):
    """Direction in which motions are played along their paths."""

    FORWARD = "forward"
    PAUSED = "paused"
    BACK = "back"


@dataclass(frozen=True)
class Pace:
    """Speed and direction of motions; grips are exempt from the speed factor and the direction."""

    speed_factor: float = 1.0  # share of the planned speed, 0 to 1
    direction: PlaybackDirection = PlaybackDirection.FORWARD  # forward again once no motion is in progress
    speed_limit: float = 1.0  # share of the joints' velocity limits that no motion exceeds, MIN_SPEED_LIMIT to 1


@dataclass(frozen=True)
class ChangePace:
    """Command to change the pace of motions; None leaves a value. Factor and limit also apply to later motions."""

    speed_factor: float | None = None
    direction: PlaybackDirection | None = None
    speed_limit: float | None = None


@dataclass(frozen=True)
class Heartbeat:
    """Sign of life of the server, ten times a second."""

    # False when nobody sees the arm's states at the moment, so that a simulated one may report fewer.
    observed: bool = True


class Order(Enum):
    """Orders of the server besides motions."""

    ENABLE = "enable"
    RELAX = "relax"
    EMERGENCY_STOP = "emergency_stop"
    RESET_FAULT = "reset_fault"
    WRITE_CALIBRATION = "write_calibration"


@dataclass(frozen=True)
class Command:
    """Order with a number, which its :class:`CommandDone` repeats."""

    number: int
    order: Order
    calibration: Calibration | None = None  # calibration to write into the servos, of WRITE_CALIBRATION only
    epoch: int = 0  # stop epoch that an emergency stop begins, or in which another order was requested


@dataclass(frozen=True)
class PauseSimulation:
    """Command to let the time of a simulated arm stand still after some single ticks, or pass again."""

    paused: bool
    ticks: int = 0


@dataclass(frozen=True)
class Shutdown:
    """Command to brake, bring the arm to its end state and end the process."""

    epoch: int = 0  # stop epoch in which the end was requested: after a later stop the arm is not parked
    hurry: bool = False  # True to relax an arm that was to be parked


class Mode(Enum):
    """State of the arm's state machine."""

    DISCONNECTED = "disconnected"
    CONNECTED = "connected"
    RELAXED = "relaxed"
    HOLDING = "holding"
    MOVING = "moving"
    FAULT = "fault"


class Outcome(Enum):
    """Outcome of a motion."""

    REACHED = "reached"
    STOPPED = "stopped"
    UNSTEERED = "unsteered"  # no setpoint came for a stream
    REFUSED = "refused"
    TRACKING_LOST = "tracking lost"
    NOT_SETTLED = "not settled"
    BUS_LOST = "bus lost"
    PROCESS_LOST = "process lost"
    FAULT = "fault"
    GRIPPED = "gripped"


@dataclass(frozen=True)
class MotionEnded:
    """End of a motion or stream: the one answer to :class:`Execute` and to :class:`Stream`."""

    motion_id: int
    outcome: Outcome
    message: str


@dataclass(frozen=True)
class CommandDone:
    """Answer to a :class:`Command`: True in ``done`` if it was carried out, and a sentence."""

    number: int
    done: bool
    message: str


@dataclass(frozen=True)
class Commanded(Frequent):
    """Goals of a stream's joints, at every tick."""

    motion_id: int
    at_s: float  # time since the stream began [s]
    position_rad: Vector  # in the stream's order, shape (joints,) [rad]
    velocity_rad_s: Vector  # shape (joints,) [rad/s]


@dataclass(frozen=True)
class MotionProgress:
    """Progress of one motion."""

    motion_id: int
    fraction: float  # share that is done, 0..1
    remaining_s: float  # time left to its end [s]
    rate: float = 1.0  # share of the planned speed at which it may be played, above 0 while it is not paused, at most 1


# Sequences that a viewer shows, as ArmState names them.
STARTING_ARM, RELAXING_ARM = "starting", "relaxing"


@dataclass(frozen=True)
class ArmState(Frequent):
    """State of the arm at one moment."""

    stamp_s: float  # wall-clock time of the reading [s since the epoch]
    mode: Mode
    joint_names: tuple[str, ...]
    # Cause of being disconnected, or connected but refused by the checks; empty otherwise. A connected arm without a
    # reason is still being checked or switched on.
    reason: str = ""
    task: str = ""  # sequence in progress: STARTING_ARM, RELAXING_ARM or none
    position_rad: Vector | None = None  # measured, shape (joints,)
    velocity_rad_s: Vector | None = None  # measured, shape (joints,)
    age_s: Vector | None = None  # time from each joint's reading to `stamp_s`, shape (joints,) [s]
    load: Vector | None = None  # share of full motor duty, signed, -1..1, shape (joints,)
    current_a: Vector | None = None  # motor current, signed, shape (joints,) [A]
    goal_rad: Vector | None = None  # commanded, shape (joints,)
    motions: tuple[MotionProgress, ...] = ()  # motions in progress
    pace: Pace = Pace()
    # Start of the latest ticks after their deadlines, one value each [s].
    lateness_s: tuple[float, ...] = field(default=())
    fault: Fault | None = None  # latched fault, to be reset before the arm moves again
    # Standstill that has stopped the arm, in words: it refuses motions until the server's next stop. Empty for none.
    halted: str = ""
    last_stop: int = 0  # stop epoch of the last stop that the arm process has received
    stopped: bool = False  # True from a stop of all motion until something else is asked of the arm
    tick_s: float = 0.0  # monotonic time of the machine at its tick; 0 for several arms, which tick by themselves [s]
    clock_s: float = 0.0  # time of the control loop, which on a simulated arm passes no faster than the loop runs [s]
    torque_enabled: bool = False  # True while torque is on
    bodies: BodyStates | None = None  # bodies around an arm with physics that have moved; None for none
    # Single ticks since the time of an arm with physics stands still; None while it passes.
    stepped_ticks: int | None = None


@dataclass
class BusCounters:
    """Counters of the bus since it was opened."""

    sent: int = 0  # instructions written
    replies: int = 0  # valid replies received
    timeouts: int = 0  # replies that were expected and missing or invalid
    discarded_bytes: int = 0  # bytes that belonged to no valid reply
    retries: int = 0  # instructions repeated because the servo gave no valid reply


@dataclass(frozen=True)
class JointHealth:
    """Health of one joint's actuator, as in ``/diagnostics``; NaN for what the hardware does not measure."""

    joint: str
    hardware_id: str  # name of the actuator, as `servo 3`
    position_rad: float = math.nan
    temperature_c: float = math.nan
    voltage_v: float = math.nan
    current_a: float = math.nan
    load: float = math.nan
    torque_enabled: bool | None = None  # True if its torque was on when it was last read back; None before
    status: int = 0  # bits of StatusFlag
    age_s: float = math.inf  # time since its last good reply [s]
    silent_cycles: int = 0  # cycles in which it did not answer, since the bus was opened
    warnings: tuple[ServoWarning, ...] = ()  # warnings of the survey and of the moment
    # Other errors since the bus was opened, by kind (ServoAlert).
    errors: Mapping[str, int] = field(default_factory=dict)
    registers: Mapping[str, int] = field(default_factory=dict)  # its settings as surveyed, by the name of the register
    # Values that settings should have which have another, by the name of the register.
    expected: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class ArmHealth:
    """Health of the arm, once a second."""

    monotonic_s: float  # monotonic time of the machine, which all of its processes share [s]
    mode: Mode
    port: str  # serial port of the arm; `simulated` or `ideal` where there is none
    joints: tuple[JointHealth, ...]
    bus: BusCounters | None  # counters of the bus since it was opened; None for hardware without one
    # Start of the ticks after their deadlines in the last second: p50, p99, greatest [s].
    lateness_s: tuple[float, float, float]
    round_trip_s: tuple[float, float, float]  # time that block reads took in the last second: p50, p99, greatest [s]
    real_time: bool
    # Arm's time per machine's time; below the rate a simulated arm is slow because the machine is busy.
    real_time_factor: float = 1.0
    rate: float = 1.0  # factor that a fast machine reaches
    memory_locked: bool = False
    limits_rad: Vector | None = None  # soft limits in force, shape (joints, 2) [rad]; None before the survey
    fault: Fault | None = None
    reason: str = ""

"""What the server and the arm process say to each other: plain data, SI units, radians."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from robot.calibration import Calibration
from robot.model import RobotModel
from robot.trajectory import Trajectory, Vector


class Mode(Enum):
    """What the arm is doing."""

    DISCONNECTED = "disconnected"
    HOLDING = "holding"
    MOVING = "moving"


class Outcome(Enum):
    """How a motion ended."""

    REACHED = "reached"
    STOPPED = "stopped"
    REFUSED = "refused"
    TRACKING_LOST = "tracking lost"
    NOT_SETTLED = "not settled"
    BUS_LOST = "bus lost"
    PROCESS_LOST = "process lost"


@dataclass(frozen=True)
class ArmConfig:
    """All that the arm process needs to know.

    Attributes:
        robot: joints and their soft limits.
        calibration: servos of the joints, and how their ticks are radians.
        port: serial device, ``socket://host:port`` or ``auto``.
        state_rate_hz: how often states go to the server [Hz].
    """

    robot: RobotModel
    calibration: Calibration
    port: str
    state_rate_hz: float = 50.0


@dataclass(frozen=True)
class Execute:
    """Play a trajectory; the arm must hold, near its first position."""

    motion_id: int
    trajectory: Trajectory


@dataclass(frozen=True)
class Stop:
    """Brake along the path of the motion in progress, if any."""


@dataclass(frozen=True)
class Shutdown:
    """Brake, then end the process; the servos hold their last goal."""


@dataclass(frozen=True)
class MotionEnded:
    """The one answer to an :class:`Execute`."""

    motion_id: int
    outcome: Outcome
    message: str


@dataclass(frozen=True)
class ArmState:
    """The arm at one moment.

    Attributes:
        stamp_s: wall-clock time of the reading [s since the epoch].
        reason: why the arm is disconnected; empty otherwise.
        joint_names: order of the arrays.
        position_rad: measured, shape (joints,).
        velocity_rad_s: measured, shape (joints,).
        load: share of full motor duty, signed, -1..1, shape (joints,).
        goal_rad: commanded, shape (joints,).
        motion_id: the motion in progress, or None.
        fraction: share of the motion that is done, 0..1.
        remaining_s: time left to the end of the motion [s].
        lateness_s: by how much the latest ticks started late, one value each [s].
    """

    stamp_s: float
    mode: Mode
    joint_names: tuple[str, ...]
    reason: str = ""
    position_rad: Vector | None = None
    velocity_rad_s: Vector | None = None
    load: Vector | None = None
    goal_rad: Vector | None = None
    motion_id: int | None = None
    fraction: float = 0.0
    remaining_s: float = 0.0
    lateness_s: tuple[float, ...] = field(default=())

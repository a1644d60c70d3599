"""Table of an arm's servos: the joint that each turns, its id and model, and the place of the joint's zero."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

if TYPE_CHECKING:
    from robot.description.robot_file import ProfileTable

MAX_SERVO_ID = 253  # 254 is the broadcast id of both kinds of bus, and Dynamixel reserves 253 too

ServoKind: TypeAlias = Literal["feetech", "dynamixel"]  # families of servos
HardwareKind: TypeAlias = Literal[ServoKind, "ideal"]

# Greatest register HOMING_OFFSET by the servos' kind: an STS3215's has 11 bits and a sign; a Dynamixel's counts up
# to 255 turns (e-manual, Homing Offset (20)), and lerobot writes whole turns into it where the servo had counted some.
MAX_HOMING_OFFSET: Mapping[HardwareKind, int] = {"feetech": 2047, "dynamixel": 1_044_479}


@dataclass(frozen=True)
class ZeroTick:
    """Zero given by one position."""

    tick: int | None = None  # tick at which the joint is at `angle_rad`; None for the middle of its calibrated range
    angle_rad: float = 0.0  # position of the joint there [rad]


# With ``ends`` the ends of the calibrated range are the URDF's limits: a gripper, whose stops define both.
Zero: TypeAlias = Literal["ends"] | ZeroTick


@dataclass(frozen=True)
class ServoSpec:
    """Servo of a joint, as the robot's folder describes it."""

    joint: str  # name in the URDF
    servo_id: int
    lower_rad: float  # lower limit of the joint in the URDF [rad]
    upper_rad: float  # upper limit [rad]
    model: str = "sts3215"  # model of the servo, in small letters
    sign: int = 1  # 1, or -1 for a servo whose ticks fall while the joint's position rises
    zero: Zero = ZeroTick()
    turns_freely: bool = False  # True for a joint without end stops
    gripper: bool = False  # True for a joint of the gripper, which may stall against what it holds
    max_homing_offset: int = MAX_HOMING_OFFSET["feetech"]  # greatest register HOMING_OFFSET [ticks]

    @property
    def needs_calibration(self) -> bool:
        """True when only a calibration can say where the joint's zero is."""
        return self.zero == "ends" or self.zero.tick is None


@dataclass(frozen=True)
class HardwareTable:
    """Hardware of an arm."""

    kind: HardwareKind = "ideal"  # kind of its servos; `ideal` for joints without servos
    servos: tuple[ServoSpec, ...] = ()  # its servos, in the order of every array; empty for ideal joints
    baud: int = 1_000_000
    # Folders in which lerobot keeps calibrations of the arm, the newest name first.
    calibrations: tuple[str, ...] = ()
    # Settings of its servos; None for the factory's or lerobot's, whichever are nearer.
    profile: ProfileTable | None = None

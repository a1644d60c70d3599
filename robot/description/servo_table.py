"""Table of an arm's servos: the joint that each turns, its id and model, and the place of the joint's zero."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

# 254 is the broadcast id of both kinds of bus, and Dynamixel reserves 253 too.
MAX_SERVO_ID = 253

HardwareKind: TypeAlias = Literal["feetech", "dynamixel", "ideal"]


@dataclass(frozen=True)
class ZeroTick:
    """Zero given by one position.

    Attributes:
        tick: tick at which the joint is at ``angle_rad``; None for the middle of its calibrated range.
        angle_rad: position of the joint there [rad].
    """

    tick: int | None = None
    angle_rad: float = 0.0


# With ``ends`` the ends of the calibrated range are the URDF's limits: a gripper, whose stops define both.
Zero: TypeAlias = Literal["ends"] | ZeroTick


@dataclass(frozen=True)
class ServoSpec:
    """Servo of a joint, as the robot's folder describes it.

    Attributes:
        joint: name in the URDF.
        lower_rad: lower limit of the joint in the URDF [rad].
        upper_rad: upper limit [rad].
        model: model of the servo, in small letters.
        sign: 1, or -1 for a servo whose ticks fall while the joint's position rises.
        turns_freely: True for a joint without end stops.
        gripper: True for a joint of the gripper, which may stall against what it holds.
    """

    joint: str
    servo_id: int
    lower_rad: float
    upper_rad: float
    model: str = "sts3215"
    sign: int = 1
    zero: Zero = ZeroTick()
    turns_freely: bool = False
    gripper: bool = False

    @property
    def needs_calibration(self) -> bool:
        """True when only a calibration can say where the joint's zero is."""
        return self.zero == "ends" or self.zero.tick is None


@dataclass(frozen=True)
class ProfileSpec:
    """Settings that the servos of an arm should have, by the names of their registers.

    Attributes:
        base: profile from which they differ.
        registers: values for every servo.
        gripper: values for the gripper's servos.
    """

    base: Literal["factory", "lerobot"] = "factory"
    registers: Mapping[str, int] = field(default_factory=dict)
    gripper: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class HardwareTable:
    """Hardware of an arm.

    Attributes:
        kind: kind of its servos; ``ideal`` for joints without servos.
        servos: its servos, whose order is that of every array; empty for ideal joints.
        calibrations: folders in which lerobot keeps calibrations of such arms, the newest name first.
        profile: settings of its servos; None for those of the factory or of lerobot, whichever are nearer.
    """

    kind: HardwareKind = "ideal"
    servos: tuple[ServoSpec, ...] = ()
    baud: int = 1_000_000
    calibrations: tuple[str, ...] = ()
    profile: ProfileSpec | None = None

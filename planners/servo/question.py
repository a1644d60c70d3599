"""Requests of MoveIt Servo and their answers: plain data in the root link, in SI units, without planning libraries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from planners.scene import ZERO, Point, Pose

MAX_PERIOD_S = 0.1  # with a longer period the arm moves too far between two commands

# Share of the joints' acceleration that steering uses; the arm, which rounds the corners, needs some of the rest.
ACCELERATION_SHARE = 0.7

# Speed of approach per distance left. With it a joint at full speed brakes as hard as it can, and no harder.
APPROACH_PER_S = 2.5


class ServoStatus(IntEnum):
    """Values of moveit_msgs/ServoStatus."""

    INVALID = -1
    NO_WARNING = 0
    DECELERATE_FOR_APPROACHING_SINGULARITY = 1
    HALT_FOR_SINGULARITY = 2
    DECELERATE_FOR_LEAVING_SINGULARITY = 3
    DECELERATE_FOR_COLLISION = 4
    HALT_FOR_COLLISION = 5
    JOINT_BOUND = 6


@dataclass(frozen=True)
class TipTwist:
    """The tip moves and turns: its origin's velocity and its angular velocity along the root link's axes."""

    linear_m_s: Point = ZERO
    angular_rad_s: Point = ZERO

    @property
    def zero(self) -> bool:
        """True for a command to rest."""
        return not (any(self.linear_m_s) or any(self.angular_rad_s))


@dataclass(frozen=True)
class JointVelocities:
    """Joints turn at these velocities, the others rest [rad/s]."""

    velocity_rad_s: Mapping[str, float]

    @property
    def zero(self) -> bool:
        """True for a command to rest."""
        return not any(self.velocity_rad_s.values())


@dataclass(frozen=True)
class TipTarget:
    """The tip goes to a pose, its orientation as near as possible."""

    pose: Pose
    zero = False


ServoCommand = TipTwist | JointVelocities | TipTarget


@dataclass(frozen=True)
class Anchor:
    """Pose that the tip keeps in the directions that are not commanded, so that it does not drift."""

    pose: Pose  # pose of the tip to keep
    along: Point = ZERO  # unit vector along which it is moved, and so may be anywhere; zero to hold the position
    about: Point = ZERO  # unit vector about which it is turned, and so may have any angle; zero to hold the orientation


@dataclass(frozen=True)
class ServoLimits:
    """Limits of servoing."""

    linear_m_s: float = 0.4  # greatest speed of the tip on its way to a target [m/s]
    angular_rad_s: float = 0.8  # greatest speed of its turn there [rad/s]
    velocity_scaling: float = 1.0  # share of the joints' velocity limits that may be used, in (0, 1]
    # Condition number of the tip's position from which motion towards a singularity is slowed.
    singularity_slow: float = 17.0
    singularity_stop: float = 30.0  # condition number at which such motion ends
    self_distance_m: float | None = 0.003  # nearest that links come to each other; None to keep no distance [m]
    scene_distance_m: float | None = 0.005  # nearest that links come to objects; None likewise [m]


@dataclass(frozen=True)
class ServoQuestion:
    """Question for the joint velocities of this moment; answered by :class:`ServoAnswer`."""

    group: str  # the joints that may move
    link: str  # the tip
    positions_rad: Mapping[str, float]  # commanded position of every movable joint [rad]
    velocity_rad_s: Mapping[str, float]  # the last answer's; joints not named rest [rad/s]
    period_s: float  # time between two answers, above 0 to ``MAX_PERIOD_S`` [s]
    command: ServoCommand  # the command
    anchor: Anchor | None = None  # of the last answer to the same steering; None at its beginning
    limits: ServoLimits = ServoLimits()  # limits of the motion


@dataclass(frozen=True)
class ServoAnswer:
    """Joint velocities of this moment, and the status that goes with them."""

    velocity_rad_s: Mapping[str, float]  # of every joint of the group [rad/s]
    status: ServoStatus = ServoStatus.NO_WARNING  # the gravest reason for a reduced speed
    message: str = ""  # the status in words, with the parts of the command that are given up; may be empty
    share: float = 1.0  # achieved share of the commanded speed, 0 to 1
    anchor: Anchor | None = None  # for the next question

"""Requests of MoveIt Servo for joint velocities, many times a second, and their answers: plain data.

All of it is in the robot's root link and in SI units. This module imports none of the planning libraries.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from planners.scene import Point, Pose

# With a longer period the arm moves too far between two commands.
MAX_PERIOD_S = 0.1

# Share of the joints' acceleration that steering uses; the arm, which rounds the corners, needs some of the rest.
ACCELERATION_SHARE = 0.7

# Speed of approach per distance left. With it a joint at full speed brakes as hard as it can, and no harder.
APPROACH_PER_S = 2.5

ZERO: Point = (0.0, 0.0, 0.0)


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
    """Pose that the tip keeps in the directions that are not commanded, so that it does not drift.

    Attributes:
        pose: pose of the tip to keep.
        along: unit vector along which it is moved, and so may be anywhere; zero to hold the position.
        about: unit vector about which it is turned, and so may have any angle; zero to hold the orientation.
    """

    pose: Pose
    along: Point = ZERO
    about: Point = ZERO


@dataclass(frozen=True)
class ServoLimits:
    """Limits of servoing.

    Attributes:
        linear_m_s: greatest speed of the tip on its way to a target [m/s].
        angular_rad_s: greatest speed of its turn there [rad/s].
        velocity_scaling: share of the joints' velocity limits that may be used, in (0, 1].
        singularity_slow: condition number of the tip's position from which motion towards a singularity is slowed.
        singularity_stop: condition number at which such motion ends.
        self_distance_m: nearest that links come to each other; None to keep no distance [m].
        scene_distance_m: nearest that links come to objects; None likewise [m].
    """

    linear_m_s: float = 0.4
    angular_rad_s: float = 0.8
    velocity_scaling: float = 1.0
    singularity_slow: float = 17.0
    singularity_stop: float = 30.0
    self_distance_m: float | None = 0.003
    scene_distance_m: float | None = 0.005


@dataclass(frozen=True)
class ServoQuestion:
    """Question for the joint velocities of this moment; answered by :class:`ServoAnswer`.

    Attributes:
        group: the joints that may move.
        link: the tip.
        positions_rad: commanded position of every movable joint [rad].
        velocity_rad_s: the last answer's; joints not named rest [rad/s].
        period_s: time between two answers, above 0 to ``MAX_PERIOD_S`` [s].
        command: the command.
        anchor: of the last answer to the same steering; None at its beginning.
        limits: limits of the motion.
    """

    group: str
    link: str
    positions_rad: Mapping[str, float]
    velocity_rad_s: Mapping[str, float]
    period_s: float
    command: ServoCommand
    anchor: Anchor | None = None
    limits: ServoLimits = ServoLimits()


@dataclass(frozen=True)
class ServoAnswer:
    """Joint velocities of this moment, and the status that goes with them.

    Attributes:
        velocity_rad_s: of every joint of the group [rad/s].
        status: the gravest reason for a reduced speed.
        message: the status in words, with the parts of the command that are given up; may be empty.
        share: achieved share of the commanded speed, 0 to 1.
        anchor: for the next question.
    """

    velocity_rad_s: Mapping[str, float]
    status: ServoStatus = ServoStatus.NO_WARNING
    message: str = ""
    share: float = 1.0
    anchor: Anchor | None = None

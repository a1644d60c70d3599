"""What is asked of a planner and what it answers: plain data that crosses process boundaries.

This module imports none of the planning libraries, so the server can speak of problems without loading them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from robot.trajectory import Trajectory


class MoveItErrorCode(IntEnum):
    """Values of moveit_msgs/MoveItErrorCodes."""

    SUCCESS = 1
    UNDEFINED = 0
    FAILURE = 99999
    PLANNING_FAILED = -1
    INVALID_MOTION_PLAN = -2
    MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE = -3
    CONTROL_FAILED = -4
    UNABLE_TO_AQUIRE_SENSOR_DATA = -5  # the spelling is MoveIt's
    TIMED_OUT = -6
    PREEMPTED = -7
    START_STATE_IN_COLLISION = -10
    START_STATE_VIOLATES_PATH_CONSTRAINTS = -11
    GOAL_IN_COLLISION = -12
    GOAL_VIOLATES_PATH_CONSTRAINTS = -13
    GOAL_CONSTRAINTS_VIOLATED = -14
    INVALID_GROUP_NAME = -15
    INVALID_GOAL_CONSTRAINTS = -16
    INVALID_ROBOT_STATE = -17
    INVALID_LINK_NAME = -18
    INVALID_OBJECT_NAME = -19
    FRAME_TRANSFORM_FAILURE = -21
    COLLISION_CHECKING_UNAVAILABLE = -22
    ROBOT_STATE_STALE = -23
    SENSOR_INFO_STALE = -24
    COMMUNICATION_FAILURE = -25
    START_STATE_INVALID = -26
    GOAL_STATE_INVALID = -27
    UNRECOGNIZED_GOAL_TYPE = -28
    CRASH = -29
    ABORT = -30
    NO_IK_SOLUTION = -31


@dataclass(frozen=True)
class JointGoal:
    """Bring joints to positions [rad]; joints of the group that are not named keep their start position.

    Attributes:
        positions_rad: joint name -> position, met exactly where the limits allow it.
        tolerance_rad: by so much a position may lie beyond its limit; the joint then goes to the limit.
    """

    positions_rad: Mapping[str, float]
    tolerance_rad: float = 1e-4


@dataclass(frozen=True)
class PositionGoal:
    """Bring the origin of ``link`` to a point of the planning frame, whatever the orientation.

    Attributes:
        position_m: x, y, z in the robot's root link [m].
        tolerance_m: radius of the sphere around the point that counts as there [m].
    """

    link: str
    position_m: tuple[float, float, float]
    tolerance_m: float


Goal = JointGoal | PositionGoal


@dataclass(frozen=True)
class PlanningProblem:
    """One motion to plan.

    Attributes:
        group: planning group of the SRDF.
        start_rad: position of every movable joint of the robot [rad].
        velocity_scaling: share of the velocity limits to use, in (0, 1].
        acceleration_scaling: share of the acceleration limits to use, in (0, 1].
        allowed_time_s: planning time after which the answer is TIMED_OUT [s].
        attempts: how many independent searches may be made; the shortest result in time is kept.
        seed: same problem and seed, same plan.
    """

    group: str
    start_rad: Mapping[str, float]
    goal: Goal
    velocity_scaling: float = 1.0
    acceleration_scaling: float = 1.0
    allowed_time_s: float = 5.0
    attempts: int = 1
    seed: int = 0


@dataclass(frozen=True)
class Plan:
    """A motion that keeps limits and touches nothing.

    Attributes:
        method: how the path was found: "nothing to do", "straight line" or the planner's name.
        planning_time_s: time spent on it [s].
    """

    trajectory: Trajectory
    method: str
    planning_time_s: float


@dataclass(frozen=True)
class PlanningFailure:
    """Why there is no motion.

    Attributes:
        code: the value of moveit_msgs/MoveItErrorCodes that is true of the case.
        message: one sentence with the figures.
        details: what was found, as plain values: colliding pairs, joint and limit, nearest reachable point.
    """

    code: MoveItErrorCode
    message: str
    details: Mapping[str, Any] = field(default_factory=dict)

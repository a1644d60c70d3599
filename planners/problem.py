"""Requests to a planner and its answers: plain data that crosses process boundaries, without planning libraries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

from planners.goals import AnyGoal, Constraints, JointGoal, PoseGoal, PositionGoal
from planners.scene import Pose
from planners.servo.question import ServoAnswer, ServoQuestion
from robot.description.model import Joint
from robot.trajectory import Trajectory, Vector

# Searches that can be chosen by name: OMPL's, the default first. Those not here crash (AORRTC), start threads, which
# a worker that is killed at any time cannot have (PRM and its kin), or draw a fixed number of states before they begin
# and find nothing when those were too few (FMT, BFMT).
PLANNER_IDS = (
    "RRTConnect",
    "RRT",
    "RRTstar",
    "InformedRRTstar",
    "SORRTstar",
    "LBKPIECE1",
    "BKPIECE1",
    "KPIECE1",
    "BITstar",
)

VIA_POINT = "via point"  # how a motion was found where two straight lines were enough, which RRTConnect tries first


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


def planner_name(planner_id: str) -> str | None:
    """Resolve a planner's id, as "RRTConnect", "geometric::RRTConnect" or "RRTConnectkConfigDefault"; else None."""
    name = planner_id.removeprefix("geometric::").removesuffix("kConfigDefault") or PLANNER_IDS[0]
    return name if name in PLANNER_IDS else None


@dataclass(frozen=True)
class RateLimits:
    """The most that each joint may do, shape (n,) each."""

    velocity_rad_s: Vector  # above 0 [rad/s]
    acceleration_rad_s2: Vector  # above 0 [rad/s^2]
    # Above 0, infinite for joints without such a limit; None when no joint has one [rad/s^3].
    jerk_rad_s3: Vector | None = None

    @classmethod
    def of(
        cls, joints: Sequence[Joint], velocity_scaling: float = 1.0, acceleration_scaling: float = 1.0
    ) -> RateLimits:
        """Return the limits of joints, scaled by shares in (0, 1]."""
        jerks = np.array([np.inf if joint.max_jerk is None else joint.max_jerk for joint in joints])
        return cls(
            velocity_scaling * np.array([joint.max_velocity for joint in joints]),
            acceleration_scaling * np.array([joint.max_acceleration for joint in joints]),
            jerks if np.isfinite(jerks).any() else None,
        )


@dataclass(frozen=True)
class PlanningProblem:
    """One motion to plan."""

    group: str  # planning group of the SRDF
    start_rad: Mapping[str, float]  # position of every movable joint of the robot [rad]
    goal: AnyGoal
    velocity_scaling: float = 1.0  # share of the velocity limits to use, in (0, 1]
    acceleration_scaling: float = 1.0  # share of the acceleration limits to use, in (0, 1]
    allowed_time_s: float = 5.0  # planning time after which the answer is TIMED_OUT [s]
    attempts: int = 100  # number of independent searches at most; the shortest motion is taken
    seed: int = 0  # same problem and seed, same plan
    # Velocities of joints that move at the start; those not named stand still [rad/s].
    start_velocity_rad_s: Mapping[str, float] = field(default_factory=dict)
    path_constraints: Constraints | None = None  # must hold from start to end
    planner_id: str = ""  # which search to use, as planner_name knows it; empty for the default
    # Planning time to spend on shortening the motion once there is one; the allowed time or more: all that is left, in
    # as many searches as that takes [s].
    optimization_time_s: float = 0.012


@dataclass(frozen=True)
class Line:
    """The tip moves on a straight line to a pose."""

    end: Pose


@dataclass(frozen=True)
class Arc:
    """The tip moves on the circle through where it is, ``via_m`` [m] and the end's position."""

    via_m: tuple[float, float, float]
    end: Pose


@dataclass(frozen=True)
class CartesianProblem:
    """A path of the tip to follow."""

    group: str  # planning group of the SRDF
    start_rad: Mapping[str, float]  # position of every movable joint of the robot [rad]
    link: str
    segments: tuple[Line | Arc, ...]  # lines and arcs, one after the other from where the tip is
    # Whether the desired orientations must hold within `orientation_tolerance_rad`; else the position is followed and
    # the nearest orientation taken.
    keep_orientation: bool = False
    orientation_tolerance_rad: float = 0.02  # greatest rotation from the desired orientation [rad]
    max_step_m: float = 0.005  # greatest distance between the points that are solved for [m]
    # Greatest step of any joint between them, 0 for none: a greater one is a jump [rad].
    max_joint_step_rad: float = 0.0
    tip_speed_m_s: float | None = None  # greatest speed of the tip [m/s], None for as fast as the joints allow
    avoid_collisions: bool = True  # whether contacts end the path
    velocity_scaling: float = 1.0  # share of the velocity limits to use, in (0, 1]
    acceleration_scaling: float = 1.0  # share of the acceleration limits to use, in (0, 1]
    allowed_time_s: float = 5.0  # planning time after which the answer is TIMED_OUT [s]
    path_constraints: Constraints | None = None  # must hold from start to end


@dataclass(frozen=True)
class JointPathProblem:
    """A path of the joints to time and to follow, from its first point to its last; answered by :class:`Plan`."""

    # Position of every movable joint of the robot before; the path's joints do not count [rad].
    start_rad: Mapping[str, float]
    joint_names: tuple[str, ...]  # the joints of the path, which need not be one group
    time_s: Vector  # shape (n,), n >= 2, strictly increasing: when the path passes each point at speed 1 [s]
    positions_rad: Vector  # shape (n, joints), points that a natural cubic spline joins [rad]
    speed: float = 1.0  # greatest share of the path's own speed, above 0; the limits of the joints hold besides
    allowed_time_s: float = 5.0  # planning time after which the answer is TIMED_OUT [s]


@dataclass(frozen=True)
class IkQuestion:
    """Question for joint positions at which a goal holds; answered by :class:`IkAnswer`."""

    group: str  # the joints that may move
    # Position of every movable joint [rad]; the solution nearest in time to it is wanted.
    start_rad: Mapping[str, float]
    goal: AnyGoal  # what must hold
    avoid_collisions: bool = True  # whether solutions in contact count as none
    constraints: Constraints | None = None  # what must hold as well
    allowed_time_s: float = 0.05  # time after which the answer is TIMED_OUT [s]


@dataclass(frozen=True)
class NearestGoalQuestion:
    """Question for a goal to which there is a motion, in place of one to which there is none."""

    # The problem that has no plan; its goal is of joints, of a position, of a pose or a path of the tip.
    problem: PlanningProblem | CartesianProblem
    allowed_time_s: float = 0.3  # time after which none is looked for [s]
    code: MoveItErrorCode = MoveItErrorCode.GOAL_IN_COLLISION  # of its failure, by which it is known where to look


@dataclass(frozen=True)
class StateQuestion:
    """Question if a state is free, within limits, and meets constraints; answered by :class:`StateAnswer`."""

    group: str
    positions_rad: Mapping[str, float]
    constraints: Constraints | None = None


@dataclass(frozen=True)
class RecheckQuestion:
    """Question if the rest of a running motion is free in the present scene; answered by :class:`RecheckAnswer`."""

    group: str  # planning group of its joints; empty for joints that are not exactly a group's
    trajectory: Trajectory  # the motion
    others_rad: Mapping[str, float]  # position of every joint that is not in it [rad]
    from_s: float  # where in it the robot is now [s]


@dataclass(frozen=True)
class ConcurrencyQuestion:
    """Question if motions of different joints may touch, wherever each is; answered by :class:`RecheckAnswer`."""

    first: Trajectory  # a motion; the answer's `contact_s` is a time on it
    second: Trajectory  # a motion of other joints
    others_rad: Mapping[str, float]  # position of every joint that is in neither [rad]


# Requests that wait for the turns of motions, requests with an allowed time, and those for which a moving arm waits.
MotionRequest = PlanningProblem | CartesianProblem | JointPathProblem | NearestGoalQuestion
TimedRequest = MotionRequest | IkQuestion
MovingRequest = RecheckQuestion | ConcurrencyQuestion | ServoQuestion
Request = TimedRequest | StateQuestion | MovingRequest


@dataclass(frozen=True)
class PlanningFailure:
    """Reason for which there is no motion."""

    code: MoveItErrorCode  # the value of moveit_msgs/MoveItErrorCodes that is true of the case
    message: str  # one sentence with the figures
    # What was found, as plain values: colliding pairs, joint and limit, nearest reachable point.
    details: Mapping[str, Any] = field(default_factory=dict)


class PlanningError(Exception):
    """A request is refused; ``failure`` is its answer."""

    def __init__(self, failure: PlanningFailure) -> None:
        super().__init__(failure.message)
        self.failure = failure


@dataclass(frozen=True)
class Deviation:
    """Deviation of a motion's end from its goal: position [m] and rotation [rad]."""

    position_m: float = 0.0
    orientation_rad: float = 0.0


@dataclass(frozen=True)
class Plan:
    """A motion that keeps limits and touches nothing."""

    trajectory: Trajectory
    method: str  # how the path was found: "nothing to do", "straight line", "given path" or the planner's name
    planning_time_s: float  # time spent on it, by the clock of allowed times [s]
    deviation: Deviation = Deviation()  # of its end from that goal


@dataclass(frozen=True)
class CartesianPlan:
    """As much of the tip's path as can be followed."""

    trajectory: Trajectory  # the timed motion, certified as a plan's
    fraction: float  # share of the path's length that it covers, 0 to 1
    stopped_by: PlanningFailure | None  # reason for which it is not the whole; None for all of it
    planning_time_s: float  # time spent on it, by the clock of allowed times [s]
    deviation: Deviation = Deviation()  # greatest deviation of the tip from the path on the way


@dataclass(frozen=True)
class IkAnswer:
    """Configurations in which a goal holds."""

    # Every movable joint by name, one mapping a solution, least time from the start first [rad].
    positions_rad: tuple[Mapping[str, float], ...]
    deviations: tuple[Deviation, ...]  # of each solution from the goal


@dataclass(frozen=True)
class PathGoal:
    """Alternatives to a path of the tip that cannot be followed to its end; each verified by a plan."""

    end: Pose | None  # an end to which the same path can be followed, and be planned again; None when none was found
    fraction: float  # share of the path's length up to there, 0 to 1
    length_m: float  # length of the path [m]
    end_by_other_way: bool  # whether the end of the whole path is reached by a motion that does not follow it


@dataclass(frozen=True)
class NearestGoalAnswer:
    """Goal near a goal that has no plan."""

    # As near as was found, of the same kind, verified by a plan; None when none was found.
    goal: JointGoal | PositionGoal | PoseGoal | PathGoal | None


@dataclass(frozen=True)
class StateAnswer:
    """Facts about a state."""

    valid: bool  # whether nothing is wrong with it
    problems: tuple[PlanningFailure, ...]  # flaws, each with its code, sentence and data


@dataclass(frozen=True)
class RecheckAnswer:
    """Answer to a recheck of the rest of a motion: ``contact`` names the contact at ``contact_s``, else None."""

    contact: PlanningFailure | None
    contact_s: float | None = None


Answer = (
    Plan | CartesianPlan | IkAnswer | NearestGoalAnswer | StateAnswer | RecheckAnswer | ServoAnswer | PlanningFailure
)

# Class of the answer to each request that does not fail.
ANSWER_TO: Mapping[type[Request], type[Answer]] = {
    PlanningProblem: Plan,
    CartesianProblem: CartesianPlan,
    JointPathProblem: Plan,
    IkQuestion: IkAnswer,
    NearestGoalQuestion: NearestGoalAnswer,
    StateQuestion: StateAnswer,
    RecheckQuestion: RecheckAnswer,
    ConcurrencyQuestion: RecheckAnswer,
    ServoQuestion: ServoAnswer,
}

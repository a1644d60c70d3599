"""What a goal of FollowJointTrajectory or a message on ``joint_trajectory`` must be like to be taken on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.description.model import Group, RobotModel
from server.execution.motions import Positions
from server.moveit.actions.followed_goal import FollowCode, FollowedTolerances
from server.moveit.actions.given_motions import given_motion
from server.moveit.actions.tolerances import Tolerances, tolerances_of

Message: TypeAlias = Mapping[str, Any]

# Beyond this nobody waits for a joint to come nearer.
MAX_GOAL_TIME_TOLERANCE_S = 10.0


@dataclass(frozen=True)
class Refused:
    """Why a trajectory is not taken on, for the action's client and for everyone."""

    code: FollowCode
    failure: PlanningFailure


def tolerances_in(goal: Message, group: Group) -> FollowedTolerances | Refused:
    """Read the tolerances of a goal.

    Args:
        goal: of control_msgs/FollowJointTrajectory.
        group: the joints that are controlled.
    """
    found: dict[str, Tolerances] = {}
    for field in ("path_tolerance", "goal_tolerance"):
        tolerances = tolerances_of(goal[field], field, group.joints)
        if isinstance(tolerances, PlanningFailure):
            return Refused(FollowCode.INVALID_GOAL, tolerances)
        found[field] = tolerances
    time_s = _seconds(goal["goal_time_tolerance"])
    if time_s > MAX_GOAL_TIME_TOLERANCE_S:
        limit = f"goal_time_tolerance must be at most {MAX_GOAL_TIME_TOLERANCE_S:g} s, not {time_s:g} s"
        return _refused(FollowCode.INVALID_GOAL, limit)
    return FollowedTolerances(found["path_tolerance"], found["goal_tolerance"], max(time_s, 0.0))


def refusal_of(
    trajectory: Message, group: Group, robot: RobotModel, present_rad: Positions | None, now_s: float
) -> Refused | None:
    """Why a trajectory cannot be played; None when nothing speaks against it.

    Args:
        trajectory: a trajectory_msgs/JointTrajectory.
        group: the joints that are controlled.
        robot: the arm.
        present_rad: what the arm holds, None while that is not known [rad].
        now_s: wall-clock time [s].
    """
    if not trajectory["points"]:
        return _refused(FollowCode.INVALID_GOAL, "trajectory.points is empty; to stop the arm, cancel the goal")
    strange = [name for name in trajectory["joint_names"] if name not in group.joints]
    if strange:
        known = ", ".join(group.joints)
        return _refused(
            FollowCode.INVALID_JOINTS, f"trajectory.joint_names has {strange[0]!r}; the controller has {known}"
        )
    late_s = now_s - _end_s(trajectory)
    if _seconds(trajectory["header"]["stamp"]) > 0.0 and late_s > 0.0:
        return _refused(
            FollowCode.OLD_HEADER_TIMESTAMP,
            f"by trajectory.header.stamp the motion would have ended {late_s:.1f} s ago; the stamp 0 starts it now",
        )
    motion = None if present_rad is None else given_motion(trajectory, robot).trajectory(present_rad)
    if isinstance(motion, PlanningFailure):
        return Refused(FollowCode.INVALID_GOAL, motion)
    return None


def _end_s(trajectory: Message) -> float:
    """When the trajectory would end by its stamp [s since the epoch]."""
    return _seconds(trajectory["header"]["stamp"]) + _seconds(trajectory["points"][-1]["time_from_start"])


def _seconds(stamp: Message) -> float:
    return float(stamp["sec"]) + 1e-9 * float(stamp["nanosec"])


def _refused(code: FollowCode, message: str) -> Refused:
    return Refused(code, PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, message))

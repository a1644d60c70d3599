"""Motions that somebody else has planned, as motions of one of the arm's groups."""

from __future__ import annotations

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.control.checks import refusal
from robot.description.limits import JointBounds
from robot.description.model import Group, RobotModel
from robot.trajectory import Trajectory
from server.execution.motions import ExternalTrajectory, Positions
from server.moveit.actions.carrying_out import Message
from server.moveit.requests.trajectories import from_joint_trajectory


def given_motion(message: Message, robot: RobotModel) -> ExternalTrajectory:
    """A motion to play, from a trajectory_msgs/JointTrajectory.

    Joints of its group that it does not name keep the position that the arm holds.
    """

    def trajectory(held_rad: Positions) -> Trajectory | PlanningFailure:
        motion = from_joint_trajectory(message, robot, held_rad)
        if isinstance(motion, PlanningFailure):
            return motion
        group = smallest_group(robot, motion.joint_names)
        if group is None:
            return _no_group(robot, motion.joint_names)
        whole = of_group(motion, group, held_rad)
        return _beyond_limits(whole, robot) or whole

    return ExternalTrajectory(trajectory)


def smallest_group(robot: RobotModel, joint_names: tuple[str, ...]) -> Group | None:
    """The group of fewest joints that has all of these; None when there is none."""
    fitting = [group for group in robot.groups.values() if set(joint_names) <= set(group.joints)]
    return min(fitting, key=lambda group: len(group.joints), default=None)


def of_group(motion: Trajectory, group: Group, held_rad: Positions) -> Trajectory:
    """The same motion with a column for every joint of a group, those that it leaves out standing still."""
    samples = len(motion.time_s)
    columns = {name: column for column, name in enumerate(motion.joint_names)}

    def spread(array: np.ndarray, still: Positions | None) -> np.ndarray:
        return np.column_stack(
            [
                array[:, columns[name]] if name in columns else np.full(samples, still[name] if still else 0.0)
                for name in group.joints
            ]
        )

    return Trajectory(
        group.joints,
        motion.time_s,
        spread(motion.positions_rad, held_rad),
        spread(motion.velocities_rad_s, None),
        spread(motion.accelerations_rad_s2, None),
    )


def _beyond_limits(motion: Trajectory, robot: RobotModel) -> PlanningFailure | None:
    """Why the arm's driver would not play a motion from its own start."""
    bounds = JointBounds.of(robot, motion.joint_names)
    reason = refusal(motion, motion.joint_names, bounds, motion.positions_rad[0])
    return PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, reason) if reason else None


def _no_group(robot: RobotModel, joint_names: tuple[str, ...]) -> PlanningFailure:
    groups = "; ".join(f"{name}: {', '.join(group.joints)}" for name, group in robot.groups.items())
    return PlanningFailure(
        MoveItErrorCode.INVALID_MOTION_PLAN,
        f"trajectory.joint_names {list(joint_names)} are not all of one group; the groups are {groups}",
        {"joints": list(joint_names)},
    )

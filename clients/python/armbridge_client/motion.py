"""Motions and plans: results of goals, and planned trajectories to be executed."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

from armbridge_client.connection import Connection, after_stop
from armbridge_client.errors import GoalRefused
from armbridge_client.messages import (
    Duration,
    ExecuteTrajectoryGoal,
    ExecuteTrajectoryResult,
    GoalTarget,
    Header,
    JointState,
    JointTrajectoryPoint,
    MoveItErrorCode,
    MoveItErrorCodes,
    MoveitGoalResponse,
    MoveitGoalResult,
    PoseStamped,
    RobotTrajectory,
    Time,
)
from armbridge_client.wire import from_wire

MOTION_TIMEOUT_S = 60.0


@dataclasses.dataclass(frozen=True)
class Motion:
    """A motion that reached its goal: its duration as planned [s], and the server's sentence."""

    duration_s: float
    message: str


class AsyncPlan:
    """A planned motion, which has not moved anything.

    Args:
        stops: number of the server's last stop before it was planned.

    Attributes:
        trajectory: positions over time.
    """

    def __init__(self, connection: Connection, trajectory: RobotTrajectory, stops: int) -> None:
        self._connection, self._stops = connection, stops
        self.trajectory = trajectory

    @property
    def duration_s(self) -> float:
        """Duration of the motion at full speed [s]."""
        points = self.trajectory.joint_trajectory.points
        return seconds(points[-1].time_from_start) if points else 0.0

    async def execute(self, speed: float = 1.0, *, timeout_s: float = MOTION_TIMEOUT_S) -> Motion:
        """Carry out the plan; the server checks it against the present scene and position first.

        Args:
            speed: share of the planned speed, above 0 to 1.

        Raises:
            GoalRefused: the arm is elsewhere by now or was stopped since the plan began, or something is in the way.
        """
        goal = ExecuteTrajectoryGoal(slower(self.trajectory, speed))
        with after_stop(self._stops):
            values = await self._connection.perform("/execute_trajectory", goal, timeout_s)
        check_code(from_wire(ExecuteTrajectoryResult, values).error_code)
        return Motion(self.duration_s / speed, "the plan is carried out")


def slower(trajectory: RobotTrajectory, speed: float) -> RobotTrajectory:
    """Return a trajectory along the same path at a share of its speed.

    Raises:
        ValueError: the share is not above 0 to 1.
    """
    if not 0.0 < speed <= 1.0:
        raise ValueError(f"speed must be above 0 to 1, not {speed}")
    joints = trajectory.joint_trajectory
    # Along the same path at speed s, velocities scale with s, and accelerations with its square.
    points = [
        JointTrajectoryPoint(
            point.positions,
            [value * speed for value in point.velocities],
            [value * speed**2 for value in point.accelerations],
            time_from_start=duration(seconds(point.time_from_start) / speed),
        )
        for point in joints.points
    ]
    return RobotTrajectory(dataclasses.replace(joints, points=points))


def seconds(time: Duration | Time) -> float:
    """Return a duration, or a time since the epoch [s]."""
    return time.sec + 1e-9 * time.nanosec


def duration(time_s: float) -> Duration:
    """Return a duration of a time [s]."""
    return Duration(*divmod(round(1e9 * time_s), 1_000_000_000))


def stamp(time_s: float) -> Time:
    """Return a time since the epoch [s] as a stamp."""
    return Time(*divmod(round(1e9 * time_s), 1_000_000_000))


def motion_of(result: MoveitGoalResult | MoveitGoalResponse) -> Motion:
    """Return the motion of a goal that succeeded.

    Raises:
        GoalRefused: the goal failed.
    """
    if result.success:
        return Motion(result.duration_s, result.message)
    details = {pair.key: _value(pair.value) for pair in result.details}
    raise GoalRefused(result.code, result.code_name, result.message, details, _suggestion(result.suggested))


def check_code(code: MoveItErrorCodes) -> None:
    """Check an error code.

    Raises:
        GoalRefused: the code is not SUCCESS.
    """
    if code.val != MoveItErrorCode.SUCCESS:
        names = {each.value: each.name for each in MoveItErrorCode}
        raise GoalRefused(code.val, names.get(code.val, "FAILURE"), code.message, {}, None)


def _suggestion(target: GoalTarget) -> GoalTarget | None:
    """Return the goal that a result suggests, without the stamps that each message gets; None if it suggests none."""
    if target.named:
        return GoalTarget(named=target.named)
    if target.joints.name:
        return GoalTarget(joints=JointState(name=target.joints.name, position=target.joints.position))
    if target.pose.header.frame_id:
        return GoalTarget(pose=PoseStamped(Header(frame_id=target.pose.header.frame_id), target.pose.pose))
    return None


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text

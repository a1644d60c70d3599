"""moveit_msgs/RobotTrajectory and trajectory_msgs/JointTrajectory: motions in messages, there and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.problem import MoveItErrorCode
from protocol.messages import Stamp
from robot.description.model import RobotModel
from robot.trajectory import Trajectory, Vector
from server.errors import RefusedError
from server.moveit.requests.context import Message
from server.moveit.requests.monotone_spline import knot_accelerations, knot_velocities
from server.moveit.requests.refusals import refusals_as_data, refused

# Scripts that put motions together have the end of one and the begin of the next at one time, but for rounding.
SAME_TIME_S = 1e-6
SAME_POSITION_RAD = 1e-4

# Half an hour at 100 Hz, what the arm plays at most.
MAX_POINTS = 180_000


def to_message(trajectory: Trajectory | None, frame: str = "") -> dict[str, Any]:
    """The moveit_msgs/RobotTrajectory of a motion; without points for none.

    Args:
        trajectory: the motion.
        frame: the planning frame.
    """
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}
    return {
        "joint_trajectory": {
            "header": header,
            "joint_names": [] if trajectory is None else list(trajectory.joint_names),
            "points": [] if trajectory is None else _points(trajectory),
        },
        "multi_dof_joint_trajectory": {"header": header, "joint_names": [], "points": []},
    }


@refusals_as_data
def from_joint_trajectory(message: Message, robot: RobotModel, start_rad: Mapping[str, float]) -> Trajectory:
    """Read a motion that somebody else has planned.

    It may name some of the joints only. A point that repeats the one before is left out. A first point after time 0 is
    preceded by the start, at rest. Points without velocities are joined by a curve that does not overshoot them; the
    last one is at rest, whatever it says. Efforts are not heeded.

    Args:
        message: a trajectory_msgs/JointTrajectory.
        robot: the arm.
        start_rad: position of every movable joint where the motion is to begin [rad].
    """
    names, points = tuple(message["joint_names"]), _without_repeats(message["points"])
    _check_names(names, robot)
    if not 1 <= len(points) <= MAX_POINTS:
        raise _invalid(f"points has {len(points)} entries; 1 to {MAX_POINTS} are allowed")
    time_s = _times_s(points)
    positions = _array(points, "positions", len(names))
    if positions is None:
        raise _invalid("points: positions must be given")
    velocities = _array(points, "velocities", len(names))
    accelerations = _array(points, "accelerations", len(names))
    if time_s[0] > 0.0:
        time_s = np.insert(time_s, 0, 0.0)
        positions = np.vstack(([start_rad[name] for name in names], positions))
        velocities, accelerations = (_after_rest(array) for array in (velocities, accelerations))
    return _to_rest(names, time_s, positions, velocities, accelerations)


def _to_rest(
    names: tuple[str, ...], time_s: Vector, positions: Vector, velocities: Vector | None, accelerations: Vector | None
) -> Trajectory:
    """The motion, with what the message leaves out, ending at rest."""
    if velocities is None:
        velocities = knot_velocities(time_s, positions)
    if np.any(velocities[-1] != 0.0):
        velocities, accelerations = np.vstack((velocities[:-1], np.zeros(len(names)))), None
    if accelerations is None:
        accelerations = knot_accelerations(time_s, positions, velocities)
    return Trajectory(names, time_s, positions, velocities, accelerations)


def _points(trajectory: Trajectory) -> list[dict[str, Any]]:
    return [
        {
            "positions": positions,
            "velocities": velocities,
            "accelerations": accelerations,
            "effort": [],
            "time_from_start": Stamp.from_seconds(time_s).as_message(),
        }
        for time_s, positions, velocities, accelerations in zip(
            trajectory.time_s.tolist(),
            trajectory.positions_rad.tolist(),
            trajectory.velocities_rad_s.tolist(),
            trajectory.accelerations_rad_s2.tolist(),
            strict=True,
        )
    ]


def _check_names(names: tuple[str, ...], robot: RobotModel) -> None:
    if not names:
        raise _invalid("joint_names is empty")
    for name in names:
        if name not in robot.joints or not robot.joints[name].movable:
            known = ", ".join(joint.name for joint in robot.movable_joints)
            raise _invalid(f"joint_names has the unknown joint {name!r}; there are: {known}", joint=name)
        if names.count(name) > 1:
            raise _invalid(f"joint_names has {name!r} more than once", joint=name)


def _without_repeats(points: list[Message]) -> list[Message]:
    """The points without those that say again where and when the one before is."""
    return [point for index, point in enumerate(points) if index == 0 or not _is_repeated(points[index - 1], point)]


def _is_repeated(before: Message, point: Message) -> bool:
    if abs(_time_s(point) - _time_s(before)) > SAME_TIME_S or len(before["positions"]) != len(point["positions"]):
        return False
    pairs = zip(before["positions"], point["positions"], strict=True)
    return all(abs(one - other) <= SAME_POSITION_RAD for one, other in pairs)


def _time_s(point: Message) -> float:
    stamp = point["time_from_start"]
    return float(stamp["sec"] + 1e-9 * stamp["nanosec"])


def _times_s(points: list[Message]) -> Vector:
    time_s = np.array([_time_s(point) for point in points])
    if time_s[0] < 0.0:
        raise _invalid(f"points[0].time_from_start must be 0 s or more, not {time_s[0]:g}", index=0)
    late = np.flatnonzero(np.diff(time_s) <= 0.0)
    if late.size:
        index = int(late[0]) + 1
        raise _invalid(
            f"points[{index}].time_from_start, {time_s[index]:g} s, must be after that of the point before,"
            f" {time_s[index - 1]:g} s",
            index=index,
        )
    return time_s


def _array(points: list[Message], field: str, width: int) -> Vector | None:
    """One field of all points, shape (n, joints); None where not every point has it."""
    for index, point in enumerate(points):
        if point[field] and len(point[field]) != width:
            raise _invalid(f"points[{index}].{field} has {len(point[field])} values for {width} joints", index=index)
    if not all(point[field] for point in points):
        return None
    array = np.array([point[field] for point in points], dtype=float)
    wrong = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if wrong.size:
        raise _invalid(f"points[{wrong[0]}].{field} has a value that is not a finite number", index=int(wrong[0]))
    return array


def _after_rest(array: Vector | None) -> Vector | None:
    return None if array is None else np.vstack((np.zeros(array.shape[1]), array))


def _invalid(message: str, **details: Any) -> RefusedError:
    return refused(MoveItErrorCode.INVALID_MOTION_PLAN, f"trajectory.{message}", **details)

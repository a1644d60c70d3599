"""Trajectories in messages: moveit_msgs/RobotTrajectory written, trajectory_msgs/JointTrajectory read."""

import asyncio
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from ruckig import RuckigError

from robot.description.limits import JointBounds, motion_limits
from robot.description.model import Group, RobotModel
from robot.trajectory import VELOCITY_TOLERANCE, Trajectory, Vector, bridge, refusal
from server.errors import RefusedError, invalid, invalid_plan
from server.execution.motions import ExternalTrajectory, Positions, SplicePoint, start_of
from server.moveit.messages import Message

Written = TypeVar("Written")

NANOSECONDS_PER_S = 1_000_000_000

# Scripts that join motions repeat the end of one as the start of the next, equal within rounding.
SAME_TIME_S = 1e-6
SAME_POSITION_RAD = 1e-4

# A hundred seconds at 100 Hz, ten minutes at 16 Hz. They are read and checked in 20 ms.
MAX_POINTS = 10_000

# Points that are written at once: ten seconds of a motion, in 4 ms. Half an hour of it takes 0.6 s.
POINTS_AT_ONCE = 1000


def read_seconds(message: Message, where: str) -> float:
    """Read a builtin_interfaces/Duration or Time [s]."""
    nanosec: int = message["nanosec"]
    if nanosec >= NANOSECONDS_PER_S:
        raise invalid(f"{where}.nanosec must be below {NANOSECONDS_PER_S}, not {nanosec}", field=f"{where}.nanosec")
    return float(message["sec"]) + nanosec / NANOSECONDS_PER_S


def to_message(trajectory: Trajectory | None, frame: str) -> dict[str, Any]:
    """Write a moveit_msgs/RobotTrajectory."""
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}
    return {
        "joint_trajectory": {
            "header": header,
            "joint_names": [] if trajectory is None else list(trajectory.joint_names),
            "points": [] if trajectory is None else _points(trajectory),
        },
        "multi_dof_joint_trajectory": {"header": header, "joint_names": [], "points": []},
    }


def is_long(trajectories: Sequence[Trajectory]) -> bool:
    """Return True for motions that take longer to write than everybody may be kept waiting."""
    return sum(len(each.time_s) for each in trajectories) > POINTS_AT_ONCE


async def to_messages(trajectories: Sequence[Trajectory], frame: str) -> list[Message]:
    """Write moveit_msgs/RobotTrajectory messages; a thread writes long motions."""
    return await written(trajectories, lambda: [to_message(each, frame) for each in trajectories])


async def written(trajectories: Sequence[Trajectory], write: Callable[[], Written]) -> Written:
    """Write something of motions; a thread writes long ones."""
    return await asyncio.to_thread(write) if is_long(trajectories) else write()


@dataclass(frozen=True)
class TrajectoryTiming:
    """Time of a client's trajectory, and limits of the way to its first point."""

    begins_s: float  # monotonic time of its time 0, by its stamp or of its arrival [s]
    stamped: bool  # True where the client has chosen that time
    bridged: bool  # True to take the first point later where the limits do not allow it in time; else it is refused
    speed_limit: float  # share of the velocity limits for the way to the first point
    rate: float = 1.0  # time by the arm's clock per time of the machine


def external_motion(message: Message, robot: RobotModel, timing: TrajectoryTiming | None = None) -> ExternalTrajectory:
    """Make the motion of a trajectory_msgs/JointTrajectory; without a timing it begins at rest, when its turn comes."""
    names = tuple(message["joint_names"])
    group = smallest_group(robot, names)
    joints = frozenset(names if group is None else group.joints)

    def make(held_rad: Positions, at_s: float, point: SplicePoint | None) -> Trajectory:
        if timing is None:
            return external_trajectory(message, robot, held_rad)
        last = message["points"][-1]["time_from_start"]
        # The first point of a trajectory with one point at time 0 is reached as fast as the limits allow.
        immediate = timing.bridged and len(message["points"]) == 1 and not any(last.values())
        if point is None and not timing.stamped and not immediate:
            try:
                return external_trajectory(message, robot, held_rad)
            except RefusedError:
                if not timing.bridged:
                    raise
            at_s = timing.begins_s
        passed_s = (at_s - timing.begins_s) * timing.rate
        return _joined_trajectory(message, robot, held_rad, passed_s, point, timing.speed_limit)

    return ExternalTrajectory(make, joints, spliced=timing is not None)


def _joined_trajectory(
    message: Message,
    robot: RobotModel,
    held_rad: Positions,
    passed_s: float,
    point: SplicePoint | None,
    speed_limit: float,
) -> Trajectory:
    """Join the state at the start and the points of a trajectory_msgs/JointTrajectory that are still to come.

    Points whose time has passed are dropped, except the last, as in ros2_control's joint_trajectory_controller, which
    jumps where this moves within the limits: the first point is reached in time or, where the limits do not allow
    that, later, and the others as much later. Joints of the group that it does not name come to rest.
    https://control.ros.org/rolling/doc/ros2_controllers/joint_trajectory_controller/doc/trajectory.html
    """
    names, time_s, positions, velocities = read_points(message, robot)[:4]
    group = _group_of(robot, names)
    columns, bounds = np.array([group.joints.index(name) for name in names]), JointBounds.of(robot, group.joints)
    first = min(int(np.searchsorted(time_s, passed_s, side="right")), len(time_s) - 1)
    time_s, positions = np.maximum(time_s[first:] - passed_s, 0.0), positions[first:]
    still, start = np.zeros(len(group.joints)), start_of(group.joints, held_rad, point)
    if velocities is None and time_s[0] > 0.0:
        here = start[0][columns]
        velocities = knot_velocities(np.insert(time_s, 0, 0.0), np.vstack((here, positions)))[1:]
    else:
        velocities = np.zeros_like(positions) if velocities is None else velocities[first:].copy()
    velocities[-1] = 0.0
    end, end_velocity = np.full(len(still), np.nan), still.copy()
    end[columns], end_velocity[columns] = positions[0], velocities[0]
    limits = motion_limits(robot, group.joints, speed_limit)
    try:
        way = bridge(group.joints, start, (end, end_velocity), limits, float(time_s[0]))
    except (RuckigError, ValueError) as error:
        # A ValueError is a result that the bindings do not know, as of a motion that takes too long.
        text = f"points[{first}] cannot be reached from where the joints are: {error}"
        raise _invalid(text, index=first) from error
    if len(time_s) == 1:
        joined = way
    else:
        wide = np.repeat(way.positions_rad[-1:], len(time_s) - 1, axis=0), np.zeros((len(time_s) - 1, len(still)))
        wide[0][:, columns], wide[1][:, columns] = positions[1:], velocities[1:]
        joined_s = np.concatenate((way.time_s, time_s[1:] - time_s[0] + way.duration_s))
        joined_rad = np.vstack((way.positions_rad, wide[0]))
        joined_rad_s = np.vstack((way.velocities_rad_s, wide[1]))
        accelerations = knot_accelerations(joined_s, joined_rad, joined_rad_s)
        joined = Trajectory(group.joints, joined_s, joined_rad, joined_rad_s, accelerations)
    if reason := refusal(joined, group.joints, bounds, start[0], in_motion=True):
        raise invalid_plan(reason)
    return joined


def external_trajectory(message: Message, robot: RobotModel, held_rad: Positions) -> Trajectory:
    """Read a trajectory_msgs/JointTrajectory as a trajectory of one of the arm's groups, and check it for the arm.

    Joints of the group that it does not name keep the position that the arm holds.
    """
    named = read_joint_trajectory(message, robot, held_rad)
    trajectory = for_group(named, _group_of(robot, named.joint_names), held_rad)
    bounds = JointBounds.of(robot, trajectory.joint_names)
    reason = refusal(trajectory, trajectory.joint_names, bounds, trajectory.positions_rad[0])
    if reason:
        raise invalid_plan(reason)
    return trajectory


def _group_of(robot: RobotModel, joint_names: tuple[str, ...]) -> Group:
    group = smallest_group(robot, joint_names)
    if group is None:
        groups = "; ".join(f"{name}: {', '.join(group.joints)}" for name, group in robot.groups.items())
        joints = list(joint_names)
        raise _invalid(f"joint_names {joints} are not all of one group; the groups are {groups}", joints=joints)
    return group


def check_speed(trajectory: Trajectory, robot: RobotModel, limit: float) -> None:
    """Check a trajectory against the arm's speed limit, with the tolerance that plans have."""
    for name, speed_rad_s in zip(trajectory.joint_names, trajectory.peak_speed_rad_s.tolist(), strict=True):
        limit_rad_s = limit * robot.joints[name].max_velocity
        if speed_rad_s > limit_rad_s * VELOCITY_TOLERANCE:
            unit = f"{robot.joints[name].unit}/s"
            raise _invalid(
                f"points move joint {name} at {speed_rad_s:.3g} {unit}, above {limit_rad_s:.3g} {unit}, the speed limit"
                f" of {limit:g} times its velocity limit; moveit.faster_trajectories = slow plays it slower",
                joint=name,
                speed_rad_s=speed_rad_s,
                limit_rad_s=limit_rad_s,
            )


def smallest_group(robot: RobotModel, joint_names: tuple[str, ...]) -> Group | None:
    """Return the group of fewest joints that has all of these; None if there is none."""
    fitting = [group for group in robot.groups.values() if set(joint_names) <= set(group.joints)]
    return min(fitting, key=lambda group: len(group.joints), default=None)


def for_group(trajectory: Trajectory, group: Group, held_rad: Positions) -> Trajectory:
    """Extend a trajectory to every joint of a group; those that it leaves out stand still."""
    positions = np.tile([held_rad[name] for name in group.joints], (len(trajectory.time_s), 1))
    arrays = positions, np.zeros_like(positions), np.zeros_like(positions)
    own = trajectory.positions_rad, trajectory.velocities_rad_s, trajectory.accelerations_rad_s2
    for array, given in zip(arrays, own, strict=True):
        array[:, [group.joints.index(name) for name in trajectory.joint_names]] = given
    return Trajectory(group.joints, trajectory.time_s, *arrays)


def read_joint_trajectory(message: Message, robot: RobotModel, start_rad: Mapping[str, float]) -> Trajectory:
    """Read a trajectory_msgs/JointTrajectory, which may name only some of the joints.

    A point that repeats the one before is dropped. A first point after time 0 is preceded by the start, at rest.
    Points without velocities are joined by a monotone cubic spline. The last point is at rest, whatever its velocity.
    Efforts are ignored.
    """
    names, time_s, positions, velocities, accelerations = read_points(message, robot)
    if time_s[0] > 0.0:
        time_s = np.insert(time_s, 0, 0.0)
        positions = np.vstack(([start_rad[name] for name in names], positions))
        rest = np.zeros(len(names))
        velocities, accelerations = (
            None if array is None else np.vstack((rest, array)) for array in (velocities, accelerations)
        )
    if velocities is None:
        velocities = knot_velocities(time_s, positions)
    if np.any(velocities[-1] != 0.0):
        velocities, accelerations = np.vstack((velocities[:-1], np.zeros(len(names)))), None
    if accelerations is None:
        accelerations = knot_accelerations(time_s, positions, velocities)
    return Trajectory(names, time_s, positions, velocities, accelerations)


def read_points(
    message: Message, robot: RobotModel
) -> tuple[tuple[str, ...], Vector, Vector, Vector | None, Vector | None]:
    """Read joint names, times, positions, velocities and accelerations; None for the last two where a point lacks them.

    A point that repeats the one before is dropped.
    """
    names, points = tuple(message["joint_names"]), message["points"]
    _check_names(names, robot)
    if not 1 <= len(points) <= MAX_POINTS:
        raise _invalid(f"points has {len(points)} entries; 1 to {MAX_POINTS} are allowed")
    time_s = _times_s(points)
    positions = _array(points, "positions", len(names))
    if positions is None:
        raise _invalid("points: positions must be given")
    velocities = _array(points, "velocities", len(names))
    accelerations = _array(points, "accelerations", len(names))
    # A point that repeats time and positions of the one before is left out.
    same_time = np.abs(np.diff(time_s)) <= SAME_TIME_S
    same_positions = np.all(np.abs(np.diff(positions, axis=0)) <= SAME_POSITION_RAD, axis=1)
    kept = np.concatenate(([0], 1 + np.flatnonzero(~(same_time & same_positions))))
    _check_times(time_s, kept)
    time_s, positions = time_s[kept], positions[kept]
    velocities, accelerations = (None if array is None else array[kept] for array in (velocities, accelerations))
    return names, time_s, positions, velocities, accelerations


def _points(trajectory: Trajectory) -> list[dict[str, Any]]:
    seconds, nanoseconds = np.divmod(np.rint(trajectory.time_s * NANOSECONDS_PER_S).astype(np.int64), NANOSECONDS_PER_S)
    return [
        {
            "positions": positions,
            "velocities": velocities,
            "accelerations": accelerations,
            "effort": [],
            "time_from_start": {"sec": sec, "nanosec": nanosec},
        }
        for sec, nanosec, positions, velocities, accelerations in zip(
            seconds.tolist(),
            nanoseconds.tolist(),
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


def _times_s(points: list[Message]) -> Vector:
    durations = [point["time_from_start"] for point in points]
    seconds = np.fromiter((duration["sec"] for duration in durations), np.float64, len(points))
    nanoseconds = np.fromiter((duration["nanosec"] for duration in durations), np.float64, len(points))
    wrong = np.flatnonzero(nanoseconds >= NANOSECONDS_PER_S)
    if wrong.size:
        index = int(wrong[0])
        found = f"must be below {NANOSECONDS_PER_S}, not {durations[index]['nanosec']}"
        raise _invalid(f"points[{index}].time_from_start.nanosec {found}", index=index)
    return seconds + 1e-9 * nanoseconds


def _check_times(time_s: Vector, kept: Vector) -> None:
    if time_s[0] < 0.0:
        raise _invalid(f"points[0].time_from_start must be 0 s or more, not {time_s[0]:g}", index=0)
    late = np.flatnonzero(np.diff(time_s[kept]) <= 0.0)
    if late.size:
        before, index = (int(each) for each in kept[late[0] : late[0] + 2])
        raise _invalid(
            f"points[{index}].time_from_start, {time_s[index]:g} s, must be after the time of the point before,"
            f" {time_s[before]:g} s",
            index=index,
        )


def _array(points: list[Message], field: str, width: int) -> Vector | None:
    """Read one field of all points, shape (n, joints); None if a point lacks it."""
    lists = [point[field] for point in points]
    lengths = set(map(len, lists))
    if lengths - {0, width}:
        index = next(index for index, values in enumerate(lists) if len(values) not in (0, width))
        raise _invalid(f"points[{index}].{field} has {len(lists[index])} values for {width} joints", index=index)
    if 0 in lengths:
        return None
    array = np.fromiter(itertools.chain.from_iterable(lists), np.float64, width * len(points)).reshape(-1, width)
    wrong = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if wrong.size:
        raise _invalid(f"points[{wrong[0]}].{field} has a value that is not a finite number", index=int(wrong[0]))
    return array


def _invalid(message: str, **details: Any) -> RefusedError:
    return invalid_plan(f"trajectory.{message}", **details)


def knot_velocities(time_s: Vector, positions_rad: Vector) -> Vector:
    """Return the velocities of a monotone cubic spline at its knots, shape (n, joints) [rad/s].

    They are zero at the ends and where a joint reverses. Unlike a spline with continuous accelerations, this one never
    overshoots its knots, so it keeps position limits that they keep. Source: Fritsch and Butland, A Method for
    Constructing Local Monotone Piecewise Cubic Interpolants, SIAM J. Sci. Stat. Comput. 5 (1984).

    Args:
        time_s: shape (n,), increasing [s].
        positions_rad: shape (n, joints) [rad].
    """
    velocities = np.zeros_like(positions_rad)
    spans = np.diff(time_s)[:, np.newaxis]
    slopes = np.diff(positions_rad, axis=0) / spans
    before, after = slopes[:-1], slopes[1:]
    # Weighted harmonic mean of the two slopes, with more weight for the shorter span.
    weight_before, weight_after = 2.0 * spans[1:] + spans[:-1], spans[1:] + 2.0 * spans[:-1]
    onward = before * after > 0.0
    # Beside a slope of 1 rad/s, one of 1e-310 rad/s makes a quotient infinite; the velocity is then 0, as it should be.
    with np.errstate(over="ignore"):
        weighted = np.divide(weight_before, before, where=onward, out=np.ones_like(before))
        weighted += np.divide(weight_after, after, where=onward, out=np.ones_like(after))
    velocities[1:-1] = np.where(onward, (weight_before + weight_after) / weighted, 0.0)
    return velocities


def knot_accelerations(time_s: Vector, positions_rad: Vector, velocities_rad_s: Vector) -> Vector:
    """Return the mean acceleration before and after each knot of a cubic spline, shape (n, joints) [rad/s^2]."""
    accelerations = np.zeros_like(positions_rad)
    spans = np.diff(time_s)[:, np.newaxis]
    slopes = np.diff(positions_rad, axis=0) / spans
    first, last = velocities_rad_s[:-1], velocities_rad_s[1:]
    starts = (6.0 * slopes - 4.0 * first - 2.0 * last) / spans
    ends = (2.0 * first + 4.0 * last - 6.0 * slopes) / spans
    accelerations[:-1] += 0.5 * starts
    accelerations[1:] += 0.5 * ends
    if len(time_s) > 1:
        accelerations[0] *= 2.0
        accelerations[-1] *= 2.0
    return accelerations

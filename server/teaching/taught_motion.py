"""Motions as they are taught: points over time, made from a recording by pure functions, and their messages."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from planners.motions.spline import NaturalSpline
from planners.problem import JointPathProblem
from protocol.messages import Stamp
from robot.description.model import RobotModel
from robot.trajectory import Trajectory, Vector
from server.errors import ServiceError, invalid
from server.execution.motions import Positions
from server.moveit.messages import Message
from server.moveit.trajectories import MAX_POINTS, read_joint_trajectory
from server.named_files import NamedFiles

# A joint that has moved by less rests: a hand trembles, and gears have play.
REST_RAD = 0.01

# Rest that is kept before and after a motion.
KEPT_REST_S = 0.2

# As long as the longest motion that is played unless goals.max_trajectory_duration_s says otherwise.
MAX_DURATION_S = 600.0

# Twice as fast as a hand: beyond, nobody has seen the motion.
MAX_SPEED = 2.0

# Shorter motions are a slip of a finger.
MIN_DURATION_S = 0.1

# Greatest distance between a joint of the motion and of the recording at the same time; a hand is no steadier.
TOLERANCE_RAD = 0.02

# Part of it for the average; the spline through some of its points has the rest.
SMOOTHED_WITHIN_RAD = 0.75 * TOLERANCE_RAD

# Window of the moving average and distance of the points [s], the smoothest first. The last is the recording itself.
SMOOTHINGS = ((0.4, 0.1), (0.2, 0.1), (0.1, 0.04), (0.06, 0.04), (0.04, 0.02), (0.0, 0.02))

# Time over which one window goes over into another [s].
BLEND_S = 0.2

# The recording is brought to the rate of the arm's states before it is averaged.
GRID_S = 0.02

# A replay counts as slower when it takes longer than requested by both: a time [s], and a share of the motion's.
LEAST_LOST_S, LEAST_LOST = 0.3, 0.05

# Digits of times and positions in files and messages: microseconds, and a thousandth of a servo's tick.
DIGITS = 6


@dataclass(frozen=True)
class TaughtMotion:
    """Points of some joints over time, which a natural cubic spline joins."""

    joint_names: tuple[str, ...]
    time_s: Vector  # shape (n,), n >= 2, strictly increasing from 0 [s]
    positions_rad: Vector  # shape (n, joints) [rad]

    @property
    def duration_s(self) -> float:
        """Time from the first point to the last, as taught [s]."""
        return float(self.time_s[-1])

    @property
    def start_rad(self) -> dict[str, float]:
        """Positions of its joints at the first point [rad]."""
        return dict(zip(self.joint_names, self.positions_rad[0].tolist(), strict=True))

    def at(self, time_s: Vector) -> Vector:
        """Return the positions at some times, shape (k, joints) [rad]."""
        return NaturalSpline(self.time_s, self.positions_rad)(time_s)

    def reversed(self) -> TaughtMotion:
        return TaughtMotion(self.joint_names, (self.time_s[-1] - self.time_s)[::-1], self.positions_rad[::-1])

    def part(self, from_s: float, to_s: float) -> TaughtMotion:
        if not 0.0 <= from_s < to_s <= self.duration_s + 10.0**-DIGITS:
            raise ServiceError(
                f"from_s and to_s: must be 0 to {self.duration_s:g} s, from_s before to_s, not {from_s:g} and {to_s:g}"
            )
        to_s = min(to_s, self.duration_s)
        if to_s - from_s < MIN_DURATION_S:
            raise ServiceError(f"to_s: must be {MIN_DURATION_S:g} s or more after from_s, not {to_s - from_s:g} s")
        # A point beside an end would bend the spline there.
        inside = (self.time_s > from_s + GRID_S / 2.0) & (self.time_s < to_s - GRID_S / 2.0)
        time_s = np.concatenate(([from_s], self.time_s[inside], [to_s]))
        ends = self.at(np.array([from_s, to_s]))
        positions = np.vstack((ends[:1], self.positions_rad[inside], ends[1:]))
        return rounded(TaughtMotion(self.joint_names, time_s - from_s, positions))

    def slowed(self, speed: float, replay: Trajectory, robot: RobotModel) -> str:
        """Describe where a replay, timed by planners, is slower than asked for; empty where it is not.

        It names the second of the motion that takes longest, and the joint that would need most of its limits there.
        """
        lost_s = replay.duration_s - self.duration_s / speed
        if lost_s < max(LEAST_LOST_S, LEAST_LOST * self.duration_s):
            return ""
        grid_s = np.linspace(0.0, self.duration_s, max(2, math.ceil(self.duration_s / GRID_S) + 1))
        # Both go the same way: a point of the motion is where the replay has gone the same share of it.
        taught, replayed = (_share_of_way(positions) for positions in (self.at(grid_s), replay.positions_rad))
        reached_s = np.interp(taught, replayed, replay.time_s)
        window = max(1, round(BLEND_S / GRID_S))
        took_s = reached_s[window:] - reached_s[:-window] if len(grid_s) > window else reached_s[-1:] - reached_s[:1]
        slowest = int(np.argmax(took_s))
        # The replay brakes ahead of the place that the limits slow.
        path, at_s = NaturalSpline(self.time_s, self.positions_rad), grid_s[max(slowest - window, 0) :][: 3 * window]
        joints = [robot.joints[name] for name in self.joint_names]
        # Velocity and acceleration at the speed that was asked for, as shares of the limits.
        demands = (
            speed * path(at_s, 1) / np.array([joint.max_velocity for joint in joints]),
            speed**2 * path(at_s, 2) / np.array([joint.max_acceleration for joint in joints]),
        )
        kind, when, column = np.unravel_index(int(np.argmax(np.abs(demands))), np.shape(demands))
        return (
            f"{lost_s:.2f} s longer than asked for, most of all at {at_s[when]:.2f} s of the motion, where joint "
            f"{self.joint_names[column]} would need {abs(demands[kind][when, column]):.1f} times its "
            f"{('velocity', 'acceleration')[kind]} limit"
        )

    def problem(self, before_rad: Positions, speed: float, allowed_time_s: float) -> JointPathProblem:
        return JointPathProblem(
            before_rad, self.joint_names, self.time_s, self.positions_rad, speed, allowed_time_s=allowed_time_s
        )


def read_speed(value: float) -> float:
    """Return the share of a motion's own speed that a client asks for; 1 for 0, as when it is left out."""
    speed = value or 1.0
    if not (math.isfinite(speed) and 0.0 < speed <= MAX_SPEED):
        raise invalid(f"speed: must be above 0 and at most {MAX_SPEED:g}, not {speed:g}", speed=str(speed))
    return speed


def rounded(motion: TaughtMotion) -> TaughtMotion:
    """Return the motion with as many digits as files and messages have."""
    return TaughtMotion(motion.joint_names, np.round(motion.time_s, DIGITS), np.round(motion.positions_rad, DIGITS))


def of_recording(
    joint_names: Sequence[str], time_s: Vector, positions_rad: Vector, robot: RobotModel
) -> tuple[TaughtMotion, float]:
    """Make a motion of a recording: without the rests at its ends, smoothed, within the position limits.

    Args:
        time_s: shape (n,), strictly increasing [s].
        positions_rad: shape (n, joints), as recorded [rad].

    Returns:
        The motion, and its greatest distance from the recording within the limits, joint by joint at the same time
        [rad]: at most :data:`TOLERANCE_RAD`, unless the recording is as long and as fast as hands hardly are.
    """
    joints = [robot.joints[name] for name in joint_names]
    lower, upper = np.array([joint.lower for joint in joints]), np.array([joint.upper for joint in joints])
    first, last = moving(time_s, positions_rad)
    time_s, positions = time_s[first : last + 1] - time_s[first], np.clip(positions_rad[first : last + 1], lower, upper)
    for levels in range(len(SMOOTHINGS), 0, -1):
        motion = smoothed(tuple(joint_names), time_s, positions, SMOOTHINGS[:levels])
        if len(motion.time_s) <= MAX_POINTS:
            break
    motion = rounded(TaughtMotion(motion.joint_names, motion.time_s, np.clip(motion.positions_rad, lower, upper)))
    return motion, float(np.max(np.abs(motion.at(np.minimum(time_s, motion.duration_s)) - positions)))


def moving(time_s: Vector, positions_rad: Vector) -> tuple[int, int]:
    """Return the first and the last sample of a recording that belong to its motion, with a short rest at both ends."""
    if len(time_s) < 2:
        raise ServiceError("nothing was recorded: no state of the arm came")
    away = np.max(np.abs(positions_rad - positions_rad[0]), axis=1)
    left = np.flatnonzero(away > REST_RAD)
    if not left.size:
        raise ServiceError(f"nothing has moved: every joint stayed within {REST_RAD:g} rad, {away.max():.4f} at most")
    still_away = np.flatnonzero(np.max(np.abs(positions_rad - positions_rad[-1]), axis=1) > REST_RAD)
    # A motion that comes back to where it began has an end all the same.
    arrived = int(still_away[-1]) + 1 if still_away.size else len(time_s) - 1
    first = int(np.searchsorted(time_s, time_s[left[0]] - KEPT_REST_S))
    last = int(np.searchsorted(time_s, time_s[arrived] + KEPT_REST_S, side="right")) - 1
    if time_s[last] - time_s[first] < MIN_DURATION_S:
        raise ServiceError(f"the motion must last {MIN_DURATION_S:g} s or more, not {time_s[last] - time_s[first]:g} s")
    return first, last


def smoothed(
    joint_names: tuple[str, ...], time_s: Vector, positions_rad: Vector, smoothings: Sequence[tuple[float, float]]
) -> TaughtMotion:
    """Average over windows twice, which leaves no step in the velocity, and keep some of the points.

    At each time the longest window counts that leaves every joint within the tolerance, so that one abrupt start
    leaves the rest of the motion smooth. Where none does, the last one counts.

    Args:
        time_s: shape (n,), strictly increasing from 0 [s].
        positions_rad: shape (n, joints) [rad].
        smoothings: windows and distances of the points [s], the smoothest first.
    """
    count = max(2, math.ceil(time_s[-1] / GRID_S) + 1)
    grid_s = np.linspace(0.0, time_s[-1], count)
    recorded = np.column_stack([np.interp(grid_s, time_s, column) for column in positions_rad.T])
    half_blend = round(BLEND_S / GRID_S / 2.0)
    averages, unused = [], np.ones(count, dtype=bool)
    shares = np.zeros((len(smoothings), count))
    spacing_s = np.full(count, smoothings[-1][1])
    for level, (window_s, distance_s) in enumerate(smoothings):
        half = round(window_s / GRID_S / 2.0)
        average = np.column_stack([_average(_average(column, half), half) for column in recorded.T])
        averages.append(average)
        beyond = np.max(np.abs(average - recorded), axis=1) > SMOOTHED_WITHIN_RAD
        # A window counts where it also does during the blend to its neighbours.
        used = unused & ~(_average(beyond.astype(float), half_blend) > 0.0)
        if level == len(smoothings) - 1:
            used = unused
        shares[level] = _average(used.astype(float), half_blend)
        spacing_s[used] = distance_s
        unused = unused & ~used
    kept = [0]
    while kept[-1] < count - 1:
        steps = max(1, round(float(spacing_s[kept[-1] : kept[-1] + half_blend].min()) / GRID_S))
        kept.append(min(kept[-1] + steps, count - 1))
    mean = np.einsum("lt,ltj->tj", shares, np.array(averages))
    return TaughtMotion(joint_names, grid_s[kept], mean[kept])


def _share_of_way(positions_rad: Vector) -> Vector:
    way = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(positions_rad, axis=0)).sum(axis=1))))
    share: Vector = way / max(way[-1], 1e-9)
    return share


def _average(column: Vector, half: int) -> Vector:
    """Return the mean of each value with `half` values on both sides; the ends go on as they end."""
    padded = np.pad(column, half, mode="edge")
    sums = np.concatenate(([0.0], np.cumsum(padded)))
    width = 2 * half + 1
    mean: Vector = (sums[width:] - sums[:-width]) / width
    return mean


# Messages.


def from_message(message: Message, robot: RobotModel) -> TaughtMotion:
    """Read a trajectory_msgs/JointTrajectory; velocities and accelerations do not count."""
    points = message["points"]
    # A first point after time 0 is waited for, where it is.
    start_rad = dict(zip(message["joint_names"], points[0]["positions"] if points else (), strict=False))
    trajectory = read_joint_trajectory(message, robot, start_rad)
    if len(trajectory.time_s) < 2:
        raise ServiceError(f"trajectory.points: must be 2 or more at different times, not {len(trajectory.time_s)}")
    if not MIN_DURATION_S <= trajectory.duration_s <= MAX_DURATION_S:
        limits = f"{MIN_DURATION_S:g} to {MAX_DURATION_S:g} s"
        raise ServiceError(f"trajectory.points: must last {limits}, not {trajectory.duration_s:g} s")
    return rounded(TaughtMotion(trajectory.joint_names, trajectory.time_s, trajectory.positions_rad))


def to_message(motion: TaughtMotion) -> dict[str, Any]:
    """Write a trajectory_msgs/JointTrajectory of positions alone."""
    none: dict[str, list[float]] = {"velocities": [], "accelerations": [], "effort": []}
    return {
        "header": {"stamp": Stamp(0, 0).as_message(), "frame_id": ""},
        "joint_names": list(motion.joint_names),
        "points": [
            {"positions": positions, **none, "time_from_start": Stamp.from_seconds(time_s).as_message()}
            for time_s, positions in zip(motion.time_s.tolist(), motion.positions_rad.tolist(), strict=True)
        ],
    }


# As many as a list shows that people read.
MAX_MOTIONS = 100

# The points of forty joints as text; of six joints they have 0.8 MB.
MAX_FILE_BYTES = 8_000_000


class _Content(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    joint_names: list[str] = Field(min_length=1)
    time_s: list[float] = Field(min_length=2, max_length=MAX_POINTS)
    positions_rad: list[list[float]]


class MotionFiles(NamedFiles):
    """Store of motions by name."""

    def __init__(self, folder: Path, robot: RobotModel) -> None:
        super().__init__(folder, "motion", MAX_MOTIONS)
        self._robot = robot

    async def load(self, name: str) -> TaughtMotion:
        return await self.read(name, self._read)

    async def save(self, name: str, motion: TaughtMotion) -> None:
        def content() -> bytes:
            fields = {
                "joint_names": list(motion.joint_names),
                "time_s": motion.time_s.tolist(),
                "positions_rad": motion.positions_rad.tolist(),
            }
            text = json.dumps(fields, separators=(",", ":")).encode()
            if len(text) > MAX_FILE_BYTES:
                raise ValueError(f"it has {len(text)} bytes as a file, the limit is {MAX_FILE_BYTES}")
            return text

        await self.write(name, content)

    def _read(self, path: Path) -> TaughtMotion:
        with path.open("rb") as file:
            text = file.read(MAX_FILE_BYTES + 1)
        try:
            content = _Content.model_validate_json(text)
        except ValidationError as error:
            raise ValueError(f"{path} holds no motion: {error.errors()[0]['msg']}") from None
        movable = {joint.name for joint in self._robot.movable_joints}
        names = tuple(content.joint_names)
        if not set(names) <= movable or len(set(names)) < len(names):
            raise ValueError(f"{path} is of the joints {', '.join(names)[:200]}, which are not all of this robot")
        if {len(point) for point in content.positions_rad} != {len(names)} or len(content.positions_rad) != len(
            content.time_s
        ):
            raise ValueError(f"{path} must have a point of {len(names)} joints for each of its times")
        time_s = np.array(content.time_s)
        if time_s[0] != 0.0 or np.any(np.diff(time_s) <= 0.0) or time_s[-1] > MAX_DURATION_S:
            raise ValueError(f"{path} must have times that increase from 0 to at most {MAX_DURATION_S:g} s")
        return TaughtMotion(names, time_s, np.array(content.positions_rad))

"""Decides, tick by tick, which goals the servos get: pure, time passed in, the last line of defence.

It trusts no command. A trajectory is refused when it is malformed, too fast, outside the soft limits or does not
start where the arm holds; whatever then comes out is clamped to the soft limits and to a bounded step a tick.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robot.messages import Execute, Mode, MotionEnded, Outcome
from robot.model import RobotModel
from robot.playback import Playback
from robot.trajectory import Trajectory, Vector

# A trajectory may start this far from where the arm holds [rad]; the step bound levels the difference.
START_TOLERANCE_RAD = 0.05

# Backlash (0.9-1.0 deg) plus droop under load (1.8-2.6 deg) of real arms.
GOAL_TOLERANCE_RAD = 0.06

# Goals within this much of a limit count as on it: rounding to ticks is 0.0015 rad.
LIMIT_TOLERANCE_RAD = 0.002

# Timing laws meet velocity limits only to a few per cent between their grid points.
VELOCITY_TOLERANCE = 1.05

# Step bound of one tick as a multiple of what the velocity limit allows: leaves room for one late tick.
STEP_MARGIN = 1.5

# Longer gaps between two ticks are not made up for: the motion goes on from where it was.
MAX_TICK_GAP_S = 0.02

TRACKING_ERROR_RAD = 0.35
TRACKING_TIME_S = 0.2

# Ten missed cycles. The arm still follows its last goal meanwhile.
STALE_AFTER_S = 0.1

SETTLE_TIMEOUT_S = 1.0
SETTLED_TICKS = 3

# 100 Hz for half an hour.
MAX_SAMPLES = 180_000


@dataclass(frozen=True)
class JointBounds:
    """Limits the driver keeps, each of shape (joints,): soft limits [rad], [rad/s], [rad/s^2]."""

    lower_rad: Vector
    upper_rad: Vector
    max_velocity: Vector
    max_acceleration: Vector

    @classmethod
    def of(cls, robot: RobotModel, joint_names: tuple[str, ...]) -> JointBounds:
        """The limits of the robot's joints, in the order of the names."""
        joints = [robot.joints[name] for name in joint_names]
        return cls(
            lower_rad=np.array([joint.lower for joint in joints]),
            upper_rad=np.array([joint.upper for joint in joints]),
            max_velocity=np.array([joint.max_velocity for joint in joints]),
            max_acceleration=np.array([joint.max_acceleration for joint in joints]),
        )


@dataclass(frozen=True)
class Measured:
    """The last good reading of every joint, shape (joints,), and how old it is [s]."""

    position_rad: Vector
    age_s: Vector


class Driver:
    """The arm's motion state.

    Args:
        joint_names: order of every array.
        bounds: limits of the joints.
        hold_rad: goals the servos have now, shape (joints,) [rad].
        now_s: monotonic time [s].
    """

    def __init__(self, joint_names: tuple[str, ...], bounds: JointBounds, hold_rad: Vector, now_s: float) -> None:
        self._names = joint_names
        self._bounds = bounds
        self._goal_rad = hold_rad.copy()
        self._hold_rad = self._goal_rad
        self._last_step_s = now_s
        self._motion: _Motion | None = None

    @property
    def mode(self) -> Mode:
        """Whether a motion is in progress."""
        return Mode.HOLDING if self._motion is None else Mode.MOVING

    @property
    def goal_rad(self) -> Vector:
        """The goals given last, shape (joints,) [rad]."""
        return self._goal_rad

    @property
    def motion_id(self) -> int | None:
        """The motion in progress."""
        return None if self._motion is None else self._motion.motion_id

    @property
    def fraction(self) -> float:
        """Share of the motion in progress that is done."""
        return 0.0 if self._motion is None else self._motion.playback.fraction

    @property
    def remaining_s(self) -> float:
        """Time left of the motion in progress [s]."""
        return 0.0 if self._motion is None else self._motion.playback.remaining_s

    def execute(self, command: Execute) -> MotionEnded | None:
        """Begin a motion; returns the refusal, or None when it began."""
        reason = self._refusal(command.trajectory)
        if reason:
            return MotionEnded(command.motion_id, Outcome.REFUSED, reason)
        columns = np.array([self._names.index(name) for name in command.trajectory.joint_names])
        playback = Playback(command.trajectory, self._bounds.max_acceleration[columns])
        self._motion = _Motion(command.motion_id, playback, columns)
        return None

    def stop(self) -> None:
        """Brake along the path of the motion in progress."""
        if self._motion is not None:
            self._motion.playback.stop()

    def step(self, measured: Measured, now_s: float) -> MotionEnded | None:
        """Advance one tick: sets :attr:`goal_rad`, and returns the end of the motion when this tick ends it."""
        elapsed_s = min(max(now_s - self._last_step_s, 0.0), MAX_TICK_GAP_S)
        self._last_step_s = now_s
        motion = self._motion
        if motion is None:
            self._goal_rad = self._guarded(self._hold_rad, elapsed_s)
            return None
        goal_rad = self._goal_rad.copy()
        goal_rad[motion.columns] = motion.playback.advance(elapsed_s)
        self._goal_rad = self._hold_rad = self._guarded(goal_rad, elapsed_s)
        ended = self._fault(motion, measured, now_s) or self._end(motion, measured, now_s)
        if ended is not None:
            self._motion = None
        return ended

    def abandon(self, outcome: Outcome, message: str) -> MotionEnded | None:
        """End the motion in progress without moving on, because the servos cannot be reached."""
        if self._motion is None:
            return None
        ended = MotionEnded(self._motion.motion_id, outcome, message)
        self._motion = None
        return ended

    def _refusal(self, trajectory: Trajectory) -> str:
        """Why a trajectory may not be played, or an empty text."""
        if self._motion is not None:
            return f"motion {self._motion.motion_id} is in progress"
        malformed = _malformed(trajectory, self._names)
        if malformed:
            return malformed
        columns = [self._names.index(name) for name in trajectory.joint_names]
        for column, name in enumerate(trajectory.joint_names):
            reason = self._joint_refusal(trajectory, column, columns[column], name)
            if reason:
                return reason
        return ""

    def _joint_refusal(self, trajectory: Trajectory, column: int, joint: int, name: str) -> str:
        positions = trajectory.positions_rad[:, column]
        held = self._goal_rad[joint]
        # An arm that was switched on outside its soft limits may be brought back inside.
        lower = min(self._bounds.lower_rad[joint], held) - LIMIT_TOLERANCE_RAD
        upper = max(self._bounds.upper_rad[joint], held) + LIMIT_TOLERANCE_RAD
        outside = positions[(positions < lower) | (positions > upper)]
        if outside.size:
            return f"joint {name} would go to {outside[0]:.3f} rad, beyond its limits {lower:.3f} to {upper:.3f} rad"
        if abs(positions[0] - held) > START_TOLERANCE_RAD:
            return (
                f"the motion starts with joint {name} at {positions[0]:.3f} rad, but the arm holds it at "
                f"{held:.3f} rad (tolerance {START_TOLERANCE_RAD} rad)"
            )
        speeds = np.abs(np.diff(positions)) / np.diff(trajectory.time_s)
        limit = self._bounds.max_velocity[joint] * VELOCITY_TOLERANCE
        if speeds.size and speeds.max() > limit:
            return f"joint {name} would move at {speeds.max():.2f} rad/s, above its limit of {limit:.2f} rad/s"
        return ""

    def _guarded(self, goal_rad: Vector, elapsed_s: float) -> Vector:
        """The goal within the step bound of the last one, and not further outside the soft limits than that."""
        step = self._bounds.max_velocity * elapsed_s * STEP_MARGIN
        bounded = np.clip(goal_rad, self._goal_rad - step, self._goal_rad + step)
        lower = np.minimum(self._bounds.lower_rad, self._goal_rad)
        upper = np.maximum(self._bounds.upper_rad, self._goal_rad)
        return np.clip(bounded, lower, upper)

    def _fault(self, motion: _Motion, measured: Measured, now_s: float) -> MotionEnded | None:
        """What ends or stops the motion against its will."""
        oldest = int(np.argmax(measured.age_s))
        if measured.age_s[oldest] > STALE_AFTER_S and not motion.lost_bus:
            motion.lost_bus = (
                f"the servo of joint {self._names[oldest]} has not answered for {measured.age_s[oldest]:.2f} s"
            )
            motion.playback.stop()
        error = np.abs(measured.position_rad - self._goal_rad)
        worst = int(np.argmax(error))
        if error[worst] <= TRACKING_ERROR_RAD:
            motion.tracking_lost_since_s = None
            return None
        if motion.tracking_lost_since_s is None:
            motion.tracking_lost_since_s = now_s
        if now_s - motion.tracking_lost_since_s < TRACKING_TIME_S:
            return None
        # Pushing on against an obstacle heats the servo: go back, step by bounded step, to where the arm is.
        self._hold_rad = np.clip(measured.position_rad, self._bounds.lower_rad, self._bounds.upper_rad)
        message = (
            f"joint {self._names[worst]} is {error[worst]:.2f} rad behind its goal: blocked, or too weak for the load"
        )
        return MotionEnded(motion.motion_id, Outcome.TRACKING_LOST, message)

    def _end(self, motion: _Motion, measured: Measured, now_s: float) -> MotionEnded | None:
        """The regular end: stopped, or the goal reached and the arm settled there."""
        playback = motion.playback
        if not playback.finished:
            return None
        if motion.lost_bus:
            return MotionEnded(motion.motion_id, Outcome.BUS_LOST, motion.lost_bus)
        if not playback.completed:
            return MotionEnded(
                motion.motion_id, Outcome.STOPPED, f"stopped after {playback.fraction:.0%} of the motion"
            )
        if motion.end_reached_s is None:
            motion.end_reached_s = now_s
        error = np.abs(measured.position_rad - self._goal_rad)
        motion.settled_ticks = motion.settled_ticks + 1 if error.max() <= GOAL_TOLERANCE_RAD else 0
        if motion.settled_ticks >= SETTLED_TICKS:
            return MotionEnded(motion.motion_id, Outcome.REACHED, "the arm is there")
        if now_s - motion.end_reached_s < SETTLE_TIMEOUT_S:
            return None
        worst = int(np.argmax(error))
        message = (
            f"joint {self._names[worst]} is still {error[worst]:.3f} rad from its goal {SETTLE_TIMEOUT_S:g} s after "
            f"the end of the motion (tolerance {GOAL_TOLERANCE_RAD} rad)"
        )
        return MotionEnded(motion.motion_id, Outcome.NOT_SETTLED, message)


@dataclass
class _Motion:
    """A trajectory in progress; ``columns`` are the places of its joints in the driver's arrays."""

    motion_id: int
    playback: Playback
    columns: np.ndarray[tuple[int], np.dtype[np.intp]]
    tracking_lost_since_s: float | None = None
    end_reached_s: float | None = None
    settled_ticks: int = 0
    lost_bus: str = ""


def _malformed(trajectory: Trajectory, known: tuple[str, ...]) -> str:
    """What is wrong with the form of a trajectory, or an empty text."""
    names = trajectory.joint_names
    unknown = [name for name in names if name not in known]
    if unknown or not names or len(set(names)) != len(names):
        return f"the motion names the joints {list(names)}; the arm has {list(known)}, each at most once"
    samples = trajectory.time_s.shape[0]
    if not 1 <= samples <= MAX_SAMPLES:
        return f"the motion has {samples} samples; 1 to {MAX_SAMPLES} are allowed"
    for array in (trajectory.positions_rad, trajectory.velocities_rad_s, trajectory.accelerations_rad_s2):
        if array.shape != (samples, len(names)):
            return f"the motion has an array of shape {array.shape} for {samples} samples of {len(names)} joints"
        if not np.isfinite(array).all():
            return "the motion holds a value that is not a finite number"
    if trajectory.time_s[0] != 0.0 or not (np.diff(trajectory.time_s) > 0.0).all():
        return "the times of the motion must increase from 0"
    return ""

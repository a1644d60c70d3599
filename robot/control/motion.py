"""Motions in progress: the goal at each tick along the path, the end, and splicing into a new trajectory."""

from __future__ import annotations

import math
from collections.abc import Iterable, MutableSequence

import numpy as np
from numpy.typing import NDArray

from robot.control import checks
from robot.control.streaming import Streaming
from robot.description.limits import JointBounds
from robot.messages import Execute, GuardLimits, MotionEnded, Outcome
from robot.trajectory import Trajectory, Vector

# Least share of the acceleration limit for a change of the rate, also while a joint uses all of it on the path. Stops
# in 161 plans of the SO-101 take as long with 0.02 as with 0.5, because that joint is slowed down by the path itself.
BRAKING_SHARE = 0.05

STANDSTILL_BRAKING = 1e3  # change of the rate where nothing moves, at the ends of a motion [1/s]: stops within one tick
STOPPED_RATE = 1e-3  # below this rate the rest of the stop is shorter than one tick
SETTLED_TICKS = 3  # ticks in a row within the goal tolerance, after which a joint counts as settled

# Spliced trajectories coincide to within these [rad], [rad/s]: far below a servo's tick.
SAME_POSITION_RAD = 1e-6
SAME_SPEED_RAD_S = 1e-4


class Playback:
    """Trajectory being played; acceleration limits have shape (joints,) [rad/s^2].

    The path time ``s`` runs at ``rate`` seconds a second: 1 while playing, ramped down to 0 to stop, in between for a
    slower motion, below 0 to go back. With q(s) the path, the joints have the velocity rate * q'(s) and the
    acceleration rate^2 * q''(s) + d(rate)/dt * q'(s).
    """

    def __init__(self, trajectory: Trajectory, max_acceleration: Vector, ceiling: float = 1.0) -> None:
        self.trajectory = trajectory
        self._max_acceleration = max_acceleration
        self._path_time_s = 0.0
        self._rate = ceiling
        self._stopping = False
        self.ceiling = ceiling  # fastest rate allowed, in (0, 1]
        self.pace = 1.0  # wanted rate, -1 to 1: at 0 the arm waits on its path, below 0 it goes back to its start

    @property
    def finished(self) -> bool:
        """True when the goal no longer moves: the end is reached, or the stop is complete."""
        return self.completed or (self._stopping and self._rate == 0.0)

    @property
    def completed(self) -> bool:
        """True when the end of the trajectory was reached."""
        return self._path_time_s >= self.trajectory.duration_s

    @property
    def ending(self) -> bool:
        """True when there is no way back: the end of the trajectory was reached, or a stop is in progress."""
        return self.completed or self._stopping

    @property
    def fraction(self) -> float:
        """Share of the duration that is done, 0..1."""
        duration_s = self.trajectory.duration_s
        return min(self._path_time_s / duration_s, 1.0) if duration_s > 0.0 else 1.0

    @property
    def remaining_s(self) -> float:
        """Time to the end at the wanted rate; while the arm waits or goes back, at the fastest one [s]."""
        rate = min(self.pace, self.ceiling) if self.pace > 0.0 else self.ceiling
        return max(self.trajectory.duration_s - self._path_time_s, 0.0) / rate

    def can_splice(self, other: Trajectory, from_s: float) -> bool:
        """Return True when a trajectory that begins at a time of this one [s] can replace it without a step now."""
        there_s = self._path_time_s - from_s
        if self._stopping or not 0.0 <= there_s < other.duration_s:
            return False
        position, velocity, _ = self.trajectory.sample(self._path_time_s)
        other_position, other_velocity, _ = other.sample(there_s)
        near = np.abs(position - other_position) <= SAME_POSITION_RAD
        return bool((near & (np.abs(velocity - other_velocity) <= SAME_SPEED_RAD_S)).all())

    def continue_from(self, former: Playback, from_s: float) -> None:
        """Continue at position and rate of a playback on whose trajectory this one's begins at ``from_s`` [s]."""
        self._path_time_s = former._path_time_s - from_s
        self._rate = former._rate

    def stop(self) -> None:
        """Begin to brake along the path."""
        self._stopping = True

    def advance(self, elapsed_s: float) -> Vector:
        """Advance by ``elapsed_s`` [s] and return the goal, shape (joints,) [rad]."""
        # At the end the joints settle: there is no way back from there.
        if not self.completed:
            self._change_rate(elapsed_s)
            moved_s = self._path_time_s + self._rate * elapsed_s
            self._path_time_s = min(max(moved_s, 0.0), self.trajectory.duration_s)
        return self.trajectory.sample(self._path_time_s)[0]

    def _change_rate(self, elapsed_s: float) -> None:
        wanted = 0.0 if self._stopping else max(min(self.pace, self.ceiling), -self.ceiling)
        if self._rate == wanted and wanted >= 0.0:
            return
        if wanted < 0.0:
            # A path may begin in motion: the way back then ends in time for the rest of it, tick by tick.
            fastest = min(self._largest_change(elapsed_s, direction) for direction in (1.0, -1.0))
            change = fastest * elapsed_s
            wanted = max(wanted, 0.5 * change - math.sqrt(0.25 * change**2 + 2.0 * fastest * self._path_time_s))
        direction = math.copysign(1.0, wanted - self._rate)
        change = self._largest_change(elapsed_s, direction) * elapsed_s
        self._rate = max(wanted, self._rate - change) if direction < 0.0 else min(wanted, self._rate + change)
        if wanted == 0.0 and abs(self._rate) < STOPPED_RATE:
            self._rate = 0.0

    def _largest_change(self, elapsed_s: float, direction: float) -> float:
        """Return the fastest change of the rate, up (1) or down (-1), within all acceleration limits [1/s]."""
        fastest = STANDSTILL_BRAKING
        # The path's own acceleration may change within the tick, as where a joint begins to slow down.
        for path_time_s in (self._path_time_s, self._path_time_s + self._rate * elapsed_s):
            _, velocity, acceleration = self.trajectory.sample(path_time_s)
            # What the path itself uses of the limit adds to the change, or takes from it: rate^2 q'' + d(rate)/dt q'.
            in_use = direction * np.sign(velocity) * self._rate**2 * acceleration
            spare = np.maximum(self._max_acceleration - in_use, BRAKING_SHARE * self._max_acceleration)
            speed = np.maximum(np.abs(velocity), 1e-6)
            fastest = min(fastest, float(np.min(spare / speed)))
        return fastest


class Motion(Playback):
    """Motion in progress: the playback of a command until its joints have settled within a tolerance, or stopped."""

    def __init__(
        self,
        command: Execute,
        names: tuple[str, ...],
        bounds: JointBounds,
        limits: GuardLimits,
        goal_tolerance_rad: Vector | None = None,
        speed_limit: float = 1.0,
    ) -> None:
        self.command = command
        self.motion_id = command.motion_id  # number of the motion, reported with its end
        self.joint_names = command.trajectory.joint_names
        self.gripping = command.gripping  # True when a stall on the way is a grip
        self._limits = limits
        # Indices of its joints in the controller's arrays.
        self.columns: NDArray[np.intp] = np.array([names.index(name) for name in command.trajectory.joint_names])
        wanted = np.full(len(names), limits.goal_tolerance_rad) if goal_tolerance_rad is None else goal_tolerance_rad
        self._tolerance_rad = wanted[self.columns]
        shares = command.trajectory.peak_speed_rad_s / bounds.max_velocity[self.columns]
        self._peak_share = float(shares.max(initial=0.0))
        self.limit_speed(speed_limit)
        super().__init__(command.trajectory, bounds.max_acceleration[self.columns], self._fastest)
        self._end_reached_s: float | None = None
        self._settled_ticks = 0

    @property
    def rate(self) -> float:
        """Share of the planned speed at which it may be played now, 0 while it is paused."""
        return min(abs(self.pace), self.ceiling)

    def limit_speed(self, share: float) -> None:
        """Play it slower, so that no joint exceeds a share of its velocity limit by more than VELOCITY_TOLERANCE."""
        planned = self._peak_share <= share * checks.VELOCITY_TOLERANCE
        self._fastest = 1.0 if planned else share / self._peak_share

    def step(self, elapsed_s: float, rate: float, fastest: float) -> Vector:
        """Advance at a wanted rate, below 0 to go back, bounded by the fastest; return its joints' goals [rad]."""
        self.pace, self.ceiling = rate, min(fastest, self._fastest)
        return self.advance(elapsed_s)

    def ended(self, outcome: Outcome, message: str) -> MotionEnded:
        """Return the motion's end."""
        return MotionEnded(self.motion_id, outcome, message)

    def end(self, goal_rad: Vector, position_rad: Vector, now_s: float) -> MotionEnded | None:
        """Return the regular end, None while in progress; goals and measured positions are of all joints [rad]."""
        if not self.finished:
            return None
        if not self.completed:
            return self.ended(Outcome.STOPPED, f"the arm stands at {self.fraction:.0%} of the way")
        if self._end_reached_s is None:
            self._end_reached_s = now_s
        error = np.abs(position_rad - goal_rad)[self.columns]
        self._settled_ticks = self._settled_ticks + 1 if (error <= self._tolerance_rad).all() else 0
        if self._settled_ticks >= SETTLED_TICKS:
            return self.ended(Outcome.REACHED, "the arm is there")
        if now_s - self._end_reached_s < self._limits.settle_timeout_s:
            return None
        return self._not_settled(error)

    def _not_settled(self, error: Vector) -> MotionEnded:
        worst = int(np.argmax(error - self._tolerance_rad))
        name = self.joint_names[worst]
        if self.gripping:
            return self.ended(
                Outcome.GRIPPED, f"joint {name} holds something, {error[worst]:.3f} rad short of its goal"
            )
        message = (
            f"joint {name} is still {error[worst]:.3f} rad from its goal {self._limits.settle_timeout_s:g} s after "
            f"the end of the motion (tolerance {self._tolerance_rad[worst]:.2g} rad)"
        )
        return self.ended(Outcome.NOT_SETTLED, message)


def splice_refusal(
    motions: Iterable[Motion | Streaming],
    command: Execute,
    names: tuple[str, ...],
    bounds: JointBounds,
    goal_rad: Vector,
) -> str:
    """Check a motion that replaces another one; return the reason to refuse it, empty for none."""
    former, continues = _former(motions, command), command.continues
    if former is None or continues is None:
        return "the motion whose place it should take is not in progress"
    if command.trajectory.joint_names != former.joint_names or command.gripping or former.gripping:
        return f"motion {former.motion_id} is one of other joints, or a grip: none can take its place"
    begins_rad = goal_rad.copy()
    begins_rad[former.columns] = former.trajectory.sample(continues.from_s)[0]
    reason = checks.refusal(command.trajectory, names, bounds, begins_rad, in_motion=True)
    if reason or former.can_splice(command.trajectory, continues.from_s):
        return reason
    return f"motion {former.motion_id} is no longer where another could take its place"


def splice(motions: MutableSequence[Motion | Streaming], motion: Motion) -> MotionEnded | None:
    """Put an accepted motion in the place of the motion that it continues; return the end of the latter, if any."""
    former, continues = _former(motions, motion.command), motion.command.continues
    if former is None or continues is None:
        return None
    motion.continue_from(former, continues.from_s)
    motions.remove(former)
    return former.ended(Outcome.STOPPED, f"motion {motion.motion_id} takes its place")


def _former(motions: Iterable[Motion | Streaming], command: Execute) -> Motion | None:
    number = None if command.continues is None else command.continues.motion_id
    found = (one for one in motions if isinstance(one, Motion) and one.motion_id == number)
    return next(found, None)

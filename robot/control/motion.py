"""Motions and streams in progress: the goals at each tick, the end, and splicing into a new trajectory.

A joint of a stream with a target velocity is sent to the limit ahead of it at that speed, so that it brakes in time by
itself however late the next setpoint comes. The profiles are ruckig's, time-optimal within the bounds; each joint has
its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, MutableSequence

import numpy as np
from numpy.typing import NDArray
from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization
from ruckig import Trajectory as RuckigTrajectory

from robot.description.limits import JointBounds
from robot.messages import Commanded, Execute, GuardLimits, MotionEnded, Outcome, Stream
from robot.trajectory import TIME_TO_FULL_ACCELERATION_S, VELOCITY_TOLERANCE, Trajectory, Vector, refusal

LEAST_SPEED_RAD_S = 1e-3  # slower targets count as rest: this is a servo's tick in two seconds

# Six ticks. A stream that is steered at 50 Hz may lose two setpoints in a row. With the braking, joints are at rest
# within 0.15 s of the moment at which the server stands still.
SETPOINT_LASTS_S = 0.06


class Streaming:
    """Stream in progress from where the arm holds, with the interface of :class:`robot.control.motion.Motion`."""

    fraction = 0.0
    remaining_s = 0.0
    rate = 1.0

    def __init__(
        self, command: Stream, names: tuple[str, ...], bounds: JointBounds, held_rad: Vector, speed_limit: float = 1.0
    ) -> None:
        self.motion_id = command.motion_id
        self.joint_names = command.joint_names
        self.gripping = command.gripping
        self.columns: NDArray[np.intp] = np.array([names.index(name) for name in command.joint_names])
        self._max_velocity = bounds.max_velocity[self.columns]
        self._speed_limit = speed_limit
        self._tracking = VelocityTracking(bounds.of_columns(self.columns), held_rad[self.columns])
        self._velocity_rad_s = np.zeros(len(self.columns))
        self._at_s = self._silence_s = 0.0
        self._ending = ""

    @property
    def finished(self) -> bool:
        """True when the goals no longer move, and will not again."""
        return self._tracking.at_rest and (bool(self._ending) or self._silent)

    @property
    def commanded(self) -> Commanded:
        """Position and velocity goals of the joints now."""
        return Commanded(self.motion_id, self._at_s, self._tracking.position_rad, self._tracking.velocity_rad_s)

    @property
    def _silent(self) -> bool:
        # Rounding: six ticks may add up to a little more than SETPOINT_LASTS_S.
        return self._silence_s > SETPOINT_LASTS_S + 1e-9

    def steer(self, velocity_rad_s: Vector) -> None:
        """Take a setpoint, shape (joints,) [rad/s]; one of another shape, or not finite, ends the stream."""
        self._silence_s = 0.0
        if velocity_rad_s.shape != self.columns.shape or not np.isfinite(velocity_rad_s).all():
            self._ending = self._ending or f"stopped: {velocity_rad_s.tolist()} are no velocities of these joints"
            return
        self._velocity_rad_s = velocity_rad_s

    def limit_speed(self, share: float) -> None:
        """Let no joint be faster than a share of its velocity limit, above 0 to 1, from the next step on."""
        self._speed_limit = share

    def stop(self) -> None:
        """Begin to brake, for good."""
        self._ending = self._ending or "stopped"

    def step(self, elapsed_s: float, rate: float, fastest: float) -> Vector:
        """Advance at a share of the setpoints' speed, 0 below 0; return its joints' goals, shape (joints,) [rad]."""
        self._at_s += elapsed_s
        self._silence_s += elapsed_s
        resting = bool(self._ending) or self._silent
        target = self._velocity_rad_s * (0.0 if resting else min(max(rate, 0.0), fastest))
        # All joints slow down alike, so that the tip keeps its direction.
        peak_share = float(np.max(np.abs(target) / self._max_velocity))
        self._tracking.set_target(target * (self._speed_limit / max(peak_share, self._speed_limit)))
        return self._tracking.advance(elapsed_s)

    def end(self, _goal_rad: Vector, _position_rad: Vector, _now_s: float) -> MotionEnded | None:
        """Return the regular end, None while in progress: at rest, and stopped or without setpoints."""
        if not self.finished:
            return None
        if self._ending:
            return MotionEnded(self.motion_id, Outcome.STOPPED, self._ending)
        return MotionEnded(self.motion_id, Outcome.UNSTEERED, f"no setpoint came for {SETPOINT_LASTS_S:g} s")


class VelocityTracking:
    """Positions of joints that follow target velocities, from rest at some positions, shape (joints,) [rad]."""

    def __init__(self, bounds: JointBounds, position_rad: Vector) -> None:
        joints = len(position_rad)
        self.position_rad, self.velocity_rad_s = position_rad.copy(), np.zeros(joints)
        self._acceleration_rad_s2 = np.zeros(joints)
        self._target_rad_s = np.zeros(joints)
        # A joint that was switched on outside its limits may stay there, and come inside.
        self._lower_rad = np.minimum(bounds.lower_rad, position_rad)
        self._upper_rad = np.maximum(bounds.upper_rad, position_rad)
        self._max_velocity = bounds.max_velocity
        self._ruckig, self._input, self._profile = Ruckig(joints), InputParameter(joints), RuckigTrajectory(joints)
        self._input.synchronization = Synchronization.No
        self._input.max_acceleration = bounds.max_acceleration.tolist()
        self._input.max_jerk = (bounds.max_acceleration / TIME_TO_FULL_ACCELERATION_S).tolist()
        self._input.target_velocity = self._input.target_acceleration = [0.0] * joints
        self._since_s = 0.0
        self._plan()

    @property
    def at_rest(self) -> bool:
        """True when no joint moves: each has come to rest, or to the limit ahead of it."""
        return self._since_s >= self._profile.duration

    def set_target(self, velocity_rad_s: Vector) -> None:
        """Set finite target velocities, shape (joints,) [rad/s], clamped to the velocity limits."""
        target = np.clip(velocity_rad_s, -self._max_velocity, self._max_velocity)
        target[np.abs(target) < LEAST_SPEED_RAD_S] = 0.0
        if not np.array_equal(target, self._target_rad_s):
            self._target_rad_s = target
            self._plan()

    def advance(self, elapsed_s: float) -> Vector:
        """Advance by ``elapsed_s`` [s] and return the position goals, shape (joints,) [rad]."""
        self._since_s += elapsed_s
        position, velocity, acceleration = self._profile.at_time(self._since_s)
        self.position_rad, self.velocity_rad_s = np.array(position), np.array(velocity)
        self._acceleration_rad_s2 = np.array(acceleration)
        return self.position_rad

    def _plan(self) -> None:
        moving = self._target_rad_s != 0.0
        given = self._input
        given.current_position = self.position_rad.tolist()
        given.current_velocity = self.velocity_rad_s.tolist()
        given.current_acceleration = self._acceleration_rad_s2.tolist()
        given.target_position = np.where(self._target_rad_s > 0.0, self._upper_rad, self._lower_rad).tolist()
        # Ignored for a joint that is to rest: the velocity interface uses neither of these two.
        given.max_velocity = np.where(moving, np.abs(self._target_rad_s), self._max_velocity).tolist()
        interfaces = (ControlInterface.Velocity, ControlInterface.Position)
        given.per_dof_control_interface = [interfaces[int(each)] for each in moving]
        try:
            self._ruckig.calculate(given, self._profile)
        except RuckigError:
            # Rounding leaves its equations without a solution in rare cases; braking always has one.
            given.per_dof_control_interface = [ControlInterface.Velocity] * len(moving)
            self._ruckig.calculate(given, self._profile)
        self._since_s = 0.0


# Least share of the acceleration limit for a change of the rate, also while a joint uses all of it on the path. Stops
# in 161 plans of the SO-101 take as long with 0.02 as with 0.5, because that joint is slowed down by the path itself.
BRAKING_SHARE = 0.05

STANDSTILL_BRAKING = 1e3  # change of the rate where nothing moves, at the ends of a motion [1/s]: stops within one tick
SETTLED_TICKS = 3  # ticks in a row within the goal tolerance, after which a joint counts as settled

# Spliced trajectories coincide to within these [rad], [rad/s]: far below a servo's tick. They leave the path at up to
# 150 rad/s^3: an order that comes a tick late, 3 ms after that, is taken without a step.
SAME_POSITION_RAD = 1e-6
SAME_SPEED_RAD_S = 1e-3


class Motion:
    """Motion in progress: its trajectory is played until its joints have settled within a tolerance, or stopped.

    The path time ``s`` runs at a rate in seconds a second: 1 while playing, ramped down to 0 to stop, in between for a
    slower motion, below 0 to go back. With q(s) the path, the joints have the velocity rate * q'(s) and the
    acceleration rate^2 * q''(s) + d(rate)/dt * q'(s).
    """

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
        self.trajectory = command.trajectory
        self.motion_id = command.motion_id  # number of the motion, reported with its end
        self.joint_names = command.trajectory.joint_names
        self.gripping = command.gripping  # True when a stall on the way is a grip
        self._limits = limits
        # Indices of its joints in the controller's arrays.
        self.columns: NDArray[np.intp] = np.array([names.index(name) for name in command.trajectory.joint_names])
        wanted = np.full(len(names), limits.goal_tolerance_rad) if goal_tolerance_rad is None else goal_tolerance_rad
        self._tolerance_rad = wanted[self.columns]
        self._max_acceleration = bounds.max_acceleration[self.columns]
        shares = command.trajectory.peak_speed_rad_s / bounds.max_velocity[self.columns]
        self._peak_share = float(shares.max())
        self.limit_speed(speed_limit)
        self._path_time_s = 0.0
        # Rate now, and the most allowed, in (0, 1].
        self._rate = self._most_rate = self._fastest
        self._wanted_rate = 1.0  # -1 to 1: at 0 the arm waits on its path, below 0 it goes back to its start
        self._stopping = False
        self._end_reached_s: float | None = None
        self._settled_ticks = 0

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
        rate = min(self._wanted_rate, self._most_rate) if self._wanted_rate > 0.0 else self._most_rate
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

    def continue_from(self, former: Motion, from_s: float) -> None:
        """Continue at position and rate of a motion on whose trajectory this one's begins at ``from_s`` [s]."""
        self._path_time_s = former._path_time_s - from_s
        self._rate = former._rate

    def stop(self) -> None:
        """Begin to brake along the path."""
        self._stopping = True

    def step(self, elapsed_s: float, rate: float = 1.0, fastest: float = 1.0) -> Vector:
        """Advance at a wanted rate, below 0 to go back, bounded by the fastest; return its joints' goals [rad]."""
        self._wanted_rate, self._most_rate = rate, min(fastest, self._fastest)
        # At the end the joints settle: there is no way back from there.
        if not self.completed:
            self._change_rate(elapsed_s)
            moved_s = self._path_time_s + self._rate * elapsed_s
            self._path_time_s = min(max(moved_s, 0.0), self.trajectory.duration_s)
        return self.trajectory.sample(self._path_time_s)[0]

    def _change_rate(self, elapsed_s: float) -> None:
        wanted = 0.0 if self._stopping else max(min(self._wanted_rate, self._most_rate), -self._most_rate)
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

    @property
    def rate(self) -> float:
        """Share of the planned speed at which it may be played now, 0 while it is paused."""
        return min(abs(self._wanted_rate), self._most_rate)

    def limit_speed(self, share: float) -> None:
        """Play it slower, so that no joint exceeds a share of its velocity limit by more than VELOCITY_TOLERANCE."""
        planned = self._peak_share <= share * VELOCITY_TOLERANCE
        self._fastest = 1.0 if planned else share / self._peak_share

    def end(self, goal_rad: Vector, position_rad: Vector, now_s: float) -> MotionEnded | None:
        """Return the regular end, None while in progress; goals and measured positions are of all joints [rad]."""
        if not self.finished:
            return None
        if not self.completed:
            return MotionEnded(self.motion_id, Outcome.STOPPED, f"the arm stands at {self.fraction:.0%} of the way")
        if self._end_reached_s is None:
            self._end_reached_s = now_s
        error = np.abs(position_rad - goal_rad)[self.columns]
        self._settled_ticks = self._settled_ticks + 1 if (error <= self._tolerance_rad).all() else 0
        if self._settled_ticks >= SETTLED_TICKS:
            return MotionEnded(self.motion_id, Outcome.REACHED, "the arm is there")
        if now_s - self._end_reached_s < self._limits.settle_timeout_s:
            return None
        return self._not_settled(error)

    def _not_settled(self, error: Vector) -> MotionEnded:
        worst = int(np.argmax(error - self._tolerance_rad))
        name = self.joint_names[worst]
        if self.gripping:
            return MotionEnded(
                self.motion_id,
                Outcome.GRIPPED,
                f"joint {name} holds something, {error[worst]:.3f} rad short of its goal",
            )
        message = (
            f"joint {name} is still {error[worst]:.3f} rad from its goal {self._limits.settle_timeout_s:g} s after "
            f"the end of the motion (tolerance {self._tolerance_rad[worst]:.2g} rad)"
        )
        return MotionEnded(self.motion_id, Outcome.NOT_SETTLED, message)


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
    reason = refusal(command.trajectory, names, bounds, begins_rad, in_motion=True)
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
    return MotionEnded(former.motion_id, Outcome.STOPPED, f"motion {motion.motion_id} takes its place")


def _former(motions: Iterable[Motion | Streaming], command: Execute) -> Motion | None:
    number = None if command.continues is None else command.continues.motion_id
    return next((each for each in motions if isinstance(each, Motion) and each.motion_id == number), None)

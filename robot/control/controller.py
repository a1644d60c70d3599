"""Controller of the arm: decides on the joints' goals at every tick. Pure: time is passed in.

It trusts no command. A trajectory is refused when it is malformed, too fast, outside the soft limits or does not start
where the arm holds; every goal is clamped to the soft limits and to a bounded step a tick. It trusts no reading either:
the guards check each, and a fault ends every motion and stays latched until it is reset.
"""

import math
from dataclasses import replace

import numpy as np

from robot.control.guards import Guards, Persistence
from robot.control.motion import Motion, Streaming, splice, splice_refusal
from robot.control.pacing import MAX_TICK_S
from robot.description.limits import JointBounds
from robot.faults import Fault, FaultCode
from robot.hardware.interface import Flags, Measured
from robot.messages import (
    MIN_SPEED_LIMIT,
    ChangePace,
    Commanded,
    Execute,
    Mode,
    MotionEnded,
    MotionProgress,
    Outcome,
    Pace,
    PlaybackDirection,
    Setpoint,
    Stream,
)
from robot.trajectory import Vector, names_refusal, refusal

# Step bound of one tick as a multiple of what the velocity limit allows: leaves room for one late tick.
STEP_MARGIN = 1.5

SLOW_RATE = 0.5  # greatest rate of motions while a servo is hot

# Grip: goal this far beyond the object [rad], at a share of the torque limit that the servo can give for long.
SQUEEZE_RAD = 0.05
GRIP_TORQUE_SHARE = 0.5

# A servo that goes on holding after one of these is damaged: torque is taken off, gently.
RELAXING = frozenset({FaultCode.OVERHEATED, FaultCode.OVERLOAD, FaultCode.OVERCURRENT})

# Pushing on against an obstacle heats the servo: after these the goal returns to the joint's position.
_YIELDING = frozenset({FaultCode.STALLED, FaultCode.TRACKING_LOST})

# The goals stop within one tick: the positions are unknown, or an emergency stop demands it. After every other fault
# the joints brake along their paths; a silent servo follows its goals unseen.
_FREEZING = frozenset({FaultCode.ENCODER_ERROR, FaultCode.POSITION_JUMP, FaultCode.EMERGENCY_STOP})

# Outcome of the motions that a fault ends; any other code is Outcome.FAULT.
_OUTCOMES = {
    FaultCode.BUS_LOST: Outcome.BUS_LOST,
    FaultCode.SERVO_SILENT: Outcome.BUS_LOST,
    FaultCode.BUS_SILENT: Outcome.BUS_LOST,
    FaultCode.TRACKING_LOST: Outcome.TRACKING_LOST,
}

_DIRECTION = {PlaybackDirection.FORWARD: 1.0, PlaybackDirection.PAUSED: 0.0, PlaybackDirection.BACK: -1.0}


class ArmController:
    """Motion state of one arm, relaxed until :meth:`hold`; each joint has its full share of full duty."""

    def __init__(
        self,
        joint_names: tuple[str, ...],
        bounds: JointBounds,
        guards: Guards,
        full_torque: Vector,
        fault: Fault | None = None,
        *,
        simulated: bool = False,
        speed_limit: float = 1.0,
    ) -> None:
        self._names = joint_names
        self._simulated = simulated
        self.bounds = bounds
        self.guards = guards
        self._full_torque = full_torque
        self.torque_limit = full_torque.copy()  # share of full duty that each joint may use now, shape (joints,)
        # Goals of the latest tick; the measured positions while the arm is relaxed, shape (joints,) [rad].
        self.goal_rad = self._hold_rad = np.zeros(len(joint_names))
        self._last_step_s: float | None = None
        self.motions: list[Motion | Streaming] = []  # motions in progress
        # Motions that a fault has ended, until their joints are at rest; and the joints that yield instead of braking.
        self._braking: list[Motion | Streaming] = []
        self._yielded: Flags = np.zeros(len(joint_names), dtype=bool)
        self._loaded = Persistence(len(joint_names))
        self._relieves = bool(np.isfinite(guards.thresholds.relieve_after_s).any())
        self.pace = Pace(speed_limit=speed_limit)
        self.torque_enabled = False  # True while torque is on
        self.fault = fault

    @property
    def mode(self) -> Mode:
        """State of an arm without a fault: RELAXED, HOLDING or MOVING."""
        if not self.torque_enabled:
            return Mode.RELAXED
        return Mode.MOVING if self.motions else Mode.HOLDING

    @property
    def moving(self) -> bool:
        """True while a motion is in progress, or brakes after a fault."""
        return bool(self.motions or self._braking)

    @property
    def resting(self) -> bool:
        """True while nothing moves, and nothing is about to."""
        return not self.moving and (not self.torque_enabled or self._hold_rad.tolist() == self.goal_rad.tolist())

    @property
    def progress(self) -> tuple[MotionProgress, ...]:
        return tuple(
            MotionProgress(motion.motion_id, motion.fraction, motion.remaining_s, motion.rate)
            for motion in self.motions
        )

    def hold(self, goal_rad: Vector, measured: Measured | None = None) -> None:
        """Begin to hold at the goals that the servos have, or at their positions where they are far away."""
        self.goal_rad, self._hold_rad = goal_rad.copy(), goal_rad.copy()
        self._braking = []
        self.guards.restart()
        if measured is not None:
            self._yield_to(measured)
        self.torque_limit = self._full_torque.copy()
        self.torque_enabled = True

    def release(self) -> None:
        """Mark the arm as relaxed: torque is off, or going off."""
        self.torque_enabled = False
        self._braking = []

    def execute(self, command: Execute) -> MotionEnded | None:
        """Begin a motion; return its refusal, or the end of the motion that it is spliced into, if any."""
        reason = self._refusal(command)
        if reason:
            return MotionEnded(command.motion_id, Outcome.REFUSED, reason)
        self._reset_direction_if_idle()
        motion = Motion(
            command,
            self._names,
            self.bounds,
            self.guards.limits,
            self.guards.thresholds.goal_tolerance_rad,
            self.pace.speed_limit,
        )
        ended = splice(self.motions, motion)
        self.motions.append(motion)
        self.torque_limit[motion.columns] = self._full_torque[motion.columns] * command.torque_share
        return ended

    def _refusal(self, command: Execute) -> str:
        if reason := self._unready():
            return reason
        if not 0.0 < command.torque_share <= 1.0:
            return f"torque_share is {command.torque_share}; it must be above 0 and at most 1"
        if command.continues is not None:
            return splice_refusal(self.motions, command, self._names, self.bounds, self.goal_rad)
        return self._occupied(command.trajectory.joint_names) or refusal(
            command.trajectory, self._names, self.bounds, self.goal_rad
        )

    def _unready(self) -> str:
        if self.fault is not None:
            return f"the arm has a fault: {self.fault}"
        return "" if self.torque_enabled else "the arm is relaxed: enable it first"

    def _occupied(self, names: tuple[str, ...]) -> str:
        for motion in self.motions + self._braking:
            both = set(motion.joint_names) & set(names)
            if both:
                return f"motion {motion.motion_id} of joint {min(both)} is in progress"
        return ""

    def stream(self, command: Stream) -> MotionEnded | None:
        """Begin a stream; return the refusal, or None when it began."""
        names = command.joint_names
        reason = self._unready() or names_refusal(names, self._names) or self._occupied(names)
        if reason:
            return MotionEnded(command.motion_id, Outcome.REFUSED, reason)
        self._reset_direction_if_idle()
        streaming = Streaming(command, self._names, self.bounds, self.goal_rad, self.pace.speed_limit)
        self.motions.append(streaming)
        self.torque_limit[streaming.columns] = self._full_torque[streaming.columns]
        return None

    def steer(self, setpoint: Setpoint) -> None:
        """Pass a setpoint to its stream; ignore it when the stream has ended."""
        for motion in self.motions:
            if isinstance(motion, Streaming) and motion.motion_id == setpoint.motion_id:
                motion.steer(setpoint.velocity_rad_s)

    @property
    def commanded(self) -> list[Commanded]:
        return [motion.commanded for motion in self.motions if isinstance(motion, Streaming)]

    def stop(self, motion_id: int | None = None) -> None:
        """Brake a motion along its path, or all of them."""
        for motion in self.motions:
            if motion_id in (None, motion.motion_id):
                motion.stop()

    def step(self, measured: Measured, now_s: float) -> list[MotionEnded]:
        """Advance one tick: set :attr:`goal_rad`, and check the readings; return the ends of motions."""
        elapsed_s = 0.0 if self._last_step_s is None else min(max(now_s - self._last_step_s, 0.0), MAX_TICK_S)
        self._last_step_s = now_s
        if not self.torque_enabled:
            self.goal_rad = self._hold_rad = measured.position_rad
            return []
        self._reset_direction_if_idle()
        self._advance(measured, elapsed_s)
        yielding = self._yielding()
        found = self.guards.check(self.goal_rad, measured, self.torque_limit, now_s, yielding)
        ended = self._end_gripped(measured, yielding) if yielding is not None else []
        if self._relieves:
            # Limit joints that push for so long that the protection of their servos would latch.
            thresholds = self.guards.thresholds
            loaded = (np.abs(measured.load) > thresholds.sustained_torque).tolist()
            lasting_s = np.array(self._loaded.lasting(loaded, now_s))
            limited = np.minimum(self.torque_limit, thresholds.sustained_torque)
            self.torque_limit = np.where(lasting_s >= thresholds.relieve_after_s, limited, self.torque_limit)
        if found is not None:
            ended += self.react(found, measured)
        return ended + self._end_finished(measured, now_s)

    def change_pace(self, change: ChangePace) -> None:
        """Change speed factor, direction or speed limit of motions; a factor or limit out of its range is ignored."""
        if change.speed_factor is not None and 0.0 <= change.speed_factor <= 1.0:
            self.pace = replace(self.pace, speed_factor=change.speed_factor)
        if change.direction is not None:
            self.pace = replace(self.pace, direction=change.direction)
        if change.speed_limit is not None and MIN_SPEED_LIMIT <= change.speed_limit <= 1.0:
            self.pace = replace(self.pace, speed_limit=change.speed_limit)
            for motion in self.motions:
                motion.limit_speed(change.speed_limit)

    def _reset_direction_if_idle(self) -> None:
        if self.pace.direction is not PlaybackDirection.FORWARD and all(motion.gripping for motion in self.motions):
            self.pace = replace(self.pace, direction=PlaybackDirection.FORWARD)

    def _advance(self, measured: Measured, elapsed_s: float) -> None:
        motions = self.motions + self._braking
        if not motions and self._hold_rad.tolist() == self.goal_rad.tolist():
            return
        hot = max(measured.temperature_c.tolist()) >= self.guards.limits.slow_temperature_c
        wanted = self._hold_rad.copy()
        fastest = SLOW_RATE if hot else 1.0
        led = np.zeros(len(self._names), dtype=bool)
        rate = self.pace.speed_factor * _DIRECTION[self.pace.direction]
        for motion in motions:
            wanted[motion.columns] = motion.step(elapsed_s, 1.0 if motion.gripping else rate, fastest)
            led[motion.columns] = True
        if self._braking:
            led &= ~self._yielded
        self.goal_rad = self._guarded(np.where(led, wanted, self._hold_rad), elapsed_s)
        self._hold_rad = np.where(led, self.goal_rad, self._hold_rad)

    def _guarded(self, goal_rad: Vector, elapsed_s: float) -> Vector:
        """Clamp a goal to the step bound around the last one, and to the soft limits, or no further outside them."""
        bounds, last_rad = self.bounds, self.goal_rad.tolist()
        limits = zip(bounds.lower_rad.tolist(), bounds.upper_rad.tolist(), bounds.max_velocity.tolist(), strict=True)
        guarded = []
        for goal, last, (lower, upper, speed) in zip(goal_rad.tolist(), last_rad, limits, strict=True):
            step = speed * elapsed_s * STEP_MARGIN
            lowest, highest = max(min(lower, last), last - step), min(max(upper, last), last + step)
            guarded.append(min(max(goal, lowest), highest) if math.isfinite(goal) else last)
        return np.array(guarded)

    def _yielding(self) -> Flags | None:
        gripping = [motion for motion in self.motions if motion.gripping]
        if not gripping:
            return None
        yielding = np.zeros(len(self._names), dtype=bool)
        for motion in gripping:
            yielding[motion.columns] = True
        return yielding

    def _end_gripped(self, measured: Measured, yielding: Flags) -> list[MotionEnded]:
        caught = yielding & self.guards.stalled
        ended = []
        for motion in [motion for motion in self.motions if caught[motion.columns].any()]:
            joint = int(motion.columns[np.argmax(caught[motion.columns])])
            message = f"joint {self._names[joint]} holds something at {measured.position_rad[joint]:.3f} rad"
            ended.append(MotionEnded(motion.motion_id, Outcome.GRIPPED, message))
            self._drop(motion, measured)
        return ended

    def _end_finished(self, measured: Measured, now_s: float) -> list[MotionEnded]:
        ended = []
        for motion in list(self.motions):
            end = motion.end(self.goal_rad, measured.position_rad, now_s)
            if end is not None:
                ended.append(end)
                # A stopped grip may push as hard as a finished one, which would be a stall from then on.
                pushes = motion.gripping and end.outcome is not Outcome.REACHED
                self._drop(motion, measured if pushes else None)
        self._braking = [motion for motion in self._braking if not motion.finished]
        return ended

    def _drop(self, motion: Motion | Streaming, gripped: Measured | None) -> None:
        self.motions.remove(motion)
        columns = motion.columns
        if gripped is None:
            self.torque_limit[columns] = self._full_torque[columns]
            return
        grip_torque = np.minimum(
            self._full_torque[columns] * GRIP_TORQUE_SHARE, self.guards.thresholds.sustained_torque[columns]
        )
        self.torque_limit[columns] = np.minimum(self.torque_limit[columns], grip_torque)
        position = gripped.position_rad[columns]
        squeeze = np.clip(self.goal_rad[columns] - position, -SQUEEZE_RAD, SQUEEZE_RAD)
        self._hold_rad[columns] = position + squeeze
        # The goal takes some ticks to come back, during which the joint goes on pushing.
        self.guards.forgive(columns.tolist())

    def react(self, found: Fault, measured: Measured) -> list[MotionEnded]:
        """React to a fault: latch it, unless a graver one is latched, or yield; return the ends of motions."""
        if self.fault is None or (found.code in RELAXING and self.fault.code not in RELAXING):
            return self.latch(found, measured)
        if found.code in _YIELDING:
            self._yield_to(measured)
        return []

    def latch(self, fault: Fault, measured: Measured | None = None) -> list[MotionEnded]:
        """Latch a fault: every motion ends at once, its joints brake along its path, and the arm holds until a reset.

        A joint that stalls or stays behind its goal does not brake: it yields to where it is. No joint brakes when
        positions are unknown, and at an emergency stop: the goals stop within one tick.
        """
        self.fault = replace(fault, simulated=self._simulated)
        if not self._braking:
            self._yielded[:] = False
        self._braking = self._braking + self.motions
        ended = self.abandon(_OUTCOMES.get(fault.code, Outcome.FAULT), str(self.fault))
        for motion in self._braking:
            motion.stop()
        if fault.code in _FREEZING:
            self._braking = []
            self._hold_rad = self.goal_rad.copy()
        if measured is not None and fault.code in _YIELDING:
            self._yield_to(measured)
        return ended

    def _yield_to(self, measured: Measured) -> None:
        """Move the held goal to the measured position of each joint that stalls, or rests far from its goal."""
        yielding = np.abs(measured.position_rad - self.goal_rad) > self.guards.thresholds.goal_tolerance_rad
        for motion in self._braking:
            # A joint on its way is behind its goal for no other reason.
            yielding[motion.columns] = False
        yielding |= np.logical_or(self.guards.stalled, self.guards.lost)
        self._yielded |= yielding
        inside = np.clip(measured.position_rad, self.bounds.lower_rad, self.bounds.upper_rad)
        self._hold_rad = np.where(yielding, inside, self._hold_rad)

    def reset(self) -> None:
        self.fault = None
        self.guards.restart()

    def abandon(self, outcome: Outcome, message: str) -> list[MotionEnded]:
        """End every motion in progress, without braking."""
        ended = [MotionEnded(motion.motion_id, outcome, message) for motion in self.motions]
        self.motions = []
        self.torque_limit = self._full_torque.copy()
        return ended

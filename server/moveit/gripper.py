"""Moves the gripper: one motion at a time, the newest command wins, and a stall on the way is a grip."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from robot.arm import Arm
from robot.description.model import Joint
from robot.messages import MotionEnded, Outcome
from robot.trajectory import rest_to_rest
from server.moveit.patience import Allowance, ArmTime
from server.moveit.playing import BRAKING_TIMEOUT_S
from server.moveit.readiness import ARM_START_TIMEOUT_S, unusable

FEEDBACK_PERIOD_S = 0.1

# Of the arm's clock. A grip takes the goal back from behind the object, a step a tick: half a second for the whole way.
SQUEEZE_TIMEOUT_S = 1.0
SQUEEZE_PERIOD_S = 0.04
SQUEEZED_WITHIN_RAD = 0.005


@dataclass(frozen=True)
class GripperCommand:
    """What is asked of the gripper.

    Attributes:
        position_rad: where to, within the joint's limits.
        max_effort: share of full motor duty, as in ``effort`` of ``/joint_states``; 0 for as much as is allowed.
        max_velocity_rad_s: 0 for as fast as motions are planned.
    """

    position_rad: float
    max_effort: float = 0.0
    max_velocity_rad_s: float = 0.0


@dataclass(frozen=True)
class GripperReading:
    """Where the gripper is [rad], how fast it moves [rad/s], and with how much effort [share of full duty]."""

    position_rad: float
    velocity_rad_s: float
    effort: float


class Gripper:
    """The gripper of an arm.

    Args:
        arm: the arm.
        joint: the gripper's joint; its limits are kept.
        velocity_scaling: share of the joint's velocity limit that motions use.
        acceleration_scaling: share of its acceleration limit.
        allowance: what motions may take.
        torque_limit: share of full motor duty that the gripper may use.
        clock: monotonic time of this machine [s].
    """

    def __init__(
        self,
        arm: Arm,
        joint: Joint,
        velocity_scaling: float,
        acceleration_scaling: float,
        allowance: Allowance,
        torque_limit: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._arm = arm
        self._joint = joint
        self._max_velocity = velocity_scaling * joint.max_velocity
        self._max_acceleration = acceleration_scaling * joint.max_acceleration
        self._allowance = allowance
        self._torque_limit = torque_limit
        self._clock = clock
        self._newest = 0
        self._turn = asyncio.Lock()
        self._motion: asyncio.Future[MotionEnded] | None = None

    def reading(self) -> GripperReading | None:
        """The latest reading; None while the arm is not read."""
        state = self._arm.state
        if state.position_rad is None or state.velocity_rad_s is None or state.load is None:
            return None
        column = state.joint_names.index(self._joint.name)
        return GripperReading(
            float(state.position_rad[column]), float(state.velocity_rad_s[column]), float(state.load[column])
        )

    def claim(self) -> int:
        """Take the gripper from whoever has it, for :meth:`move`; returns the number of the claim."""
        self._newest += 1
        self._stop_motion()
        return self._newest

    def give_up(self, claim: int) -> None:
        """End the motion of a claim, begun or not; nothing happens when another one has been made."""
        if claim == self._newest:
            self.claim()

    async def move(self, claim: int, command: GripperCommand, tell: Callable[[GripperReading], None]) -> MotionEnded:
        """Carry a command out; every wait is bounded.

        Args:
            claim: of this command.
            command: what is asked for.
            tell: called with the way of the gripper.
        """
        stops = self._arm.stops
        async with self._turn:
            await self._arm.until_started(ARM_START_TIMEOUT_S)
            if claim != self._newest or stops != self._arm.stops:
                return MotionEnded(0, Outcome.STOPPED, "stopped before the motion began")
            return await self._play(command, tell)

    def _stop_motion(self) -> None:
        if self._motion is not None:
            self._arm.stop(self._motion)

    async def _play(self, command: GripperCommand, tell: Callable[[GripperReading], None]) -> MotionEnded:
        failure = unusable(self._arm)
        if failure is not None:
            return MotionEnded(0, Outcome.REFUSED, failure.message)
        velocity = min(command.max_velocity_rad_s or self._max_velocity, self._max_velocity)
        trajectory = rest_to_rest(
            self._joint.name, self._goal_rad(), command.position_rad, velocity, self._max_acceleration
        )
        share = min(command.max_effort / self._torque_limit, 1.0) if command.max_effort else 1.0
        self._motion = self._arm.execute(trajectory, gripping=True, torque_share=share)
        ended = await self._until_ended(self._motion, self._allowance.of(trajectory.duration_s), tell)
        if ended.outcome is Outcome.GRIPPED:
            await self._until_squeezed()
        return ended

    async def _until_ended(
        self, motion: asyncio.Future[MotionEnded], left_s: float, tell: Callable[[GripperReading], None]
    ) -> MotionEnded:
        arm_time = ArmTime(self._arm, self._clock)
        while not motion.done() and left_s > 0.0:
            await asyncio.wait([motion], timeout=FEEDBACK_PERIOD_S)
            left_s -= arm_time.passed_s()
            reading = self.reading()
            if not motion.done() and reading is not None:
                tell(reading)
        if not motion.done():
            self._stop_motion()
            await self._arm.wait((motion,), BRAKING_TIMEOUT_S)
        if not motion.done():
            return MotionEnded(0, Outcome.PROCESS_LOST, "the arm did not end the gripper's motion in time")
        return motion.result()

    async def _until_squeezed(self) -> None:
        """Wait until the goal rests at its squeeze: the next motion starts there."""
        until_s = self._arm.clock_s + SQUEEZE_TIMEOUT_S
        last_rad, looked_at_s = math.inf, -math.inf
        while (now_s := self._arm.clock_s) < until_s and self._arm.state.goal_rad is not None:
            # A goal that the arm had no time to change does not rest.
            if now_s - looked_at_s >= SQUEEZE_PERIOD_S:
                goal_rad = self._goal_rad()
                if abs(goal_rad - last_rad) < SQUEEZED_WITHIN_RAD:
                    return
                last_rad, looked_at_s = goal_rad, now_s
            await asyncio.sleep(SQUEEZE_PERIOD_S)

    def _goal_rad(self) -> float:
        state = self._arm.state
        if state.goal_rad is None:
            raise AssertionError("a motion of an arm that is not read")
        return float(state.goal_rad[state.joint_names.index(self._joint.name)])

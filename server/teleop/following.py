"""A follower on the heels of its leader: the way to where the leader is, then velocities many times a second.

The follower's velocity is the leader's, and what brings it nearer to where the leader is. The planners slow it down
near contact, as they do for MoveIt Servo, and the arm process keeps the limits of velocity, acceleration and jerk.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, TypeAlias

import numpy as np

from planners.problem import PlanningFailure
from planners.servo.question import JointVelocities, ServoAnswer, ServoLimits, ServoQuestion, ServoStatus
from robot.arm_interface import ArmInterface, StreamInterface
from robot.description.model import RobotModel
from server.errors import RefusedError
from server.execution.monitors import CurrentState, check_ready
from server.teleop.leader import LeaderPose, LeaderTrack, MappedJoint

log = logging.getLogger("armbridge.teleop")

# A tick of the arm.
PERIOD_S = 0.01

# Two ticks of the arm, from reading its goals to the setpoint reaching it.
LEAD_S = 0.02

# How fast a distance to the leader is made up for [1/s]: faster, and the arm's own delay of 60 ms makes it swing.
GAIN_PER_S = 6.0

# Nearer than this, following begins at once: the rest of the way is made up for within a second [rad].
NEAR_RAD = 0.1

# A leader that goes on moving is followed by planned ways so often before it is asked to stand still.
MAX_WAYS = 4

# A leader that is silent for longer ends the following; after one that comes back earlier a planned way leads to it.
LOST_S = 2.0

# Time in which a stream that was stopped comes to rest [s].
REST_TIMEOUT_S = 3.0

# No condition number of a tip's position is so great.
NO_CONDITION = 1e9

# The gripper is sent to where the leader's is when that is so far from the goal before [rad or m].
GRIPPER_STEP = 0.04

# Plans a way of joints to positions and plays it; returns a sentence about what keeps it from that, empty when it is
# there.
Reach: TypeAlias = Callable[[Mapping[str, float]], Awaitable[str]]

# Sends the gripper to a position, in place of the goal before.
Grip: TypeAlias = Callable[[float], None]

Ask: TypeAlias = Callable[[ServoQuestion], Awaitable[ServoAnswer | PlanningFailure]]


_STUCK = "following was ended, and the follower does not come to rest"


class Phase(StrEnum):
    """What the follower does."""

    IDLE = "idle"
    APPROACHING = "approaching"
    FOLLOWING = "following"
    OPEN = "clutch open"
    WAITING = "waiting for the leader"


@dataclass(frozen=True)
class Follower:
    """Arm that follows.

    Attributes:
        name: of the arm; empty for the one of a server that has one.
        arm: the arm.
        robot: its own description.
        current: positions of all joints of the server.
        reach: plans and plays a way.
        give_up: ends the way that is played, for a reason.
        grip: sends its gripper somewhere; None for an arm without one.
    """

    name: str
    arm: ArmInterface
    robot: RobotModel
    current: CurrentState
    reach: Reach
    give_up: Callable[[str], None]
    grip: Grip | None = None

    @property
    def prefix(self) -> str:
        """What the names of its joints begin with."""
        return f"{self.name}_" if self.name else ""


@dataclass(frozen=True)
class Shown:
    """What there is to tell of the following.

    Attributes:
        phase: what the follower does.
        message: a sentence.
        latency_s: time from the leader's reading to the follower's setpoint, of the last one [s]; NaN without any.
        lag_rad: greatest distance of a joint from where the leader has it [rad]; NaN while it does not follow.
        speed_scale: share of the wanted speed that contacts leave.
    """

    phase: Phase
    message: str
    latency_s: float = math.nan
    lag_rad: float = math.nan
    speed_scale: float = 1.0


class Told(Protocol):
    """Listener of the following."""

    def show(self, shown: Shown) -> None:
        """Take what there is to tell."""

    def followed(self, position_rad: Mapping[str, float]) -> None:
        """Take the positions that the follower is to have, by its joints [rad]."""


class Following:
    """Following of one arm, from its start to its end.

    Args:
        follower: the arm that follows.
        track: of its leader.
        joints: which joints follow which.
        relative: true to follow the leader's motion from where both are, without going to where it is.
        ask: asks the planners in the present scene.
        told: listens.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        follower: Follower,
        track: LeaderTrack,
        joints: Sequence[MappedJoint],
        ask: Ask,
        told: Told,
        clock: Callable[[], float] = time.monotonic,
        *,
        relative: bool = False,
    ) -> None:
        self._follower = follower
        self._track = track
        gripper = () if follower.robot.gripper is None else follower.robot.gripper.joints
        group = follower.robot.groups[follower.robot.default_group]
        self._group = group
        self._joints = tuple(joint for joint in joints if joint.follower in group.joints)
        self._gripper = next((joint for joint in joints if joint.follower in gripper), None)
        self._relative = relative
        self._ask = ask
        self._told = told
        self._clock = clock
        # By joint of the follower, what is added to the mapped position: where a relative following began [rad].
        self._offset_rad: dict[str, float] = {}
        self._stream: StreamInterface | None = None
        self._gripper_goal = math.nan
        self._closed = True
        self._clutch = asyncio.Event()
        self._news = asyncio.Event()
        self._end = ""
        self._stops = follower.arm.stops
        self.shown = Shown(Phase.IDLE, "")

    @property
    def unmapped(self) -> bool:
        """True if no joint of the arm follows."""
        return not self._joints

    @property
    def _going(self) -> bool:
        if self._follower.arm.stops != self._stops:
            # Also one in a moment in which nothing moved.
            self._end = self._end or "stopped"
        return self._closed and not self._end

    def wake(self) -> None:
        """Have the next sample of the leader looked at at once."""
        self._news.set()

    def close_clutch(self, *, closed: bool) -> None:
        """Follow, or hold where the follower is."""
        self._closed = closed
        self._clutch.set()
        self._news.set()
        if not closed:
            self._halt("the clutch was opened")

    def stop(self, reason: str) -> None:
        """End it, for a reason."""
        self._end = self._end or reason
        self._clutch.set()
        self._news.set()
        self._halt(self._end)

    async def run(self) -> str:
        """Follow until the end; return the sentence that says why."""
        try:
            while not self._end:
                if not self._closed:
                    self._show(Phase.OPEN, "the clutch is open: the follower holds")
                    await self._clutch.wait()
                self._clutch.clear()
                if not self._going:
                    continue
                if await self._until_heard() and await self._approach() and self._going:
                    await self._follow()
        except RefusedError as error:
            self._end = self._end or str(error)
        finally:
            self._brake()
        self._show(Phase.IDLE, self._end)
        return self._end

    # Where the follower is to be.

    def _wanted_rad(self, pose: LeaderPose) -> dict[str, float]:
        """Return where the follower's joints are to be, within their limits [rad]."""
        wanted = {}
        for joint in self._joints:
            limits = self._follower.robot.joints[joint.follower]
            position = joint.factor * pose.position_rad[joint.leader] + self._offset_rad.get(joint.follower, 0.0)
            wanted[joint.follower] = min(max(position, limits.lower), limits.upper)
        return wanted

    def _held_rad(self) -> dict[str, float]:
        held_rad = self._follower.current.positions_rad()
        return {} if held_rad is None else held_rad

    async def _until_heard(self) -> bool:
        """Wait for a sample of the leader, for a time; end the following when none comes."""
        until_s = self._clock() + LOST_S
        while self._track.pose(self._clock()) is None:
            if not self._going:
                return False
            if self._clock() >= until_s:
                self._end = f"the leader has sent nothing for {LOST_S:g} s"
                return False
            self._show(Phase.WAITING, "the leader sends nothing: the follower holds")
            await self._until_news()
        return True

    async def _until_news(self) -> None:
        self._news.clear()
        try:
            async with asyncio.timeout(PERIOD_S):
                await self._news.wait()
        except TimeoutError:
            return

    async def _approach(self) -> bool:
        """Go to where the leader is, by planned ways; return False when it goes on without that."""
        check_ready(self._follower.arm)
        self._track.jumped = ""
        if self._relative:
            pose = self._track.pose(self._clock())
            if pose is None:
                return False
            held_rad = self._held_rad()
            self._offset_rad = {
                joint.follower: held_rad[joint.follower] - joint.factor * pose.position_rad[joint.leader]
                for joint in self._joints
            }
            return True
        for _ in range(MAX_WAYS):
            pose = self._track.pose(self._clock())
            if pose is None or not self._going:
                return False
            wanted, held_rad = self._wanted_rad(pose), self._held_rad()
            if all(abs(held_rad[name] - value) < NEAR_RAD for name, value in wanted.items()):
                return True
            self._show(Phase.APPROACHING, "the follower goes to where the leader is")
            if refused := await self._follower.reach(wanted):
                if self._closed:
                    self.stop(f"the follower did not come to where the leader is: {refused}")
                return False
        self._end = "the leader moved on each time the follower came: hold it still, and start again"
        return False

    # Following.

    async def _follow(self) -> None:
        """Follow until the clutch opens, the leader is silent, or the stream ends."""
        stream = self._stream = self._follower.arm.stream(self._group.joints)
        velocity_rad_s: Mapping[str, float] = {}
        silent = False
        try:
            while not stream.ended.done() and self._going:
                pose = self._track.pose(self._clock())
                if self._track.jumped:
                    self._end = f"{self._track.jumped}; the follower holds"
                    break
                if pose is None:
                    # Without setpoints the arm process brakes softly by itself.
                    silent = True
                    break
                velocity_rad_s = await self._step(stream, pose, velocity_rad_s)
                await self._until_news()
        finally:
            self._brake()
            await self._follower.arm.wait((stream.ended,), REST_TIMEOUT_S)
            self._stream = None
        if not silent and self._closed:
            self.stop(f"following was ended: {stream.ended.result().message}" if stream.ended.done() else _STUCK)

    async def _step(
        self, stream: StreamInterface, pose: LeaderPose, before_rad_s: Mapping[str, float]
    ) -> Mapping[str, float]:
        """Send one setpoint; return its velocities [rad/s]."""
        wanted, positions = self._wanted_rad(pose), self._held_rad()
        commanded = stream.commanded
        if commanded is not None:
            ahead = commanded.position_rad + LEAD_S * commanded.velocity_rad_s
            positions |= dict(zip(stream.joint_names, ahead.tolist(), strict=True))
        velocities = {
            joint.follower: following_velocity(
                wanted[joint.follower],
                joint.factor * pose.velocity_rad_s[joint.leader],
                positions[joint.follower],
                self._follower.robot.joints[joint.follower].max_velocity,
            )
            for joint in self._joints
        }
        question = ServoQuestion(
            self._group.name,
            self._group.tip_link,
            positions,
            before_rad_s,
            PERIOD_S,
            JointVelocities(velocities),
            None,
            # The leader's arm says what is singular: joints are followed, not the tip.
            ServoLimits(singularity_slow=NO_CONDITION, singularity_stop=2.0 * NO_CONDITION),
        )
        answer = await self._ask(question)
        self._grip(pose)
        self._told.followed(wanted)
        if isinstance(answer, PlanningFailure):
            stream.steer(np.zeros(len(stream.joint_names)))
            self._show(Phase.FOLLOWING, answer.message, speed_scale=0.0)
            return {}
        stream.steer(np.array([answer.velocity_rad_s[name] for name in stream.joint_names]))
        slowed = answer.status in (ServoStatus.DECELERATE_FOR_COLLISION, ServoStatus.HALT_FOR_COLLISION)
        self._show(
            Phase.FOLLOWING,
            answer.message if slowed else "the follower follows",
            latency_s=self._clock() - pose.stamp_s,
            lag_rad=max(abs(wanted[name] - positions[name]) for name in wanted),
            speed_scale=speed_share(velocities, answer.velocity_rad_s) if slowed else 1.0,
        )
        return answer.velocity_rad_s

    def _grip(self, pose: LeaderPose) -> None:
        """Send the gripper after that of the leader, by motions of its own: they end when it holds something."""
        if self._gripper is None or self._follower.grip is None:
            return
        limits = self._follower.robot.joints[self._gripper.follower]
        goal = min(max(pose.position_rad[self._gripper.leader], limits.lower), limits.upper)
        if not abs(goal - self._gripper_goal) < GRIPPER_STEP:
            self._gripper_goal = goal
            self._follower.grip(goal)

    def _halt(self, reason: str) -> None:
        """End the motion in progress, be it on the way to the leader or after it."""
        self._brake()
        if self.shown.phase is Phase.APPROACHING:
            self._follower.give_up(reason)

    def _brake(self) -> None:
        if self._stream is not None and not self._stream.ended.done():
            self._follower.arm.stop(self._stream.ended)

    def _show(
        self,
        phase: Phase,
        message: str,
        latency_s: float = math.nan,
        lag_rad: float = math.nan,
        speed_scale: float = 1.0,
    ) -> None:
        self.shown = Shown(phase, message, latency_s, lag_rad, speed_scale)
        self._told.show(self.shown)


def following_velocity(wanted_rad: float, leader_rad_s: float, now_rad: float, limit_rad_s: float) -> float:
    """Return the velocity that keeps a joint with its leader [rad/s].

    Args:
        wanted_rad: where the leader has it [rad].
        leader_rad_s: velocity that the leader has [rad/s].
        now_rad: goal of the joint [rad].
        limit_rad_s: its velocity limit, which is kept [rad/s].
    """
    velocity = leader_rad_s + GAIN_PER_S * (wanted_rad - now_rad)
    return min(max(velocity, -limit_rad_s), limit_rad_s)


def speed_share(wanted_rad_s: Mapping[str, float], left_rad_s: Mapping[str, float]) -> float:
    """Return the share of the wanted velocities that is left, by the fastest joint."""
    fastest = max(wanted_rad_s, key=lambda name: abs(wanted_rad_s[name]))
    wanted = abs(wanted_rad_s[fastest])
    return 1.0 if wanted < math.radians(0.1) else min(abs(left_rad_s[fastest]) / wanted, 1.0)

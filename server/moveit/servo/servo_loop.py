"""Servo loop"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Point, Pose
from planners.servo.question import (
    Anchor,
    JointVelocities,
    ServoAnswer,
    ServoCommand,
    ServoLimits,
    ServoQuestion,
    ServoStatus,
    TipTarget,
    TipTwist,
)
from robot.arm import Arm
from robot.arm_stream import ArmStream
from robot.trajectory import Vector
from server.moveit.poses import composed, matrix_of, read_pose
from server.moveit.servo.parameters import ServoParameters

Message: TypeAlias = Mapping[str, Any]
Positions: TypeAlias = Mapping[str, float]

# Name of a frame and positions of the joints [rad] -> its pose in the root link.
Resolve: TypeAlias = Callable[[str, Positions], Pose | PlanningFailure]

UNITLESS = "unitless"

# Sticks that are a little out of tune.
UNITLESS_TOLERANCE = 1e-3


@dataclass(frozen=True)
class FramedTwist:
    """A twist along the axes of a frame, which may move with the arm; [m/s], [rad/s]."""

    linear_m_s: Point
    angular_rad_s: Point
    frame_id: str


Wanted: TypeAlias = FramedTwist | JointVelocities | TipTarget


def read_twist(message: Message, parameters: ServoParameters) -> FramedTwist | PlanningFailure:
    """Read a geometry_msgs/TwistStamped."""
    twist = message["twist"]
    parts = []
    for part, scale in (("linear", parameters.linear_scale), ("angular", parameters.rotational_scale)):
        values = {f"twist.{part}.{axis}": float(twist[part][axis]) for axis in "xyz"}
        scaled = _scaled(values, scale, parameters)
        if isinstance(scaled, PlanningFailure):
            return scaled
        parts.append((scaled[0], scaled[1], scaled[2]))
    return FramedTwist(parts[0], parts[1], message["header"]["frame_id"])


def read_joint_jog(
    message: Message, joints: Sequence[str], parameters: ServoParameters
) -> JointVelocities | PlanningFailure:
    """Read a control_msgs/JointJog.

    Args:
        message: the message; its displacements are not followed.
        joints: those that can be steered.
        parameters: scale of the velocities.
    """
    names, velocities = message["joint_names"], message["velocities"]
    if len(names) != len(velocities) or not names:
        also = "; displacements are not followed" if message["displacements"] else ""
        return _refused(f"velocities has {len(velocities)} values for {len(names)} joint_names{also}", "velocities")
    for name in names:
        if name not in joints:
            return _refused(f"joint_names has {name!r}; joints that can be steered: {', '.join(joints)}", "joint_names")
    if len(set(names)) < len(names):
        return _refused(f"joint_names has a joint twice: {', '.join(names)}", "joint_names")
    values = {f"velocities of {name}": float(value) for name, value in zip(names, velocities, strict=True)}
    scaled = _scaled(values, parameters.joint_scale, parameters)
    if isinstance(scaled, PlanningFailure):
        return scaled
    return JointVelocities(dict(zip(names, scaled, strict=True)))


def read_pose_target(message: Message, resolve: Resolve, positions_rad: Positions) -> TipTarget | PlanningFailure:
    """Read a geometry_msgs/PoseStamped; a frame that moves with the arm counts as it is now.

    Args:
        message: the message.
        resolve: finds its frame.
        positions_rad: where every movable joint is told to be now [rad].
    """
    pose = read_pose(message["pose"], "pose")
    if isinstance(pose, PlanningFailure):
        return pose
    frame = resolve(message["header"]["frame_id"], positions_rad)
    return frame if isinstance(frame, PlanningFailure) else TipTarget(composed(frame, pose))


def in_root_link(wanted: Wanted, resolve: Resolve, positions_rad: Positions) -> ServoCommand | PlanningFailure:
    """What is wanted as the planners take it; a twist turns with its frame.

    Args:
        wanted: what is wanted.
        resolve: finds its frame.
        positions_rad: where every movable joint is told to be now [rad].
    """
    if not isinstance(wanted, FramedTwist):
        return wanted
    frame = resolve(wanted.frame_id, positions_rad)
    if isinstance(frame, PlanningFailure):
        return frame
    turn = matrix_of(frame)[:3, :3]
    return TipTwist(_turned(turn, wanted.linear_m_s), _turned(turn, wanted.angular_rad_s))


def rest_of(command: ServoCommand) -> ServoCommand:
    """What is wanted once a command holds no more: what a twist does not move stays where it is."""
    return TipTwist() if isinstance(command, TipTwist) else JointVelocities({})


def _turned(turn: Vector, vector: Point) -> Point:
    x, y, z = (turn @ np.array(vector)).tolist()
    return x, y, z


def _scaled(values: Mapping[str, float], scale: float, parameters: ServoParameters) -> list[float] | PlanningFailure:
    """Values as speeds; ``values`` are named for refusals."""
    unitless = parameters.command_in_type == UNITLESS
    for name, value in values.items():
        if not math.isfinite(value):
            return _refused(f"{name} must be a finite number, not {value}", name)
        if unitless and abs(value) > 1.0 + UNITLESS_TOLERANCE:
            return _refused(f"{name} must be -1 to 1, a share of {scale:g} a second, not {value:g}", name)
    return [value * scale if unitless else value for value in values.values()]


def _refused(message: str, field: str) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, {"field": field})


log = logging.getLogger("armbridge.servo")

Ask: TypeAlias = Callable[[ServoQuestion], Awaitable[ServoAnswer | PlanningFailure]]
Tell: TypeAlias = Callable[[ServoStatus, str], None]

# From where the joints were told to be to where they are when the answer reaches them: two ticks of the arm.
LEAD_S = 0.02

# An arm that nobody wants to move is let go of after this time; a stick that passes its middle is not.
REST_S = 0.3
RESTING_RAD_S = 0.02


@dataclass(frozen=True)
class Steered:
    """What is steered, and how.

    Attributes:
        group: the planning group.
        joints: its joints.
        link: the tip.
        limits: how steering is bounded.
        period_s: time between two setpoints [s].
        timeout_s: a wish holds for so long [s].
    """

    group: str
    joints: tuple[str, ...]
    link: str
    limits: ServoLimits
    period_s: float
    timeout_s: float


class ServoSession:
    """Steers one group of joints.

    Args:
        arm: the arm.
        steered: what is steered.
        ask: the planners.
        resolve: finds frames.
        tell: called with status and message after every step.
        interrupted: called with the reason when somebody else has stopped the arm.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        arm: Arm,
        steered: Steered,
        ask: Ask,
        resolve: Resolve,
        tell: Tell,
        interrupted: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._arm = arm
        self._steered = steered
        self._ask, self._resolve = ask, resolve
        self._tell, self._interrupted = tell, interrupted
        self._clock = clock
        self._wanted: Wanted = JointVelocities({})
        self._wanted_at_s = -math.inf
        self._task: asyncio.Task[None] | None = None
        self._stream: ArmStream | None = None
        self._released = False

    def positions_rad(self) -> dict[str, float]:
        """Where every movable joint is told to be [rad]."""
        state = self._arm.state
        if state.goal_rad is None:
            return {}
        held = dict(zip(state.joint_names, state.goal_rad.tolist(), strict=True))
        commanded = self._stream.commanded if self._stream is not None else None
        if commanded is not None:
            ahead = commanded.position_rad + LEAD_S * commanded.velocity_rad_s
            held |= dict(zip(self._steered.joints, ahead.tolist(), strict=True))
        return held

    def want(self, wanted: Wanted) -> None:
        """Take a wish; the arm is taken in hand if it is not."""
        self._wanted, self._wanted_at_s = wanted, self._clock()
        if self._task is None:
            self._task = asyncio.create_task(self._steer(), name="servo")

    def release(self) -> None:
        """Bring the arm to rest and let go of it; what was wanted is forgotten."""
        self._wanted_at_s = -math.inf
        if self._stream is not None:
            self._released = True
            self._arm.stop(self._stream.ended)

    async def close(self) -> None:
        """End at once; the arm is brought to rest by itself."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

    async def _steer(self) -> None:
        self._released = False
        self._stream = self._arm.stream(self._steered.joints)
        try:
            await self._until_ended(self._stream)
            ended = self._stream.ended.result()
        except Exception:  # a bug must not leave the arm in hands that have gone
            log.exception("steering failed")
            self.release()
            self._tell(ServoStatus.INVALID, "steering failed inside the server")
            return
        finally:
            self._stream = self._task = None
        if self._released:
            self._tell(ServoStatus.NO_WARNING, "")
            return
        self._tell(ServoStatus.INVALID, f"steering was ended: {ended.message}")
        self._interrupted(f"steering was ended: {ended.message}")

    async def _until_ended(self, stream: ArmStream) -> None:
        velocity: Mapping[str, float] = {}
        anchor: Anchor | None = None
        kind: type[ServoCommand] | None = None
        rested_s = 0.0
        while not stream.ended.done():
            due_s = self._clock() + self._steered.period_s
            positions_rad = self.positions_rad()
            found = self._command(positions_rad)
            command = JointVelocities({}) if isinstance(found, PlanningFailure) else found
            anchor = anchor if type(command) is kind else None
            kind = type(command)
            answer = await self._answer(positions_rad, velocity, command, anchor)
            velocity, anchor = answer.velocity_rad_s, answer.anchor
            if isinstance(found, PlanningFailure):
                self._tell(ServoStatus.INVALID, found.message)
            else:
                self._tell(answer.status, answer.message)
            stream.steer(np.array([velocity[name] for name in self._steered.joints]))
            resting = command.zero and max(map(abs, velocity.values())) < RESTING_RAD_S
            rested_s = rested_s + self._steered.period_s if resting else 0.0
            if rested_s > REST_S:
                self.release()
            await asyncio.wait([stream.ended], timeout=max(due_s - self._clock(), 0.0))

    def _command(self, positions_rad: Mapping[str, float]) -> ServoCommand | PlanningFailure:
        """What is wanted now, in the root link; rest when it has been wanted too long ago."""
        command = in_root_link(self._wanted, self._resolve, positions_rad)
        if isinstance(command, PlanningFailure) or self._clock() - self._wanted_at_s <= self._steered.timeout_s:
            return command
        return rest_of(command)

    async def _answer(
        self,
        positions_rad: Mapping[str, float],
        velocity: Mapping[str, float],
        command: ServoCommand,
        anchor: Anchor | None,
    ) -> ServoAnswer:
        """The planners' answer; rest when they have none."""
        question = ServoQuestion(
            self._steered.group,
            self._steered.link,
            positions_rad,
            velocity,
            self._steered.period_s,
            command,
            anchor,
            self._steered.limits,
        )
        answer = await self._ask(question)
        if isinstance(answer, PlanningFailure):
            return ServoAnswer(dict.fromkeys(self._steered.joints, 0.0), ServoStatus.INVALID, answer.message, 0.0)
        return answer

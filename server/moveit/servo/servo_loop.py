"""Servo loop of MoveIt Servo: from messages of commands to velocities of the joints, many times a second."""

import asyncio
import contextlib
import logging
import math
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from planners.problem import PlanningFailure
from planners.scene import Point, Pose
from planners.servo.question import (
    MAX_PERIOD_S,
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
from robot.arm import ArmStream
from robot.arm_group import AnyArm
from robot.messages import Outcome
from robot.trajectory import Vector
from server.arrival import arrival_epoch
from server.errors import RefusedError, invalid
from server.execution.motions import Positions
from server.lifecycle import end_task
from server.moveit.messages import Message, composed, matrix_of, read_pose
from server.moveit.parameters import ServoParameters
from server.moveit.requests.planning_context import PlanningContext

log = logging.getLogger("armbridge.servo")


# Returns the pose of a frame in the root link, for positions of the joints [rad]; raises RefusedError.
Resolve: TypeAlias = Callable[[str, Positions], Pose]

# Has the planners answer a question.
Ask: TypeAlias = Callable[[ServoQuestion], Awaitable[ServoAnswer | PlanningFailure]]

UNITLESS = "unitless"

# Sticks are not calibrated exactly.
UNITLESS_TOLERANCE = 1e-3

# From the arm's goals, as they were read, to where velocities take effect: two ticks, and as long again because the arm
# rounds its corners. With two ticks alone, random sticks on an SO-101 came to 0.6 mm of a table that is kept 5 mm away;
# with four, the nearest of 16 runs came to 7.8 mm.
LEAD_S = 0.04

# While the planners answer, the arm goes on by the velocities of the answer before. Distances grow with the latency by
# this [m/s]: without it a follower that was led through folded poses came to 0.1 mm of itself at a latency of 0.095 s,
# where 3 mm are kept; with it to 5 mm (test_latency.py, seed 9).
CLEARANCE_M_PER_S = 0.03

# The planners' latency counts for this number of answers: an increase counts at once, a decrease later.
LATENCY_ANSWERS = 10

# The arm ends a stream without setpoints after 0.06 s. While the planners' answer is not there, the loop repeats the
# last setpoint so often, and brakes when the answer is too late to be carried out: steering goes on with the next one.
KEEP_ALIVE_S = 0.035

# Periods after which a step is made without a command, where commands are followed when they come.
LATE = 1.5

# An arm at rest is released after this time, which is longer than a stick takes to pass its center.
REST_S = 0.3
RESTING_RAD_S = 0.02


@dataclass(frozen=True)
class TwistCommand(TipTwist):
    """Twist in a frame that may move with the arm; an empty frame is the root link."""

    frame_id: str = ""


# MoveIt Servo's name for any of its commands.
ServoInput: TypeAlias = TwistCommand | JointVelocities | TipTarget


@dataclass(frozen=True)
class ServoSetup:
    """Setup of a servo loop, which follows a new command ``at_once`` or at the next period."""

    group: str
    joints: tuple[str, ...]
    link: str
    limits: ServoLimits
    period_s: float
    timeout_s: float
    at_once: bool = False


def read_twist(message: Message, parameters: ServoParameters) -> TwistCommand:
    """Read a geometry_msgs/TwistStamped."""
    linear = _scaled_vector(message, "linear", parameters.linear_scale, parameters)
    angular = _scaled_vector(message, "angular", parameters.rotational_scale, parameters)
    return TwistCommand(linear, angular, message["header"]["frame_id"])


def read_joint_jog(message: Message, joints: Sequence[str], parameters: ServoParameters) -> JointVelocities:
    """Read the velocities of a control_msgs/JointJog; its displacements are not followed."""
    names, velocities = message["joint_names"], message["velocities"]
    if len(names) != len(velocities) or not names:
        also = "; displacements are not followed" if message["displacements"] else ""
        text = f"velocities has {len(velocities)} values for {len(names)} joint_names{also}"
        raise invalid(text, field="velocities")
    for name in names:
        if name not in joints:
            text = f"joint_names has {name!r}; joints that can be steered: {', '.join(joints)}"
            raise invalid(text, field="joint_names")
    if len(set(names)) < len(names):
        raise invalid(f"joint_names has a joint twice: {', '.join(names)}", field="joint_names")
    values = {f"velocities of {name}": float(value) for name, value in zip(names, velocities, strict=True)}
    return JointVelocities(dict(zip(names, _scaled(values, parameters.joint_scale, parameters), strict=True)))


def read_pose_target(message: Message, resolve: Resolve, positions_rad: Positions) -> TipTarget:
    """Read a geometry_msgs/PoseStamped; a frame that moves with the arm is taken where it is now."""
    pose = read_pose(message["pose"], "pose")
    return TipTarget(composed(resolve(message["header"]["frame_id"], positions_rad), pose))


def _with_clearance(limits: ServoLimits, clearance_m: float) -> ServoLimits:
    own_m, scene_m = limits.self_distance_m, limits.scene_distance_m
    return replace(
        limits,
        self_distance_m=None if own_m is None else own_m + clearance_m,
        scene_distance_m=None if scene_m is None else scene_m + clearance_m,
    )


def _rotated(rotation: Vector, vector: Point) -> Point:
    x, y, z = (rotation @ np.array(vector)).tolist()
    return x, y, z


def _scaled_vector(message: Message, part: str, scale: float, parameters: ServoParameters) -> Point:
    values = {f"twist.{part}.{axis}": float(message["twist"][part][axis]) for axis in "xyz"}
    x, y, z = _scaled(values, scale, parameters)
    return x, y, z


def _scaled(values: Mapping[str, float], scale: float, parameters: ServoParameters) -> list[float]:
    unitless = parameters.command_in_type == UNITLESS
    for name, value in values.items():
        if not math.isfinite(value):
            raise invalid(f"{name} must be a finite number, not {value}", field=name)
        if unitless and abs(value) > 1.0 + UNITLESS_TOLERANCE:
            raise invalid(f"{name} must be -1 to 1, a share of {scale:g} a second, not {value:g}", field=name)
    return [value * scale if unitless else value for value in values.values()]


class ServoSession:
    """Servo loop of one group of joints. It controls the arm from a command until the arm has come to rest.

    ``publish_status`` takes the status of every step, ``interrupted`` the reason of a stop from elsewhere.
    Without ``ask`` the planners of ``planning`` answer.
    """

    def __init__(
        self,
        arm: AnyArm,
        setup: ServoSetup,
        planning: PlanningContext,
        publish_status: Callable[[ServoStatus, str], None],
        interrupted: Callable[[str], None],
        ask: Ask | None = None,
    ) -> None:
        self._arm = arm
        self._current = planning.current
        self._setup = setup
        self._ask, self._resolve = ask or planning.ask, planning.frames.resolve
        self._publish_status, self._interrupted = publish_status, interrupted
        self._clock = planning.clock
        self._input: ServoInput = JointVelocities({})
        self._expires_at_s = -math.inf
        self._task: asyncio.Task[None] | None = None
        self._stream: ArmStream | None = None
        self._released = False
        self._latencies_s: deque[float] = deque(maxlen=LATENCY_ANSWERS)
        # Set by what the next step does not wait for: the end of the stream, and a command that is followed at once.
        self._due = asyncio.Event()
        self._longest_s = (LATE if setup.at_once else 1.0) * setup.period_s

    @property
    def latency_s(self) -> float:
        """Longest that one of the last answers took, up to the time after which answers are not carried out [s]."""
        return min(max(self._latencies_s, default=0.0), MAX_PERIOD_S)

    def positions_rad(self) -> dict[str, float]:
        """Return the position of every movable joint [rad]: where it is commanded to be when the next answer comes."""
        state = self._arm.state
        if state.goal_rad is None:
            return {}
        positions = (self._current.positions_rad() or {}) | dict(
            zip(state.joint_names, state.goal_rad.tolist(), strict=True)
        )
        commanded = self._stream.commanded if self._stream is not None else None
        if commanded is not None:
            ahead = commanded.position_rad + (LEAD_S + self.latency_s) * commanded.velocity_rad_s
            positions |= dict(zip(self._setup.joints, ahead.tolist(), strict=True))
        return positions

    def set_command(self, command: ServoInput, timeout_s: float = math.inf) -> None:
        """Follow a command until ``timeout_s`` or the loop's own timeout; start the loop if it is not running."""
        self._input = command
        self._expires_at_s = self._clock() + min(timeout_s, self._setup.timeout_s)
        if command.zero and self._stream is not None:
            # The next step may be a period away, or wait for the planners.
            self._stream.steer(np.zeros(len(self._setup.joints)))
        if self._setup.at_once:
            self._due.set()
        if self._task is None:
            self._task = asyncio.create_task(self._run(), name="servo")

    def release(self) -> None:
        """Drop the command, bring the arm to rest and end the loop."""
        self._expires_at_s = -math.inf
        if self._stream is not None:
            self._released = True
            self._arm.stop(self._stream.ended)

    async def close(self) -> None:
        """End the loop at once; the arm comes to rest by itself."""
        await end_task(self._task)

    async def _run(self) -> None:
        self._released = False
        # The epoch of the command that has started this task.
        self._stream = self._arm.stream(self._setup.joints, epoch=arrival_epoch())
        self._stream.ended.add_done_callback(lambda _ended: self._due.set())
        try:
            await self._follow_commands(self._stream)
            ended = self._stream.ended.result()
        except Exception:  # a bug must not leave the arm under the control of a loop that has ended
            log.exception("steering failed")
            self.release()
            self._publish_status(ServoStatus.INVALID, "steering failed inside the server")
            return
        finally:
            self._stream = self._task = None
        if self._released:
            self._publish_status(ServoStatus.NO_WARNING, "")
            return
        self._publish_status(ServoStatus.INVALID, f"steering was ended: {ended.message}")
        # After a pause of the server's own nobody has to let go: the next command steers again.
        if ended.outcome is not Outcome.UNSTEERED:
            self._interrupted(f"steering was ended: {ended.message}")

    async def _follow_commands(self, stream: ArmStream) -> None:
        velocity: Mapping[str, float] = {}
        anchor: Anchor | None = None
        kind: type[ServoCommand] | None = None
        rested_s = 0.0
        while not stream.ended.done():
            due_s = self._clock() + self._longest_s
            self._due.clear()
            positions_rad = self.positions_rad()
            error = ""
            try:
                command = self._command(positions_rad)
            except RefusedError as rejected:
                command, error = JointVelocities({}), str(rejected)
            anchor = anchor if type(command) is kind else None
            kind = type(command)
            answer = await self._answer(stream, positions_rad, velocity, command, anchor)
            velocity, anchor = answer.velocity_rad_s, answer.anchor
            self._publish_status(*((ServoStatus.INVALID, error) if error else (answer.status, answer.message)))
            stream.steer(np.array([velocity[name] for name in self._setup.joints]))
            resting = command.zero and max(map(abs, velocity.values())) < RESTING_RAD_S
            rested_s = rested_s + self._setup.period_s if resting else 0.0
            if rested_s > REST_S:
                self.release()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(max(due_s - self._clock(), 0.0)):
                    await self._due.wait()

    def _command(self, positions_rad: Positions) -> ServoCommand:
        """Return the command to follow now, in the root link; a halt if the last command has expired or is zero."""
        command: ServoInput | ServoCommand = self._input
        if isinstance(command, TwistCommand):
            # A twist turns with its frame. An unknown frame is refused, also when the command has expired.
            rotation = matrix_of(self._resolve(command.frame_id, positions_rad))[:3, :3]
            command = TipTwist(_rotated(rotation, command.linear_m_s), _rotated(rotation, command.angular_rad_s))
        return JointVelocities({}) if self._halted else command

    @property
    def _halted(self) -> bool:
        return self._clock() > self._expires_at_s or self._input.zero

    async def _answer(
        self,
        stream: ArmStream,
        positions_rad: Positions,
        velocity: Mapping[str, float],
        command: ServoCommand,
        anchor: Anchor | None,
    ) -> ServoAnswer:
        """Ask the planners; where they fail, or are so late that the arm is elsewhere by now, velocities are 0.

        A halt needs no planners: joints that all brake alike keep the tip on its path, as in a stop. An SO-101 whose
        tip was held where it was at a zero twist came to rest after 0.3 to 0.7 s. A stop takes 0.15 s.
        """
        halt = ServoAnswer(dict.fromkeys(self._setup.joints, 0.0))
        if command.zero:
            return halt
        question = ServoQuestion(
            self._setup.group,
            self._setup.link,
            positions_rad,
            velocity,
            max(self._setup.period_s, self.latency_s),
            command,
            anchor,
            _with_clearance(self._setup.limits, CLEARANCE_M_PER_S * self.latency_s),
        )
        asked_s = self._clock()
        asking = asyncio.ensure_future(self._ask(question))
        try:
            while not (await asyncio.wait([asking], timeout=KEEP_ALIVE_S))[0]:
                braking = self._halted or self._clock() - asked_s > MAX_PERIOD_S
                stream.steer(np.array([0.0 if braking else velocity.get(name, 0.0) for name in self._setup.joints]))
            answer = asking.result()
        finally:
            asking.cancel()
        took_s = self._clock() - asked_s
        self._latencies_s.append(took_s)
        if isinstance(answer, PlanningFailure):
            refusal = answer.message
        elif took_s > MAX_PERIOD_S:
            refusal = f"the planners took {took_s:.2f} s for an answer, more than {MAX_PERIOD_S:g} s: the arm brakes"
        else:
            # A halt that has come meanwhile counts more than an answer to the command before.
            return halt if self._input.zero else answer
        return replace(halt, status=ServoStatus.INVALID, message=refusal, share=0.0)

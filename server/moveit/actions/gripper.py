"""Gripper of one or two fingers: its motions and its actions.

The newest command wins, and a stall on the way is a grip. ros2_control's two gripper controllers both call their action
``gripper_cmd``, below the controller's name; so each has a controller's name of its own here. Fetch's driver calls it
``gripper_action``.
"""

import asyncio
import functools
import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from planners.problem import MoveItErrorCode
from protocol.messages import ListLimits
from robot.description.model import Joint
from robot.messages import MotionEnded, Outcome
from robot.trajectory import Trajectory, Vector, rest_to_rest
from server.arrival import is_stopped
from server.errors import RefusedError, ServerError, invalid
from server.execution.goal import BRAKING_TIMEOUT_S, CancelScope, ExecutionDeadline, MotionWatch
from server.execution.monitors import ARM_START_TIMEOUT_S, check_ready
from server.execution.motions import MotionsInProgress
from server.graph.actions import ActionGoal, GoalStatus
from server.graph.permissions import GOAL
from server.graph.topics import LocalGraph
from server.moveit.actions.goal_bridge import cancel_with_goal, work_on
from server.moveit.messages import Message
from server.moveit.requests.planning_context import GoalContext

log = logging.getLogger("armbridge.gripper")

FEEDBACK_PERIOD_S = 0.1

# A tick of the arm process.
STEERING_PERIOD_S = 0.01

# Of the arm's clock. A grip takes the goal back from behind the object, a step a tick: half a second for the whole way.
SQUEEZE_TIMEOUT_S = 1.0
SQUEEZE_PERIOD_S = 0.04
SQUEEZED_WITHIN_RAD = 0.005

GRIPPER_ACTION = "/gripper_controller/gripper_cmd"
FETCH_ACTION = "/gripper_controller/gripper_action"
PARALLEL_ACTION = "/parallel_gripper_controller/gripper_cmd"
ACTIONS = (GRIPPER_ACTION, FETCH_ACTION, PARALLEL_ACTION)

# Distance by which a URDF's limit may lie beyond the soft limit; a command for it means the soft limit.
CLAMPED_WITHIN_RAD, CLAMPED_WITHIN_M = 0.05, 0.005

# Positions of two fingers that a client means to be the same may differ by its rounding [rad or m].
SAME_POSITION = 1e-6

# Longest way of a finger that counts as none [rad or m].
SHORTEST_WAY = 1e-6

STATUS_OF_OUTCOME = {
    Outcome.REACHED: GoalStatus.SUCCEEDED,
    Outcome.GRIPPED: GoalStatus.SUCCEEDED,
    Outcome.STOPPED: GoalStatus.CANCELED,
}


@dataclass(frozen=True)
class GripperCommand:
    """Command to the gripper."""

    position: float  # goal position of each finger, within its joint's limits [rad or m]
    max_effort: float = 0.0  # share of full motor duty, as in ``effort`` of ``/joint_states``; 0 for the limit
    max_velocity: float = 0.0  # of each finger, 0 for the velocity of planned motions [rad/s or m/s]


@dataclass(frozen=True)
class GripperReading:
    """Positions [rad or m], velocities [rad/s or m/s] and efforts, in the order of the gripper's joints."""

    positions: tuple[float, ...]
    velocities: tuple[float, ...]
    efforts: tuple[float, ...]


class Gripper:
    """Gripper of one or two fingers, which all go to the same position within the limits of their joints."""

    def __init__(
        self, context: GoalContext, names: Sequence[str], torque_limit: float, in_progress: MotionsInProgress
    ) -> None:
        parameters, planning = context.parameters, context.planning
        self._arm, self._names = context.arm.part(names), tuple(names)
        self.joints = tuple(context.robot.joints[name] for name in names)
        self._velocity_scaling, self._torque_limit = parameters.max_velocity_scaling, torque_limit
        slowest = min(joint.max_acceleration for joint in self.joints)
        self._max_acceleration = parameters.max_acceleration_scaling * slowest
        self._time_limits, self._clock, self._in_progress = planning.time_limits, planning.clock, in_progress
        self._newest: CancelScope | None = None
        self._turn = asyncio.Lock()
        self._motion: asyncio.Future[MotionEnded] | None = None
        self._ends_s = 0.0

    @property
    def remaining_s(self) -> float | None:
        """Time left of the motion, as far as its speed is not changed [s]; None when there is none."""
        if self._motion is None or self._motion.done():
            return None
        return max(self._ends_s - self._clock(), 0.0)

    def reading(self) -> GripperReading | None:
        """Return the latest reading; None while the arm is not read."""
        state = self._arm.state
        if state.position_rad is None or state.velocity_rad_s is None or state.load is None:
            return None
        columns = [state.joint_names.index(name) for name in self._names]
        positions, velocities, efforts = (
            tuple(values[columns].tolist()) for values in (state.position_rad, state.velocity_rad_s, state.load)
        )
        return GripperReading(positions, velocities, efforts)

    def claim(self) -> CancelScope:
        """Claim the gripper for the request in progress; a request that a stop has overtaken replaces no other."""
        claim = CancelScope(deadline=ExecutionDeadline(self._time_limits))
        if not is_stopped(self._arm.last_stop, claim.epoch):
            if self._newest is not None:
                self._newest.cancel("a newer command has come")
            self._newest = claim
        return claim

    async def move(
        self, claim: CancelScope, command: GripperCommand, report: Callable[[GripperReading], None]
    ) -> MotionEnded:
        """Execute a command; every wait is bounded."""
        async with self._turn:
            await self._arm.until_started(ARM_START_TIMEOUT_S)
            if claim.reason or is_stopped(self._arm.last_stop, claim.epoch):
                return MotionEnded(0, Outcome.STOPPED, "stopped before the motion began")
            return await self._play(claim, command, report)

    async def follow(self, claim: CancelScope, velocities: Callable[[Vector], Vector]) -> MotionEnded:
        """Follow finger velocities, made from the goals, until the claim is cancelled or a finger stalls."""
        async with self._turn:
            if claim.reason or is_stopped(self._arm.last_stop, claim.epoch):
                return MotionEnded(0, Outcome.STOPPED, "stopped before the motion began")
            check_ready(self._arm)
            stream = self._arm.stream(self._names, epoch=claim.epoch, gripping=True)
            awaited: tuple[asyncio.Future[Any], ...] = (stream.ended, claim.cancelled)
            try:
                while not stream.ended.done() and not claim.reason:
                    goals = self._goals() if stream.commanded is None else stream.commanded.position_rad
                    stream.steer(velocities(goals))
                    await asyncio.wait(awaited, timeout=STEERING_PERIOD_S, return_when=asyncio.FIRST_COMPLETED)
            finally:
                self._arm.stop(stream.ended)
            if not await self._arm.wait((stream.ended,), BRAKING_TIMEOUT_S):
                return MotionEnded(0, Outcome.PROCESS_LOST, "the arm did not end the gripper's motion in time")
            return stream.ended.result()

    async def _play(
        self, claim: CancelScope, command: GripperCommand, report: Callable[[GripperReading], None]
    ) -> MotionEnded:
        check_ready(self._arm)
        scaling = min(self._velocity_scaling, self._arm.state.pace.speed_limit)
        fastest = scaling * min(joint.max_velocity for joint in self.joints)
        velocity = min(command.max_velocity or fastest, fastest)
        trajectory = fingers_together(self._names, self._goals(), command.position, velocity, self._max_acceleration)
        field = f"the duration of the way to {command.position:.3f} {self.joints[0].unit}"
        self._time_limits.check_duration(
            trajectory.duration_s, field, MoveItErrorCode.FAILURE, ": raise the command's velocity"
        )
        share = min(command.max_effort / self._torque_limit, 1.0) if command.max_effort else 1.0
        self._ends_s = self._clock() + trajectory.duration_s
        motion = self._arm.execute(trajectory, gripping=True, torque_share=share, epoch=claim.epoch)
        self._motion = motion
        self._in_progress.add(trajectory, motion)
        claim.deadline.begin(trajectory.duration_s)
        watch = MotionWatch(self._arm, motion, claim, self._clock, gripping=True)
        try:
            while not watch.over:
                await watch.step(FEEDBACK_PERIOD_S)
                if not motion.done() and (reading := self.reading()) is not None:
                    report(reading)
            overrun = "" if motion.done() else claim.deadline.exceeded
            ended = await watch.end()
        finally:
            # Also after an error here no motion goes on without its goal.
            if not motion.done():
                self._arm.stop(motion)
        if overrun and ended.outcome is Outcome.STOPPED:
            return replace(ended, outcome=Outcome.NOT_SETTLED, message=f"{overrun}; {ended.message}")
        if ended.outcome in (Outcome.GRIPPED, Outcome.STOPPED):
            await self._until_squeezed()
        return ended

    async def _until_squeezed(self) -> None:
        """Wait until the goal rests at its squeeze: the next motion starts there."""
        until_s = self._arm.clock_s + SQUEEZE_TIMEOUT_S
        last, looked_at_s = np.full(len(self.joints), math.inf), -math.inf
        while (now_s := self._arm.clock_s) < until_s and self._arm.state.goal_rad is not None:
            # A goal that the arm had no time to change does not rest.
            if now_s - looked_at_s >= SQUEEZE_PERIOD_S:
                goals = self._goals()
                if np.abs(goals - last).max() < SQUEEZED_WITHIN_RAD:
                    return
                last, looked_at_s = goals, now_s
            await asyncio.sleep(SQUEEZE_PERIOD_S)

    def _goals(self) -> Vector:
        """Return the fingers' goals, shape (joints,) [rad or m]."""
        state = self._arm.state
        if state.goal_rad is None:
            raise AssertionError("a motion of an arm that is not read")
        goals: Vector = state.goal_rad[[state.joint_names.index(name) for name in self._names]]
        return goals


def fingers_together(
    names: tuple[str, ...], start: Vector, end: float, max_velocity: float, max_acceleration: float
) -> Trajectory:
    """Plan the fastest motion of fingers from positions, shape (joints,), to one position; they arrive together."""
    way = end - start
    longest = float(np.abs(way).max())
    if longest < SHORTEST_WAY:
        still = np.zeros((1, len(names)))
        return Trajectory(names, np.zeros(1), np.full((1, len(names)), end), still, still)
    # The share of the way that is done, from 0 to 1.
    share = rest_to_rest(names[0], 0.0, 1.0, max_velocity / longest, max_acceleration / longest)
    positions, velocities, accelerations = (
        array * way for array in (share.positions_rad, share.velocities_rad_s, share.accelerations_rad_s2)
    )
    return Trajectory(names, share.time_s, start + positions, velocities, accelerations)


class GripperCommandMessages:
    """Messages of control_msgs/action/GripperCommand.

    The position of a gripper with two sliding fingers is the gap between them, the sum of the joints' positions, as
    for Fetch's driver; otherwise it is the position of each joint.
    """

    type_name = "control_msgs/action/GripperCommand"

    def __init__(self, joints: Sequence[Joint]) -> None:
        self._joints = joints
        self._sliding_fingers = len(joints) if joints[0].type == "prismatic" else 1

    def command(self, message: Message) -> GripperCommand:
        """Read a control_msgs/GripperCommand."""
        return _checked_command(self._joints, message["position"], message["max_effort"], 0.0, self._sliding_fingers)

    def result(self, reading: GripperReading, *, stalled: bool, reached: bool) -> Message:
        mean = sum(reading.positions) / len(reading.positions)
        return {
            "position": self._sliding_fingers * mean,
            "effort": max(reading.efforts, key=abs),
            "stalled": stalled,
            "reached_goal": reached,
        }

    def feedback(self, reading: GripperReading) -> Message:
        """Return the feedback message, which has the fields of the result."""
        return self.result(reading, stalled=False, reached=False)


class ParallelGripperCommandMessages:
    """Messages of control_msgs/action/ParallelGripperCommand."""

    type_name = "control_msgs/action/ParallelGripperCommand"

    def __init__(self, joints: Sequence[Joint]) -> None:
        self._joints = joints
        self._names = [joint.name for joint in joints]

    def command(self, message: Message) -> GripperCommand:
        """Read a sensor_msgs/JointState: the position of each finger, and optional bounds of velocity and effort."""
        names, positions = message["name"], message["position"]
        if not set(names) <= set(self._names) or len(set(names)) != len(names):
            raise invalid(f"command.name must be empty or name joints of [{', '.join(self._names)}], not {names}")
        if len(positions) not in (1, len(names)):
            raise invalid(f"command.position must have one value, not {len(positions)}")
        if max(positions) - min(positions) > SAME_POSITION:
            raise invalid(f"command.position must be the same for all fingers, not {positions}")
        bounds = {}
        for field in ("velocity", "effort"):
            if len(message[field]) > len(positions):
                raise invalid(f"command.{field} must have one value at most, not {len(message[field])}")
            bounds[field] = min(message[field], default=0.0)
        return _checked_command(self._joints, positions[0], bounds["effort"], bounds["velocity"])

    def result(self, reading: GripperReading, *, stalled: bool, reached: bool) -> Message:
        return {**self.feedback(reading), "stalled": stalled, "reached_goal": reached}

    def feedback(self, reading: GripperReading) -> Message:
        return {
            "state": {
                "name": self._names,
                "position": list(reading.positions),
                "velocity": list(reading.velocities),
                "effort": list(reading.efforts),
            }
        }


ActionMessages: TypeAlias = GripperCommandMessages | ParallelGripperCommandMessages


def _checked_command(
    joints: Sequence[Joint], position: float, max_effort: float, max_velocity: float, fingers: int = 1
) -> GripperCommand:
    lower, upper = max(joint.lower for joint in joints), min(joint.upper for joint in joints)
    unit = joints[0].unit
    beyond = CLAMPED_WITHIN_M if unit == "m" else CLAMPED_WITHIN_RAD
    each = position / fingers
    if not lower - beyond <= each <= upper + beyond:
        limits = f"from {fingers * lower:.3f} to {fingers * upper:.3f} {unit}"
        raise invalid(f"command.position must be {limits}, not {position}")
    for name, value in (("effort", max_effort), ("velocity", max_velocity)):
        if not (math.isfinite(value) and value >= 0.0):
            raise invalid(f"command's bound of {name} must be a finite number from 0 on, not {value}")
    return GripperCommand(min(max(each, lower), upper), max_effort, max_velocity)


def offer_gripper(graph: LocalGraph, gripper: Gripper) -> None:
    def start(messages: ActionMessages, goal: ActionGoal) -> None:
        try:
            command = messages.command(goal.request["command"])
        except RefusedError as error:
            goal.fail(str(error))
            return
        claim = gripper.claim()
        cancel_with_goal(goal, claim.cancel)
        work_on(goal, execute(goal, messages, claim, command))

    async def execute(goal: ActionGoal, messages: ActionMessages, claim: CancelScope, command: GripperCommand) -> None:
        ended = await gripper.move(claim, command, lambda reading: goal.feedback(messages.feedback(reading)))
        status, reading = STATUS_OF_OUTCOME.get(ended.outcome), gripper.reading()
        if status is None or reading is None:
            raise ServerError(ended.message)
        log.info("%s: %s", goal.action, ended.message)
        stalled, reached = ended.outcome is Outcome.GRIPPED, ended.outcome is Outcome.REACHED
        goal.finish(status, messages.result(reading, stalled=stalled, reached=reached))

    node, simple = graph.node("gripper"), GripperCommandMessages(gripper.joints)
    kinds: tuple[ActionMessages, ...] = simple, simple, ParallelGripperCommandMessages(gripper.joints)
    for name, messages in zip(ACTIONS, kinds, strict=True):
        node.offer_action(name, messages.type_name, functools.partial(start, messages), ListLimits(), rule=GOAL)

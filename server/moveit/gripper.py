"""Gripper: its motions and its two actions.

The newest command wins, and a stall on the way is a grip. ros2_control's two gripper controllers both call their action
``gripper_cmd``, below the controller's name; so each has a controller's name of its own here.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from planners.problem import MoveItErrorCode
from robot.arm import Arm
from robot.description.model import Joint
from robot.messages import MotionEnded, Outcome
from robot.trajectory import rest_to_rest
from server.errors import RefusedError
from server.execution.monitors import ARM_START_TIMEOUT_S, check_ready
from server.execution.player import BRAKING_TIMEOUT_S
from server.execution.time_limits import ArmClock, TimeLimits
from server.graph.actions import Goal, GoalStatus
from server.graph.list_limits import ListLimits
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.actions.joint_trajectory_controller import cancel_with_goal
from server.moveit.requests.error_codes import invalid

log = logging.getLogger("armbridge.gripper")

FEEDBACK_PERIOD_S = 0.1

# Of the arm's clock. A grip takes the goal back from behind the object, a step a tick: half a second for the whole way.
SQUEEZE_TIMEOUT_S = 1.0
SQUEEZE_PERIOD_S = 0.04
SQUEEZED_WITHIN_RAD = 0.005

GRIPPER_ACTION = "/gripper_controller/gripper_cmd"
PARALLEL_ACTION = "/parallel_gripper_controller/gripper_cmd"

# A URDF's limit lies so far beyond the soft limit; a command for it means the soft limit.
CLAMPED_WITHIN_RAD = 0.05

Message = dict[str, Any]


@dataclass(frozen=True)
class GripperCommand:
    """Command to the gripper.

    Attributes:
        position_rad: goal position, within the joint's limits.
        max_effort: share of full motor duty, as in ``effort`` of ``/joint_states``; 0 for the limit.
        max_velocity_rad_s: 0 for the velocity of planned motions.
    """

    position_rad: float
    max_effort: float = 0.0
    max_velocity_rad_s: float = 0.0


@dataclass(frozen=True)
class GripperReading:
    """Position of the gripper [rad], its velocity [rad/s] and its effort [share of full duty]."""

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
        time_limits: of motions.
        torque_limit: share of full motor duty that the gripper may use.
        clock: monotonic time of this machine [s].
    """

    def __init__(
        self,
        arm: Arm,
        joint: Joint,
        velocity_scaling: float,
        acceleration_scaling: float,
        time_limits: TimeLimits,
        torque_limit: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._arm = arm
        self._joint = joint
        self._max_velocity = velocity_scaling * joint.max_velocity
        self._max_acceleration = acceleration_scaling * joint.max_acceleration
        self._time_limits = time_limits
        self._torque_limit = torque_limit
        self._clock = clock
        self._newest = 0
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
        column = state.joint_names.index(self._joint.name)
        return GripperReading(
            float(state.position_rad[column]), float(state.velocity_rad_s[column]), float(state.load[column])
        )

    def claim(self) -> int:
        """Claim the gripper for :meth:`move`, in place of the claim before; return the number of the claim."""
        self._newest += 1
        self._stop_motion()
        return self._newest

    def give_up(self, claim: int) -> None:
        """End the motion of a claim, begun or not; do nothing when there is a newer claim."""
        if claim == self._newest:
            self.claim()

    async def move(self, claim: int, command: GripperCommand, report: Callable[[GripperReading], None]) -> MotionEnded:
        """Execute a command; every wait is bounded.

        Args:
            claim: of this command.
            command: the command.
            report: called with readings on the way.

        Raises:
            RefusedError: the arm takes no motion.
        """
        stops = self._arm.stops
        async with self._turn:
            await self._arm.until_started(ARM_START_TIMEOUT_S)
            if claim != self._newest or stops != self._arm.stops:
                return MotionEnded(0, Outcome.STOPPED, "stopped before the motion began")
            return await self._play(command, report)

    def _stop_motion(self) -> None:
        if self._motion is not None and not self._motion.done():
            self._arm.stop(self._motion)

    async def _play(self, command: GripperCommand, report: Callable[[GripperReading], None]) -> MotionEnded:
        check_ready(self._arm)
        velocity = min(command.max_velocity_rad_s or self._max_velocity, self._max_velocity)
        trajectory = rest_to_rest(
            self._joint.name, self._goal_rad(), command.position_rad, velocity, self._max_acceleration
        )
        field = f"the duration of the way to {command.position_rad:.3f} rad"
        self._time_limits.check_duration(
            trajectory.duration_s, field, MoveItErrorCode.FAILURE, ": raise the command's velocity"
        )
        share = min(command.max_effort / self._torque_limit, 1.0) if command.max_effort else 1.0
        self._ends_s = self._clock() + trajectory.duration_s
        self._motion = self._arm.execute(trajectory, gripping=True, torque_share=share)
        try:
            ended = await self._until_ended(self._motion, self._time_limits.allowed_s(trajectory.duration_s), report)
        finally:
            # Also after an error here no motion goes on without its goal; nothing happens when it has ended.
            self._stop_motion()
        if ended.outcome is Outcome.GRIPPED:
            await self._until_squeezed()
        return ended

    async def _until_ended(
        self, motion: asyncio.Future[MotionEnded], left_s: float, report: Callable[[GripperReading], None]
    ) -> MotionEnded:
        arm_clock = ArmClock(self._arm, self._clock)
        while not motion.done() and left_s > 0.0:
            await asyncio.wait([motion], timeout=FEEDBACK_PERIOD_S)
            left_s -= arm_clock.elapsed_s()
            reading = self.reading()
            if not motion.done() and reading is not None:
                report(reading)
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


class ActionMessages(Protocol):
    """Messages of one of the actions."""

    type_name: str

    def command(self, message: Message) -> GripperCommand:
        """Read a goal's command.

        Raises:
            RefusedError: it is invalid.
        """

    def result(self, reading: GripperReading, *, stalled: bool, reached: bool) -> Message:
        """Return the result message."""

    def feedback(self, reading: GripperReading) -> Message:
        """Return the feedback message."""


class GripperCommandMessages:
    """Messages of control_msgs/action/GripperCommand.

    Args:
        joint: the gripper's joint.
    """

    type_name = "control_msgs/action/GripperCommand"

    def __init__(self, joint: Joint) -> None:
        self._joint = joint

    def command(self, message: Message) -> GripperCommand:
        """Read a control_msgs/GripperCommand."""
        return _checked_command(self._joint, message["position"], message["max_effort"], 0.0)

    def result(self, reading: GripperReading, *, stalled: bool, reached: bool) -> Message:
        """Return the result message."""
        return {
            "position": reading.position_rad,
            "effort": reading.effort,
            "stalled": stalled,
            "reached_goal": reached,
        }

    def feedback(self, reading: GripperReading) -> Message:
        """Return the feedback message, which has the fields of the result."""
        return self.result(reading, stalled=False, reached=False)


class ParallelGripperCommandMessages:
    """Messages of control_msgs/action/ParallelGripperCommand.

    Args:
        joint: the gripper's joint.
    """

    type_name = "control_msgs/action/ParallelGripperCommand"

    def __init__(self, joint: Joint) -> None:
        self._joint = joint

    def command(self, message: Message) -> GripperCommand:
        """Read a sensor_msgs/JointState: the position, and optional bounds of velocity and effort."""
        names, positions = message["name"], message["position"]
        if names not in ([], [self._joint.name]):
            raise invalid(f"command.name must be empty or [{self._joint.name}], not {names}")
        if len(positions) != 1:
            raise invalid(f"command.position must have one value, not {len(positions)}")
        bounds = {}
        for field in ("velocity", "effort"):
            if len(message[field]) > 1:
                raise invalid(f"command.{field} must have one value at most, not {len(message[field])}")
            bounds[field] = message[field][0] if message[field] else 0.0
        return _checked_command(self._joint, positions[0], bounds["effort"], bounds["velocity"])

    def result(self, reading: GripperReading, *, stalled: bool, reached: bool) -> Message:
        """Return the result message."""
        return {**self.feedback(reading), "stalled": stalled, "reached_goal": reached}

    def feedback(self, reading: GripperReading) -> Message:
        """Return the feedback message."""
        return {
            "state": {
                "name": [self._joint.name],
                "position": [reading.position_rad],
                "velocity": [reading.velocity_rad_s],
                "effort": [reading.effort],
            }
        }


def _checked_command(joint: Joint, position_rad: float, max_effort: float, max_velocity: float) -> GripperCommand:
    lower, upper = joint.lower, joint.upper
    if not lower - CLAMPED_WITHIN_RAD <= position_rad <= upper + CLAMPED_WITHIN_RAD:
        raise invalid(f"command.position must be from {lower:.3f} to {upper:.3f} rad, not {position_rad}")
    for name, value in (("effort", max_effort), ("velocity", max_velocity)):
        if not (math.isfinite(value) and value >= 0.0):
            raise invalid(f"command's bound of {name} must be a finite number from 0 on, not {value}")
    return GripperCommand(min(max(position_rad, lower), upper), max_effort, max_velocity)


class GripperActions:
    """The gripper's two actions.

    Args:
        graph: where they are.
        joint: the gripper's joint.
        gripper: executes their goals.
    """

    def __init__(self, graph: Graph, joint: Joint, gripper: Gripper) -> None:
        self._gripper = gripper
        self._actions: dict[str, ActionMessages] = {
            GRIPPER_ACTION: GripperCommandMessages(joint),
            PARALLEL_ACTION: ParallelGripperCommandMessages(joint),
        }
        self._tasks: set[asyncio.Task[None]] = set()
        node = Node("gripper")
        for name, messages in self._actions.items():
            graph.actions.offer(node, name, messages.type_name, self._start, ListLimits())

    def _start(self, goal: Goal) -> None:
        messages = self._actions[goal.action]
        try:
            command = messages.command(goal.request["command"])
        except RefusedError as error:
            goal.fail(str(error))
            return
        claim = self._gripper.claim()
        cancel_with_goal(goal, lambda _reason: self._gripper.give_up(claim))
        task = asyncio.create_task(self._execute(goal, messages, claim, command), name="gripper")
        # The event loop keeps no task alive.
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _execute(self, goal: Goal, messages: ActionMessages, claim: int, command: GripperCommand) -> None:
        try:
            ended = await self._gripper.move(claim, command, lambda reading: goal.feedback(messages.feedback(reading)))
            self._finish(goal, messages, ended)
        except RefusedError as error:
            log.warning("%s: %s", goal.action, error)
            goal.fail(str(error))
        except Exception as error:  # a bug must cost this goal only, and never its result
            log.exception("a goal of %s failed", goal.action)
            goal.fail(f"internal error: {type(error).__name__}: {error}")

    def _finish(self, goal: Goal, messages: ActionMessages, ended: MotionEnded) -> None:
        """Finish the goal as its motion ended; a grip is a success."""
        status = {
            Outcome.REACHED: GoalStatus.SUCCEEDED,
            Outcome.GRIPPED: GoalStatus.SUCCEEDED,
            Outcome.STOPPED: GoalStatus.CANCELED,
        }.get(ended.outcome)
        reading = self._gripper.reading()
        if status is None or reading is None:
            log.warning("%s: %s", goal.action, ended.message)
            goal.fail(ended.message)
            return
        log.info("%s: %s", goal.action, ended.message)
        stalled, reached = ended.outcome is Outcome.GRIPPED, ended.outcome is Outcome.REACHED
        goal.finish(status, messages.result(reading, stalled=stalled, reached=reached))

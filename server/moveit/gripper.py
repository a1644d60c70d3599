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
from typing import Any

from robot.arm import Arm
from robot.messages import MotionEnded, Outcome
from robot.model import Joint
from robot.trapezoid import rest_to_rest
from server.action_goals import Goal, GoalStatus
from server.errors import RefusedError
from server.execution.current_state import ARM_START_TIMEOUT_S, check_ready
from server.execution.player import BRAKING_TIMEOUT_S
from server.execution.time_limits import ArmClock, TimeLimits
from server.graph import Graph
from server.node import Node

FEEDBACK_PERIOD_S = 0.1

# Of the arm's clock. A grip takes the goal back from behind the object, a step a tick: half a second for the whole way.
SQUEEZE_TIMEOUT_S = 1.0
SQUEEZE_PERIOD_S = 0.04
SQUEEZED_WITHIN_RAD = 0.005


log = logging.getLogger("armbridge.gripper")

GRIPPER_ACTION = "/gripper_controller/gripper_cmd"
PARALLEL_ACTION = "/parallel_gripper_controller/gripper_cmd"

# A URDF's limit lies by as much beyond the soft limit: to ask for it is to ask for all there is.
CLAMPED_WITHIN_RAD = 0.05

Message = dict[str, Any]


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
        time_limits: what motions may take.
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
        try:
            check_ready(self._arm)
        except RefusedError as error:
            return MotionEnded(0, Outcome.REFUSED, str(error))
        velocity = min(command.max_velocity_rad_s or self._max_velocity, self._max_velocity)
        trajectory = rest_to_rest(
            self._joint.name, self._goal_rad(), command.position_rad, velocity, self._max_acceleration
        )
        share = min(command.max_effort / self._torque_limit, 1.0) if command.max_effort else 1.0
        self._motion = self._arm.execute(trajectory, gripping=True, torque_share=share)
        ended = await self._until_ended(self._motion, self._time_limits.allowed_s(trajectory.duration_s), tell)
        if ended.outcome is Outcome.GRIPPED:
            await self._until_squeezed()
        return ended

    async def _until_ended(
        self, motion: asyncio.Future[MotionEnded], left_s: float, tell: Callable[[GripperReading], None]
    ) -> MotionEnded:
        arm_clock = ArmClock(self._arm, self._clock)
        while not motion.done() and left_s > 0.0:
            await asyncio.wait([motion], timeout=FEEDBACK_PERIOD_S)
            left_s -= arm_clock.elapsed_s()
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


@dataclass(frozen=True)
class Face:
    """One of the actions.

    Attributes:
        command: reads a goal message; returns a sentence when it is wrong.
        result: the result message.
        feedback: the feedback message.
    """

    command: Callable[[Message], GripperCommand | str]
    result: Callable[[GripperReading, bool, bool], Message]
    feedback: Callable[[GripperReading], Message]


class GripperActions:
    """Offers both actions.

    Args:
        graph: where they are.
        joint: the gripper's joint.
    """

    def __init__(self, graph: Graph, joint: Joint) -> None:
        self._graph = graph
        self._node = Node("gripper")
        self._joint = joint
        self._tasks: set[asyncio.Task[None]] = set()

    def open(self, gripper: Gripper) -> None:
        """Offer the actions of this gripper."""
        offers = {
            GRIPPER_ACTION: ("control_msgs/action/GripperCommand", self._simple_face()),
            PARALLEL_ACTION: ("control_msgs/action/ParallelGripperCommand", self._parallel_face()),
        }
        for name, (type_name, face) in offers.items():
            self._graph.actions.offer(self._node, name, type_name, self._starter(gripper, face))

    def _starter(self, gripper: Gripper, face: Face) -> Callable[[Goal], None]:
        def start(goal: Goal) -> None:
            command = face.command(goal.request["command"])
            if isinstance(command, str):
                goal.fail(command)
                return
            claim = gripper.claim()
            goal.when_canceled(lambda: gripper.give_up(claim))
            task = asyncio.create_task(_carry_out(goal, face, gripper, claim, command), name="gripper")
            # The event loop keeps no task alive.
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

        return start

    def _simple_face(self) -> Face:
        def message(reading: GripperReading, stalled: bool = False, reached: bool = False) -> Message:
            flags = {"stalled": stalled, "reached_goal": reached}
            return {"position": reading.position_rad, "effort": reading.effort, **flags}

        return Face(lambda command: self._checked(command["position"], command["max_effort"], 0.0), message, message)

    def _parallel_face(self) -> Face:
        def state(reading: GripperReading) -> Message:
            return {
                "name": [self._joint.name],
                "position": [reading.position_rad],
                "velocity": [reading.velocity_rad_s],
                "effort": [reading.effort],
            }

        return Face(
            self._parallel_command,
            lambda reading, stalled, reached: {"state": state(reading), "stalled": stalled, "reached_goal": reached},
            lambda reading: {"state": state(reading)},
        )

    def _parallel_command(self, command: Message) -> GripperCommand | str:
        """Read a sensor_msgs/JointState: the position, and perhaps bounds of velocity and effort."""
        names, positions = command["name"], command["position"]
        if names not in ([], [self._joint.name]):
            return f"command.name must be empty or [{self._joint.name}], not {names}"
        if len(positions) != 1:
            return f"command.position must have one value, not {len(positions)}"
        bounds = {}
        for field in ("velocity", "effort"):
            if len(command[field]) > 1:
                return f"command.{field} must have one value at most, not {len(command[field])}"
            bounds[field] = command[field][0] if command[field] else 0.0
        return self._checked(positions[0], bounds["effort"], bounds["velocity"])

    def _checked(self, position_rad: float, max_effort: float, max_velocity: float) -> GripperCommand | str:
        lower, upper = self._joint.lower, self._joint.upper
        if not lower - CLAMPED_WITHIN_RAD <= position_rad <= upper + CLAMPED_WITHIN_RAD:
            return f"command.position must be from {lower:.3f} to {upper:.3f} rad, not {position_rad}"
        for name, value in (("effort", max_effort), ("velocity", max_velocity)):
            if not (math.isfinite(value) and value >= 0.0):
                return f"command's bound of {name} must be a finite number from 0 on, not {value}"
        return GripperCommand(min(max(position_rad, lower), upper), max_effort, max_velocity)


async def _carry_out(goal: Goal, face: Face, gripper: Gripper, claim: int, command: GripperCommand) -> None:
    try:
        ended = await gripper.move(claim, command, lambda reading: goal.feedback(face.feedback(reading)))
        _end(goal, face, gripper.reading(), ended)
    except Exception as error:  # a bug must cost this goal only, and never its result
        log.exception("a goal of %s failed", goal.action)
        goal.fail(f"internal error: {type(error).__name__}: {error}")


def _end(goal: Goal, face: Face, reading: GripperReading | None, ended: MotionEnded) -> None:
    """End the goal as its motion ended; to have gripped something is a success."""
    status = {
        Outcome.REACHED: GoalStatus.SUCCEEDED,
        Outcome.GRIPPED: GoalStatus.SUCCEEDED,
        Outcome.STOPPED: GoalStatus.CANCELED,
    }.get(ended.outcome)
    if status is None or reading is None:
        log.warning("%s: %s", goal.action, ended.message)
        goal.fail(ended.message)
        return
    log.info("%s: %s", goal.action, ended.message)
    goal.finish(status, face.result(reading, ended.outcome is Outcome.GRIPPED, ended.outcome is Outcome.REACHED))

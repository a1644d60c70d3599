"""The gripper's actions: what their messages ask for, and what is answered.

ros2_control's two gripper controllers both call their action ``gripper_cmd``, below the controller's name; so each
has a controller's name of its own here.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from robot.description.model import Joint
from robot.messages import MotionEnded, Outcome
from server.graph.actions import Goal, GoalStatus
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.gripper import Gripper, GripperCommand, GripperReading

log = logging.getLogger("armbridge.gripper")

GRIPPER_ACTION = "/gripper_controller/gripper_cmd"
PARALLEL_ACTION = "/parallel_gripper_controller/gripper_cmd"

# A URDF's limit lies by as much beyond the soft limit: to ask for it is to ask for all there is.
CLAMPED_WITHIN_RAD = 0.05

Message = dict[str, Any]


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

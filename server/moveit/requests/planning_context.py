"""Start states, scenes and everything else that services and actions plan with."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Scene
from planners.servo.question import ServoAnswer, ServoQuestion
from robot.arm_group import AnyArm
from robot.description.model import RobotModel
from server.errors import refused
from server.execution.executor import ExecutionContext
from server.execution.queue import GoalQueue
from server.graph.permissions import Node
from server.graph.topics import LocalGraph
from server.moveit.display import DisplayTopics
from server.moveit.messages import Message, read_joint_positions
from server.moveit.parameters import MoveItParameters, PlannerParameters
from server.moveit.requests.planning_problems import ProblemBuilder
from server.moveit.scene.frames import Frames
from server.moveit.scene.scene_state import AssumedStates, SceneState

# MoveIt's start_state_max_bounds_error: droop takes a measured joint beyond its soft limit, and moving an arm by hand a
# little further.
MAX_START_BOUNDS_ERROR_RAD = 0.05


def start_positions(
    message: Message, current_rad: Mapping[str, float] | None, robot: RobotModel
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Read the start state of a motion; return positions, and a sentence for each part that is changed or ignored.

    Joints that it does not name are at their present positions. A state without joints is the present one, whatever
    its ``is_diff``. Positions beyond a limit by no more than ``MAX_START_BOUNDS_ERROR_RAD`` are moved to it.
    """
    positions = state_positions(message, current_rad, robot)
    warnings = []
    for joint in robot.movable_joints:
        value = positions[joint.name]
        inside = min(max(value, joint.lower), joint.upper)
        if abs(value - inside) > MAX_START_BOUNDS_ERROR_RAD:
            raise refused(
                MoveItErrorCode.START_STATE_INVALID,
                f"the start has joint {joint.name!r} at {value:.4g} {joint.unit}, beyond its limits {joint.lower:.4g}"
                f" to {joint.upper:.4g} {joint.unit} by more than {MAX_START_BOUNDS_ERROR_RAD:g} {joint.unit}",
                joint=joint.name,
                position_rad=value,
                lower_rad=joint.lower,
                upper_rad=joint.upper,
            )
        if inside != value:
            warnings.append(
                f"the start of joint {joint.name} is moved from {value:.4g} to its limit {inside:.4g} {joint.unit}"
            )
            positions[joint.name] = inside
    if message["multi_dof_joint_state"]["joint_names"]:
        warnings.append("multi_dof_joint_state is ignored: the robot has no such joint")
    return positions, tuple(warnings)


def state_positions(message: Message, current_rad: Mapping[str, float] | None, robot: RobotModel) -> dict[str, float]:
    """Read the position of every movable joint in a state, which may lie beyond the limits [rad]."""
    names = message["joint_state"]["name"]
    named = read_joint_positions(message["joint_state"], robot.joints, "joint_state")
    if len(named) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        text = f"joint_state names the joint {twice!r} more than once"
        raise refused(MoveItErrorCode.INVALID_ROBOT_STATE, text, joint=twice)
    positions = {**(current_rad or {}), **named}
    for joint in robot.movable_joints:
        if joint.name not in positions:
            raise refused(
                MoveItErrorCode.ROBOT_STATE_STALE,
                f"the state leaves out joint {joint.name!r}, whose position is unknown: the arm is not connected",
                joint=joint.name,
            )
    return {joint.name: positions[joint.name] for joint in robot.movable_joints}


def attached_diff(message: Message) -> Message | None:
    """Write the attached objects of a state as a moveit_msgs/PlanningScene without other fields; None for no change.

    A state with joints that is no diff detaches all objects that it does not list.
    """
    attached = message["attached_collision_objects"]
    is_whole = bool(message["joint_state"]["name"]) and not message["is_diff"]
    if not (attached or is_whole):
        return None
    return {"is_diff": True, "robot_state": {"attached_collision_objects": attached, "is_diff": not is_whole}}


@dataclass(frozen=True)
class PlanningStart:
    """Start of planning."""

    start_rad: Mapping[str, float]
    scene: Scene
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class PlanningContext(ExecutionContext):
    """All that services and actions plan with."""

    frames: Frames
    scene_state: SceneState
    assumed: AssumedStates
    parameters: PlannerParameters
    display: DisplayTopics
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    urdf_responses: dict[str, dict[str, Any]] = field(default_factory=dict)

    @cached_property
    def problems(self) -> ProblemBuilder:
        return ProblemBuilder(self.robot, self.frames, self.parameters, self.current)

    async def ask(self, question: ServoQuestion) -> ServoAnswer | PlanningFailure:
        """Ask the planners about the next step of a servo loop in the present scene."""
        return await self.pool.ask(question, self.scene_state.scene)

    def start(self, state: Message, caller: Node) -> PlanningStart:
        """Read the start of a motion; positions that the calling client assumes complete the state."""
        start_rad, warnings = start_positions(state, self._known_rad(caller), self.robot)
        return PlanningStart(start_rad, self.scene_of(state, start_rad), warnings)

    def positions_rad(self, state: Message, caller: Node) -> Mapping[str, float]:
        """Read the position of every movable joint in a state, which may lie beyond the limits [rad]."""
        return state_positions(state, self._known_rad(caller), self.robot)

    def scene_of(self, state: Message, positions_rad: Mapping[str, float]) -> Scene:
        """Return the scene with the attached objects of a moveit_msgs/RobotState."""
        scene = self.scene_state.scene
        diff = attached_diff(state)
        if diff is None or not (scene.attached or state["attached_collision_objects"]):
            return scene
        return self.scene_state.with_diff(diff, positions_rad)

    def _known_rad(self, caller: Node) -> Mapping[str, float] | None:
        assumed, current = self.assumed.of(caller), self.current.positions_rad()
        return current if assumed is None else {**(current or {}), **assumed}


@dataclass(frozen=True, eq=False, kw_only=True)
class GoalContext:
    """Context of the goals of one arm, or of all arms together, with the arm's own parameters."""

    graph: LocalGraph
    arm: AnyArm
    robot: RobotModel
    parameters: MoveItParameters
    planning: PlanningContext
    queue: GoalQueue

    @cached_property
    def joints(self) -> frozenset[str]:
        return frozenset(joint.name for joint in self.robot.movable_joints)

    @property
    def only_joints(self) -> frozenset[str] | None:
        """Joints that a stop is for; None to stop everything."""
        return self.joints if self.graph.namespace else None

    def stop(self, reason: str) -> None:
        """End the goals that move the arm, the active one and all that wait, and every motion of it."""
        self.queue.stop(reason, self.only_joints)

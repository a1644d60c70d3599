"""What requests are read against"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from planners.pool import PlannerPool
from planners.problem import CartesianProblem, MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import Scene
from robot.forward import ForwardPlacements
from robot.model import Group, RobotModel
from server.moveit.display import DisplayTopics
from server.moveit.motions import Positions, Step
from server.moveit.planner_parameters import PlannerParameters
from server.moveit.requests.context import FrameResolver, Message, RequestContext, group_of
from server.moveit.requests.error_codes import refusals_as_data, refused, required
from server.moveit.requests.motion_plan import PlanRequest, problem_of
from server.node import Node

# MoveIt's start_state_max_bounds_error: a measured joint lies beyond its soft limit by droop, and an arm that was moved
# by hand by a little more.
MAX_START_BOUNDS_ERROR_RAD = 0.05


@dataclass(frozen=True)
class Start:
    """Where a motion begins.

    Attributes:
        positions_rad: position of every movable joint, within the limits [rad].
        warnings: what was changed or left out of account, a sentence each.
    """

    positions_rad: Mapping[str, float]
    warnings: tuple[str, ...] = ()


@refusals_as_data
def start_positions(message: Message, current_rad: Mapping[str, float] | None, robot: RobotModel) -> Start:
    """Read a state that a motion is to start from.

    Joints that it does not name are where they are. A state without joints is the present one, whatever its
    ``is_diff``; with joints and without ``is_diff`` it also says all that is attached. Positions beyond a limit by no
    more than ``MAX_START_BOUNDS_ERROR_RAD`` are moved to it.

    Args:
        message: a moveit_msgs/RobotState.
        current_rad: where the joints are now, None while that is not known [rad].
        robot: the arm.
    """
    positions = _stated(message, current_rad, robot)
    warnings = []
    for joint in robot.movable_joints:
        value = positions[joint.name]
        inside = min(max(value, joint.lower), joint.upper)
        if abs(value - inside) > MAX_START_BOUNDS_ERROR_RAD:
            raise refused(
                MoveItErrorCode.START_STATE_INVALID,
                f"the start has joint {joint.name!r} at {value:.4g} rad, beyond its limits {joint.lower:.4g} to"
                f" {joint.upper:.4g} rad by more than {MAX_START_BOUNDS_ERROR_RAD:g} rad",
                joint=joint.name,
                position_rad=value,
                lower_rad=joint.lower,
                upper_rad=joint.upper,
            )
        if inside != value:
            warnings.append(
                f"the start of joint {joint.name} is moved from {value:.4g} rad to its limit {inside:.4g} rad"
            )
            positions[joint.name] = inside
    if message["multi_dof_joint_state"]["joint_names"]:
        warnings.append("multi_dof_joint_state is ignored: the robot has no such joint")
    return Start(positions, tuple(warnings))


@refusals_as_data
def stated_positions(
    message: Message, current_rad: Mapping[str, float] | None, robot: RobotModel
) -> Mapping[str, float]:
    """Read a state that is asked about, which may lie beyond the limits; arguments as for :func:`start_positions`."""
    return _stated(message, current_rad, robot)


def attached_diff(message: Message) -> Message | None:
    """What a state says of attached things, as a moveit_msgs/PlanningScene whose other fields are left out.

    A state that names joints and is no diff says all that is attached; any other only what it names.

    Args:
        message: a moveit_msgs/RobotState.

    Returns:
        None when it says nothing.
    """
    attached, says_all = message["attached_collision_objects"], bool(message["joint_state"]["name"])
    says_all = says_all and not message["is_diff"]
    if not (attached or says_all):
        return None
    return {"is_diff": True, "robot_state": {"attached_collision_objects": attached, "is_diff": not says_all}}


def _stated(message: Message, current_rad: Mapping[str, float] | None, robot: RobotModel) -> dict[str, float]:
    """Position of every movable joint [rad]."""
    names, values = message["joint_state"]["name"], message["joint_state"]["position"]
    if len(names) != len(values):
        raise _invalid_state(f"joint_state.name has {len(names)} entries and joint_state.position {len(values)}")
    named = dict(zip(names, values, strict=True))
    for name, value in named.items():
        if name not in robot.joints:
            known = ", ".join(joint.name for joint in robot.movable_joints)
            raise _invalid_state(
                f"joint_state names the joint {name!r}, which does not exist; there are: {known}", name
            )
        if not math.isfinite(value):
            raise _invalid_state(f"joint_state has joint {name!r} at {value}, not a finite number", name)
    if len(named) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise _invalid_state(f"joint_state names the joint {twice!r} more than once", twice)
    positions: dict[str, float] = {}
    for joint in robot.movable_joints:
        value = named[joint.name] if joint.name in named else (current_rad or {}).get(joint.name)
        if value is None:
            raise refused(
                MoveItErrorCode.ROBOT_STATE_STALE,
                f"the state leaves out joint {joint.name!r}, and where it is now is not known: the arm is not read",
                joint=joint.name,
            )
        positions[joint.name] = float(value)
    return positions


def _invalid_state(message: str, joint: str = "") -> Exception:
    return refused(MoveItErrorCode.INVALID_ROBOT_STATE, message, **({"joint": joint} if joint else {}))


class PlanningSceneState(Protocol):
    """The planning scene."""

    @property
    def scene(self) -> Scene:
        """What is around now."""

    def with_diff(self, message: Message, positions_rad: Mapping[str, float] | None) -> Scene:
        """Return the scene with a moveit_msgs/PlanningScene applied; the state stays as it is.

        Fields of the message may be left out.

        Raises:
            RefusedError: it cannot be applied.
        """


class AssumedStates(Protocol):
    """The states that clients have put into the scene, each for itself."""

    def of(self, node: Node) -> Mapping[str, float] | None:
        """Positions that a client wants to be assumed [rad]; None when it has said nothing."""


class CurrentPositions(Protocol):
    """Knows where the arm is."""

    def positions_rad(self) -> Mapping[str, float] | None:
        """Position of every movable joint [rad]; None while that is not known."""


@dataclass(frozen=True)
class Situation:
    """What a request starts from.

    Attributes:
        start_rad: position of every movable joint [rad].
        scene: what is around, and what is held there.
        warnings: what was changed or left out of account, a sentence each.
    """

    start_rad: Mapping[str, float]
    scene: Scene
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlanningContext:
    """What a service works with.

    Attributes:
        robot: the arm.
        pool: the planners.
        forward: where links are.
        frames: where frames are.
        scene_state: the planning scene.
        current: where the arm is.
        assumed: where clients want it to be assumed.
        parameters: how is planned.
        display: shows what comes of it.
    """

    robot: RobotModel
    pool: PlannerPool
    forward: ForwardPlacements
    frames: FrameResolver
    scene_state: PlanningSceneState
    current: CurrentPositions
    assumed: AssumedStates
    parameters: PlannerParameters
    display: DisplayTopics

    def situation(self, state: Message, caller: Node) -> Situation:
        """What a motion from a state starts from.

        Args:
            state: the request's moveit_msgs/RobotState.
            caller: who asks; its assumed state counts where the message says nothing.

        Raises:
            RefusedError: a state that cannot be, or attached things that cannot be.
        """
        start = required(start_positions(state, self._known_rad(caller), self.robot))
        return Situation(start.positions_rad, self.scene_of(state, start.positions_rad), start.warnings)

    def positions_rad(self, state: Message, caller: Node) -> Mapping[str, float]:
        """Position of every movable joint in a state that is asked about, which may lie beyond the limits [rad].

        Raises:
            RefusedError: a state that cannot be.
        """
        return required(stated_positions(state, self._known_rad(caller), self.robot))

    def scene_of(self, state: Message, positions_rad: Mapping[str, float]) -> Scene:
        """The scene, with what a moveit_msgs/RobotState says of attached things.

        Raises:
            RefusedError: attached things that cannot be.
        """
        scene = self.scene_state.scene
        diff = attached_diff(state)
        if diff is None or not (scene.attached or state["attached_collision_objects"]):
            return scene
        return self.scene_state.with_diff(diff, positions_rad)

    def group(self, name: str) -> Group:
        """A planning group; the configured one for an empty name.

        Raises:
            RefusedError: there is no such group.
        """
        return group_of(self.robot, name, self.parameters.of())

    def read(self, request: Message, start_rad: Mapping[str, float]) -> PlanRequest | PlanningFailure:
        """What a moveit_msgs/MotionPlanRequest asks for, from a start."""
        parameters = self.parameters.of(request["group_name"], request["planner_id"])
        return problem_of(request, start_rad, self.frames, self.robot, parameters)

    def step(self, request: Message) -> Step:
        """Reads a moveit_msgs/MotionPlanRequest when it is known where its motion starts."""

        def problem(start_rad: Positions) -> PlanningProblem | CartesianProblem | PlanningFailure:
            read = self.read(request, start_rad)
            return read if isinstance(read, PlanningFailure) else read.problem

        return problem

    def request_context(self, group: Group, start_rad: Mapping[str, float]) -> RequestContext:
        """What the fields of a request for a group are read against."""
        return RequestContext(self.robot, group, self.frames, start_rad, self.parameters.of(group.name))

    def _known_rad(self, caller: Node) -> Mapping[str, float] | None:
        assumed, current = self.assumed.of(caller), self.current.positions_rad()
        return current if assumed is None else {**(current or {}), **assumed}

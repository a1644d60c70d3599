"""What MoveIt's services have in common: who plans, in which scene, from which state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from planners.pool import PlannerPool
from planners.problem import CartesianProblem, PlanningFailure, PlanningProblem
from planners.scene import Scene
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import Group, RobotModel
from server.execution.motions import Positions, Step
from server.graph.node import Node
from server.moveit.display import DisplayTopics
from server.moveit.parameters import PlannerParameters
from server.moveit.requests.context import FrameResolver, Message, RequestContext, group_of
from server.moveit.requests.motion_plan import PlanRequest, problem_of
from server.moveit.requests.refusals import required
from server.moveit.requests.robot_state import attached_diff, start_positions, stated_positions


class PlanningSceneState(Protocol):
    """The planning scene."""

    @property
    def scene(self) -> Scene:
        """What is around now."""

    def with_diff(self, message: Message, positions_rad: Mapping[str, float] | None) -> Scene | PlanningFailure:
        """The scene with a moveit_msgs/PlanningScene applied to it, which itself stays as it is.

        Fields of the message that are left out say nothing.
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
        return required(self.scene_state.with_diff(diff, positions_rad))

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

"""The planning scene of the server, and the joint states that clients assume in it."""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Callable, Mapping
from typing import Any
from weakref import WeakKeyDictionary

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import EMPTY_SCENE, Scene
from planners.scene_checks import check_whole
from robot.forward import ForwardPlacements
from robot.model import RobotModel
from server.errors import RefusedError
from server.moveit.requests.error_codes import refused
from server.moveit.scene.allowed_collision_matrix import ContactMatrix
from server.moveit.scene.frames import LinkPlaces
from server.moveit.scene.planning_scene import (
    Draft,
    SceneContents,
    change_held_object,
    change_object,
    change_scene,
    change_world,
)
from server.node import Node

log = logging.getLogger("armbridge.scene")

Message = Mapping[str, Any]
Positions = Mapping[str, float] | None
Change = Callable[[Draft], None]


class SceneState:
    """The planning scene. A change is made whole or not at all.

    Messages are complete ones of their type. Positions are those of every movable joint [rad], by which frames that
    move are found; None while they are not known.

    Args:
        robot: the arm.

    Attributes:
        frame: the planning frame, in which the scene's poses are.
        contents: what the scene holds; another object after every change.
        scene: the same as planners have it; another object, with another version, after every change they can see.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._forward = ForwardPlacements(robot)
        self._of_robot = ContactMatrix.of_robot(robot)
        self._versions = itertools.count(EMPTY_SCENE.version + 1)
        self._callbacks: list[Callable[[], None]] = []
        self.frame = robot.root_link
        self.contents = SceneContents(self._of_robot)
        self.scene = EMPTY_SCENE

    def on_change(self, callback: Callable[[], None]) -> None:
        """Have this called after every change."""
        self._callbacks.append(callback)

    def apply_diff(self, message: Message, positions_rad: Positions) -> PlanningFailure | None:
        """Take over a moveit_msgs/PlanningScene, as a difference or whole as it says of itself.

        Returns:
            Why nothing was changed.
        """
        return self._take(lambda draft: self._change_scene(draft, message), positions_rad)

    def apply_world(self, message: Message, positions_rad: Positions) -> PlanningFailure | None:
        """Have what a moveit_msgs/PlanningSceneWorld says stand around, and nothing else."""

        def change(draft: Draft) -> None:
            draft.objects = {}
            change_world(draft, message, "world")

        return self._take(change, positions_rad)

    def apply_object(self, message: Message, positions_rad: Positions) -> PlanningFailure | None:
        """Do what a moveit_msgs/CollisionObject says."""
        return self._take(lambda draft: change_object(draft, message, "object"), positions_rad)

    def apply_held_object(self, message: Message, positions_rad: Positions) -> PlanningFailure | None:
        """Do what a moveit_msgs/AttachedCollisionObject says."""
        return self._take(lambda draft: change_held_object(draft, message, "attached_object"), positions_rad)

    def with_diff(self, message: Message, positions_rad: Positions) -> Scene | PlanningFailure:
        """The scene as it would be after a moveit_msgs/PlanningScene; the state stays as it is.

        Fields of the message that are left out say nothing.
        """
        return self._seen(lambda draft: self._change_scene(draft, message), positions_rad)

    def _change_scene(self, draft: Draft, message: Message) -> None:
        meant = message.get("robot_model_name", "")
        if meant not in ("", self._robot.name):
            log.warning("planning scene: robot_model_name is %r; this robot is %r", meant, self._robot.name)
        change_scene(draft, message, self._of_robot)

    def _take(self, change: Change, positions_rad: Positions) -> PlanningFailure | None:
        changed = self._changed(change, positions_rad)
        if isinstance(changed, PlanningFailure):
            return changed
        contents, scene = changed
        if contents != self.contents:
            self.contents, self.scene = contents, scene
            for callback in self._callbacks:
                callback()
        return None

    def _seen(self, change: Change, positions_rad: Positions) -> Scene | PlanningFailure:
        changed = self._changed(change, positions_rad)
        return changed if isinstance(changed, PlanningFailure) else changed[1]

    def _changed(self, change: Change, positions_rad: Positions) -> tuple[SceneContents, Scene] | PlanningFailure:
        draft = Draft(self.contents, LinkPlaces(self._robot, self._forward, positions_rad))
        try:
            change(draft)
        except RefusedError as error:
            return error.failure
        contents = draft.contents()
        if contents.looks_like(self.contents):
            return contents, self.scene
        scene = contents.as_scene(next(self._versions), self._robot)
        return check_whole(scene, self._robot.links) or (contents, scene)


class AssumedStates:
    """The assumed joint positions of every client that has said some; a client that has left is forgotten.

    Args:
        robot: the arm.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._joints = {joint.name for joint in robot.movable_joints}
        # Nobody but the client's connection keeps its node, so what is kept here has as many entries as it has clients.
        self._assumed: WeakKeyDictionary[Node, Mapping[str, float]] = WeakKeyDictionary()
        self._believed: WeakKeyDictionary[Node, Mapping[str, float]] = WeakKeyDictionary()

    def of(self, node: Node) -> Mapping[str, float] | None:
        """Assumed positions of a client by joint, perhaps not of all joints [rad]; None when it has said none."""
        return self._assumed.get(node)

    def completed(
        self, assumed_rad: Mapping[str, float] | None, measured_rad: Mapping[str, float] | None
    ) -> dict[str, float] | None:
        """Position of every movable joint as somebody sees it who assumes some [rad]; None while not all are known.

        Args:
            assumed_rad: by joint [rad].
            measured_rad: where the joints are [rad].
        """
        positions = {**(measured_rad or {}), **(assumed_rad or {})}
        return positions if positions.keys() >= self._joints else None

    def tell(self, node: Node, positions_rad: Mapping[str, float]) -> None:
        """Note what a client has been told: sent back as it is, it says nothing."""
        self._believed[node] = positions_rad

    def stated(self, node: Node, robot_state: Message) -> Mapping[str, float] | None:
        """What a client will have assumed when it has said a moveit_msgs/RobotState, by joint [rad].

        Args:
            node: the client.
            robot_state: one without joints says nothing; with ``is_diff``, joints that are not named stay as they were.

        Raises:
            RefusedError: an unknown joint, or a position that is none.
        """
        named = self._read(robot_state["joint_state"])
        before, believed = self._assumed.get(node), self._believed.get(node, {})
        if all(believed.get(joint) == position for joint, position in named.items()):
            return before
        return {**(before or {}), **named} if robot_state["is_diff"] else named

    def assume(self, node: Node, positions_rad: Mapping[str, float] | None) -> None:
        """Take over what a client has stated."""
        if positions_rad is not None:
            self._assumed[node] = positions_rad
            self._believed[node] = {**self._believed.get(node, {}), **positions_rad}

    def _read(self, joint_state: Message) -> dict[str, float]:
        names, positions = joint_state["name"], joint_state["position"]
        where = "robot_state.joint_state"
        if len(names) != len(positions):
            raise _wrong(f"{where}: name has {len(names)} entries and position {len(positions)}; they must be as many")
        for name, position in zip(names, positions, strict=True):
            if name not in self._joints:
                known = ", ".join(sorted(self._joints))
                raise _wrong(f"{where}.name: there is no joint {name!r}; the robot has {known}", joint=name)
            if not math.isfinite(position):
                raise _wrong(f"{where}.position of joint {name!r} must be a finite number, not {position}", joint=name)
        return dict(zip(names, positions, strict=True))


def _wrong(message: str, **details: Any) -> Exception:
    return refused(MoveItErrorCode.INVALID_ROBOT_STATE, message, **details)

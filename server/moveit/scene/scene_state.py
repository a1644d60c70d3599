"""The planning scene of the server, and the joint states that clients assume in it."""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Callable, Mapping
from typing import Any
from weakref import WeakKeyDictionary

from planners.problem import MoveItErrorCode
from planners.scene import EMPTY_SCENE, Scene
from planners.scene_checks import check_whole
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from server.errors import RefusedError
from server.graph.node import Node
from server.moveit.poses import Message
from server.moveit.requests.error_codes import refused
from server.moveit.scene.allowed_collision_matrix import AllowedCollisionMatrix
from server.moveit.scene.frames import LinkTransforms
from server.moveit.scene.planning_scene import (
    SceneContents,
    SceneDraft,
    apply_attached_object,
    apply_collision_object,
    apply_planning_scene,
    apply_world,
)

log = logging.getLogger("armbridge.scene")

Positions = Mapping[str, float] | None
Change = Callable[[SceneDraft], None]


class SceneState:
    """The planning scene. A message changes it as a whole or, when it is rejected, not at all.

    Messages are complete ones of their type. Positions are those of every movable joint [rad], by which the frames of
    links are found; None while they are not known.

    Args:
        robot: the arm.

    Attributes:
        frame: the planning frame, in which the scene's poses are.
        contents: contents of the scene; another object after every change.
        scene: the same as planners have it; another object, with another version, after every change they can see.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._forward = ForwardPlacements(robot)
        self._srdf_matrix = AllowedCollisionMatrix.of_robot(robot)
        self._versions = itertools.count(EMPTY_SCENE.version + 1)
        self._callbacks: list[Callable[[], None]] = []
        self.frame = robot.root_link
        self.contents = SceneContents(self._srdf_matrix)
        self.scene = EMPTY_SCENE

    def on_change(self, callback: Callable[[], None]) -> None:
        """Call a function after every change."""
        self._callbacks.append(callback)

    def apply_diff(self, message: Message, positions_rad: Positions) -> None:
        """Apply a moveit_msgs/PlanningScene: a diff, or a whole scene if its ``is_diff`` is false.

        Raises:
            RefusedError: it cannot be applied.
        """
        self._apply(lambda draft: self._apply_scene(draft, message), positions_rad)

    def apply_world(self, message: Message, positions_rad: Positions) -> None:
        """Replace all collision objects by those of a moveit_msgs/PlanningSceneWorld.

        Raises:
            RefusedError: it cannot be applied.
        """

        def change(draft: SceneDraft) -> None:
            draft.objects = {}
            apply_world(draft, message, "world")

        self._apply(change, positions_rad)

    def apply_collision_object(self, message: Message, positions_rad: Positions) -> None:
        """Apply a moveit_msgs/CollisionObject.

        Raises:
            RefusedError: it cannot be applied.
        """
        self._apply(lambda draft: apply_collision_object(draft, message, "object"), positions_rad)

    def apply_attached_object(self, message: Message, positions_rad: Positions) -> None:
        """Apply a moveit_msgs/AttachedCollisionObject.

        Raises:
            RefusedError: it cannot be applied.
        """
        self._apply(lambda draft: apply_attached_object(draft, message, "attached_object"), positions_rad)

    def with_diff(self, message: Message, positions_rad: Positions) -> Scene:
        """Return the scene as a moveit_msgs/PlanningScene would make it; the state stays as it is.

        Fields of the message may be left out.

        Raises:
            RefusedError: it cannot be applied.
        """
        return self._changed(lambda draft: self._apply_scene(draft, message), positions_rad)[1]

    def _apply_scene(self, draft: SceneDraft, message: Message) -> None:
        model = message.get("robot_model_name", "")
        if model not in ("", self._robot.name):
            log.warning("planning scene: robot_model_name is %r; this robot is %r", model, self._robot.name)
        apply_planning_scene(draft, message, self._srdf_matrix)

    def _apply(self, change: Change, positions_rad: Positions) -> None:
        contents, scene = self._changed(change, positions_rad)
        if contents != self.contents:
            self.contents, self.scene = contents, scene
            for callback in self._callbacks:
                callback()

    def _changed(self, change: Change, positions_rad: Positions) -> tuple[SceneContents, Scene]:
        draft = SceneDraft(self.contents, LinkTransforms(self._robot, self._forward, positions_rad))
        change(draft)
        contents = draft.contents()
        if contents.looks_same(self.contents):
            return contents, self.scene
        scene = contents.as_scene(next(self._versions), self._robot)
        fault = check_whole(scene, self._robot.links)
        if fault is not None:
            raise RefusedError(fault)
        return contents, scene


class AssumedStates:
    """Joint positions that clients assume, for each client that has sent some, until it leaves.

    Some clients set a robot state in the scene and then ask, over several calls, about that state (compas_fab). No
    motion is ever executed from such a state.

    Args:
        robot: the arm.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._joints = {joint.name for joint in robot.movable_joints}
        # Only a client's connection keeps its node alive, so these have as many entries as there are such clients.
        self._assumed: WeakKeyDictionary[Node, Mapping[str, float]] = WeakKeyDictionary()
        self._sent: WeakKeyDictionary[Node, Mapping[str, float]] = WeakKeyDictionary()

    def of(self, node: Node) -> Mapping[str, float] | None:
        """Return the positions a client assumes by joint, perhaps not of all joints [rad]; None if it has sent none."""
        return self._assumed.get(node)

    def completed(
        self, assumed_rad: Mapping[str, float] | None, measured_rad: Mapping[str, float] | None
    ) -> dict[str, float] | None:
        """Complete assumed positions by measured ones, for every movable joint [rad]; None while not all are known.

        Args:
            assumed_rad: by joint [rad].
            measured_rad: by joint [rad].
        """
        positions = {**(measured_rad or {}), **(assumed_rad or {})}
        return positions if positions.keys() >= self._joints else None

    def note_sent(self, node: Node, positions_rad: Mapping[str, float]) -> None:
        """Note the state that a client was sent: a client that sends the same back assumes nothing by it."""
        self._sent[node] = positions_rad

    def after(self, node: Node, robot_state: Message) -> Mapping[str, float] | None:
        """Return the positions that a client assumes once a moveit_msgs/RobotState is taken over, by joint [rad].

        Args:
            node: the client.
            robot_state: without joints it changes nothing; with ``is_diff``, other joints stay as they are.

        Raises:
            RefusedError: an unknown joint, or a position that is not finite.
        """
        named = self._read(robot_state["joint_state"])
        before, sent = self._assumed.get(node), self._sent.get(node, {})
        if all(sent.get(joint) == position for joint, position in named.items()):
            return before
        return {**(before or {}), **named} if robot_state["is_diff"] else named

    def assume(self, node: Node, positions_rad: Mapping[str, float] | None) -> None:
        """Take over the positions that :meth:`after` has returned."""
        if positions_rad is not None:
            self._assumed[node] = positions_rad
            self._sent[node] = {**self._sent.get(node, {}), **positions_rad}

    def _read(self, joint_state: Message) -> dict[str, float]:
        names, positions = joint_state["name"], joint_state["position"]
        where = "robot_state.joint_state"
        if len(names) != len(positions):
            raise _invalid_state(
                f"{where}: name has {len(names)} entries and position {len(positions)}; they must be as many"
            )
        for name, position in zip(names, positions, strict=True):
            if name not in self._joints:
                known = ", ".join(sorted(self._joints))
                raise _invalid_state(f"{where}.name: there is no joint {name!r}; the robot has {known}", joint=name)
            if not math.isfinite(position):
                raise _invalid_state(
                    f"{where}.position of joint {name!r} must be a finite number, not {position}", joint=name
                )
        return dict(zip(names, positions, strict=True))


def _invalid_state(message: str, **details: Any) -> Exception:
    return refused(MoveItErrorCode.INVALID_ROBOT_STATE, message, **details)

"""The one planning scene of the server: who changes it, and what it is now."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Mapping
from typing import Any

from planners.problem import PlanningFailure
from planners.scene import EMPTY_SCENE, Scene
from planners.scene_checks import check_whole
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from server.errors import RefusedError
from server.moveit.scene.changes import change_scene, change_world
from server.moveit.scene.contents import Draft, SceneContents
from server.moveit.scene.frames import LinkPlaces
from server.moveit.scene.held_objects import change_held_object
from server.moveit.scene.matrix import ContactMatrix
from server.moveit.scene.world_objects import change_object

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

"""The planning scene of the server, and the joint states that clients assume in it."""

import asyncio
import itertools
import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

from planners.problem import MoveItErrorCode
from planners.scene import EMPTY_SCENE, Scene
from planners.scene_checks import check_whole
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from server.errors import RefusedError, refused
from server.execution.monitors import CurrentScene
from server.graph.permissions import Node
from server.moveit.messages import Message, read_joint_positions
from server.moveit.scene.allowed_collision_matrix import AllowedCollisionMatrix
from server.moveit.scene.collision_objects import GEOMETRY_KINDS
from server.moveit.scene.frames import LinkTransforms
from server.moveit.scene.planning_scene import (
    EMPTY_DIFF,
    SceneContents,
    SceneDraft,
    apply_attached_object,
    apply_collision_object,
    apply_planning_scene,
    apply_world,
)

log = logging.getLogger("armbridge.scene")

OptionalPositions = Mapping[str, float] | None

# Elements of a change that is applied at once; reading one takes 1 us, one of an object 20 us.
AT_ONCE_ELEMENTS = 2_000
OBJECT_ELEMENTS = 20

# Elements of all changes that wait: two scenes full of meshes.
MAX_WAITING_ELEMENTS = 1_000_000


DraftChange = Callable[[SceneDraft], None]


@dataclass(frozen=True)
class SceneChange:
    """A change of the scene by a message, with the number of the elements in the message that take time."""

    apply: DraftChange
    elements: int


class SceneState(CurrentScene):
    """The planning scene. A message changes it as a whole, or not when it is rejected.

    Changes that take long are read by a thread, one after the other; changes that come meanwhile wait for their turn.

    Messages have every field of their type. Positions are the angles of every movable joint [rad], which place the
    links' frames; None while unknown.
    """

    def __init__(self, robot: RobotModel) -> None:
        super().__init__()
        self.robot = robot
        self._forward = ForwardPlacements(robot)
        self._srdf_matrix = AllowedCollisionMatrix.of_robot(robot)
        self._versions = itertools.count(EMPTY_SCENE.version + 1)
        self._waiting: deque[tuple[SceneChange, OptionalPositions, asyncio.Future[None]]] = deque()
        self._applying: asyncio.Task[None] | None = None
        self.frame = robot.root_link
        self.contents = SceneContents(self._srdf_matrix)  # contents of the scene; another object after every change

    def links(self, positions_rad: OptionalPositions) -> LinkTransforms:
        return LinkTransforms(self.robot, self._forward, positions_rad)

    def diff(self, message: Message) -> SceneChange:
        """Return the change by a moveit_msgs/PlanningScene: a diff, or a whole scene if its ``is_diff`` is false."""
        scene = {**EMPTY_DIFF, **message}
        attached = scene["robot_state"]["attached_collision_objects"]
        elements = _elements([*scene["world"]["collision_objects"], *(each["object"] for each in attached)])
        elements += len(scene["allowed_collision_matrix"]["entry_names"]) ** 2
        elements += OBJECT_ELEMENTS * len(scene["object_colors"])
        return SceneChange(lambda draft: self._apply_scene(draft, message), elements)

    def world(self, message: Message) -> SceneChange:
        """Return the change that replaces all collision objects by a moveit_msgs/PlanningSceneWorld."""

        def change(draft: SceneDraft) -> None:
            draft.objects = {}
            apply_world(draft, message)

        return SceneChange(change, _elements(message["collision_objects"]))

    def collision_object(self, message: Message) -> SceneChange:
        return SceneChange(lambda draft: apply_collision_object(draft, message, "object"), _elements([message]))

    def attached_object(self, message: Message) -> SceneChange:
        elements = _elements([message["object"]])
        return SceneChange(lambda draft: apply_attached_object(draft, message, "attached_object"), elements)

    def submit(self, change: SceneChange, positions_rad: OptionalPositions) -> asyncio.Future[None]:
        """Apply a change in its turn, at once if it is small and none waits, but not once its future is cancelled.

        The future raises RefusedError where the change is refused.
        """
        applied: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        elements = sum(waiting.elements for waiting, *_ in self._waiting) + change.elements
        if self._applying is None and change.elements <= AT_ONCE_ELEMENTS:
            try:
                self.apply(change.apply, positions_rad)
            except RefusedError as refusal:
                applied.set_exception(refusal)
            else:
                applied.set_result(None)
        elif self._waiting and elements > MAX_WAITING_ELEMENTS:
            text = f"changes of the scene with {elements} elements would wait; the limit is {MAX_WAITING_ELEMENTS}"
            applied.set_exception(refused(MoveItErrorCode.FAILURE, text))
        else:
            self._waiting.append((change, positions_rad, applied))
            if self._applying is None:
                self._applying = asyncio.create_task(self._apply_waiting(), name="planning scene")
        return applied

    @property
    def pending(self) -> bool:
        return self._applying is not None

    async def settled(self) -> None:
        """Wait until the changes that have been submitted until now are applied or refused."""
        if self._waiting:
            await asyncio.wait([applied for *_, applied in self._waiting])

    def close(self) -> None:
        """Apply no more of the changes that wait."""
        if self._applying is not None:
            self._applying.cancel()

    def apply_diff(self, message: Message, positions_rad: OptionalPositions) -> None:
        """Apply a moveit_msgs/PlanningScene now, ahead of changes that wait."""
        self.apply(lambda draft: self._apply_scene(draft, message), positions_rad)

    def apply(self, change: DraftChange, positions_rad: OptionalPositions) -> None:
        """Apply a change now, ahead of those that wait."""
        self._commit(*self._changed(self.contents, change, positions_rad))

    def with_diff(self, message: Message, positions_rad: OptionalPositions) -> Scene:
        """Return the scene as a moveit_msgs/PlanningScene would make it; this state does not change.

        Fields of the message may be left out.
        """
        changed = self._changed(self.contents, lambda draft: self._apply_scene(draft, message), positions_rad)
        return changed[1] or self.scene

    def _apply_scene(self, draft: SceneDraft, message: Message) -> None:
        model = message.get("robot_model_name", "")
        if model not in ("", self.robot.name):
            log.warning("planning scene: robot_model_name is %r; this robot is %r", model, self.robot.name)
        frames = (entry["child_frame_id"] for entry in message.get("fixed_frame_transforms", ()))
        if ignored := [frame for frame in frames if frame.removeprefix("/") not in ("", self.frame)]:
            log.warning("planning scene: fixed_frame_transforms are ignored, such as %r", ignored[0])
        apply_planning_scene(draft, message, self._srdf_matrix)

    async def _apply_waiting(self) -> None:
        try:
            while self._waiting:
                await self._apply_in_thread(*self._waiting[0])
                self._waiting.popleft()
        finally:
            self._applying = None

    async def _apply_in_thread(
        self, change: SceneChange, positions_rad: OptionalPositions, applied: asyncio.Future[None]
    ) -> None:
        """Apply a change read by a thread, once more if the scene has become another meanwhile."""
        while not applied.done():
            before = self.contents
            try:
                changed = await asyncio.to_thread(self._changed_and_written, before, change.apply, positions_rad)
            except Exception as error:  # a bug in one change must not hold up those that wait
                refusal = error
                if not isinstance(error, RefusedError):
                    log.exception("a change of the planning scene failed")
                    text = f"the change failed inside the server: {type(error).__name__}"
                    refusal = refused(MoveItErrorCode.FAILURE, text)
                if not applied.done():
                    applied.set_exception(refusal)
            else:
                if self.contents is before and not applied.done():
                    self._commit(*changed)
                    applied.set_result(None)

    def _changed_and_written(
        self, before: SceneContents, change: DraftChange, positions_rad: OptionalPositions
    ) -> tuple[SceneContents, Scene | None]:
        contents, scene = self._changed(before, change, positions_rad)
        # Written here and once, for all readers of the scene.
        for each in contents.objects.values():
            _ = each.message
        for held in contents.attached.values():
            _ = held.message
        return contents, scene

    def _commit(self, contents: SceneContents, scene: Scene | None) -> None:
        if contents != self.contents:
            self.contents, self.scene = contents, scene or self.scene
            self.changed()

    def _changed(
        self, before: SceneContents, change: DraftChange, positions_rad: OptionalPositions
    ) -> tuple[SceneContents, Scene | None]:
        """Return changed contents, and the scene for planners unless it stays the same; called in any thread."""
        draft = SceneDraft(before, self.links(positions_rad))
        change(draft)
        contents = draft.contents()
        if contents.looks_same(before):
            return contents, None
        scene = contents.as_scene(next(self._versions), self.robot)
        fault = check_whole(scene, self.robot.links)
        if fault is not None:
            raise RefusedError(fault)
        return contents, scene


def _elements(objects: Sequence[Message]) -> int:
    count = 0
    for each in objects:
        count += OBJECT_ELEMENTS * (1 + sum(len(each[field]) for field, _, _ in GEOMETRY_KINDS))
        count += OBJECT_ELEMENTS * len(each["subframe_names"])
        count += sum(len(mesh["triangles"]) + len(mesh["vertices"]) for mesh in each["meshes"])
        count += sum(OBJECT_ELEMENTS * len(solid["polygon"]["points"]) for solid in each["primitives"])
    return count


class AssumedStates:
    """Joint positions that clients assume, for each client that has sent some, until it leaves.

    Some clients set a robot state in the scene and then ask, over several calls, about that state (compas_fab). No
    motion is ever executed from such a state.
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
        """Complete assumed positions by measured ones, for every movable joint [rad]; None while not all are known."""
        positions = {**(measured_rad or {}), **(assumed_rad or {})}
        return positions if positions.keys() >= self._joints else None

    def note_sent(self, node: Node, positions_rad: Mapping[str, float]) -> None:
        """Note the state that a client was sent: a client that sends the same back assumes nothing by it."""
        self._sent[node] = positions_rad

    def after(self, node: Node, robot_state: Message) -> Mapping[str, float] | None:
        """Return the positions [rad] that a client assumes after a moveit_msgs/RobotState, a diff or a whole one."""
        named = read_joint_positions(robot_state["joint_state"], self._joints, "robot_state.joint_state")
        before, sent = self._assumed.get(node), self._sent.get(node, {})
        if all(sent.get(joint) == position for joint, position in named.items()):
            return before
        return {**(before or {}), **named} if robot_state["is_diff"] else named

    def assume(self, node: Node, positions_rad: Mapping[str, float] | None) -> None:
        """Take over the positions that :meth:`after` has returned."""
        if positions_rad is not None:
            self._assumed[node] = positions_rad
            self._sent[node] = {**self._sent.get(node, {}), **positions_rad}

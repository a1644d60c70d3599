"""Topics and services of the planning scene, under MoveIt's names."""

import asyncio
import functools
import logging
from collections.abc import Callable, Mapping
from typing import Any

from planners.scene_checks import MAX_SCENE_TRIANGLES, MAX_SHAPES
from protocol.messages import ListLimits
from protocol.publication import PublishedMessage
from robot.description.model import RobotModel
from server.errors import GraphError, RefusedError
from server.execution.monitors import CurrentState, state_message
from server.graph.permissions import LOOKING, WORKING
from server.graph.providers import CompleteResponse
from server.graph.services import Call, answer
from server.graph.topics import Graph, LocalNode
from server.moveit.messages import Message, write_pose, write_transform
from server.moveit.parameters import MoveItParameters
from server.moveit.scene.allowed_collision_matrix import AllowedCollisionMatrix
from server.moveit.scene.collision_objects import (
    GEOMETRY_KINDS,
    IDENTITY,
    MAX_SUBFRAMES,
    NO_STAMP,
    REMOVE,
    AttachedCollisionObject,
    CollisionObject,
)
from server.moveit.scene.geometry_files import offer_geometry_files
from server.moveit.scene.planning_scene import MAX_COLORS, NO_PADDING_M, NO_SCALE, SceneContents
from server.moveit.scene.scene_state import AssumedStates, SceneChange, SceneState

log = logging.getLogger("armbridge.scene")

_SHAPE_LISTS = ("primitives", "primitive_poses", "meshes", "mesh_poses", "planes", "plane_poses")

# Corners of all prisms in a message. To cut their surfaces into triangles takes up to 0.1 ms each.
MAX_CORNERS = 2_000

SCENE_LIMITS = ListLimits(
    {
        **{f"moveit_msgs/msg/CollisionObject.{each}": MAX_SHAPES for each in _SHAPE_LISTS},
        "moveit_msgs/msg/CollisionObject.subframe_names": 2 * MAX_SUBFRAMES,
        "moveit_msgs/msg/CollisionObject.subframe_poses": 2 * MAX_SUBFRAMES,
        "moveit_msgs/msg/PlanningScene.object_colors": MAX_COLORS,
        # Some may be removed, and others added.
        "moveit_msgs/msg/PlanningSceneWorld.collision_objects": 2 * MAX_SHAPES,
        "moveit_msgs/msg/RobotState.attached_collision_objects": MAX_SHAPES,
        "geometry_msgs/msg/Polygon.points": MAX_CORNERS,
        "shape_msgs/msg/Mesh.triangles": MAX_SCENE_TRIANGLES,
        "shape_msgs/msg/Mesh.vertices": 3 * MAX_SCENE_TRIANGLES,
    },
    # The matrix, and the other values of each object.
    max_values=100_000,
)

MONITORED_TOPIC = "/monitored_planning_scene"
GET = "/get_planning_scene"
APPLY = "/apply_planning_scene"
CLEAR_OCTOMAP = "/clear_octomap"

# moveit_msgs/PlanningSceneComponents
SCENE_SETTINGS = 1
ROBOT_STATE = 2
ROBOT_STATE_ATTACHED_OBJECTS = 4
WORLD_OBJECT_NAMES = 8
WORLD_OBJECT_GEOMETRY = 16
TRANSFORMS = 64
ALLOWED_COLLISION_MATRIX = 128
LINK_PADDING_AND_SCALING = 256
OBJECT_COLORS = 512
EVERYTHING = 1023

NO_HEADER = {"stamp": NO_STAMP, "frame_id": ""}
NO_OCTOMAP = {
    "header": NO_HEADER,
    "origin": write_pose(IDENTITY),
    "octomap": {"header": NO_HEADER, "binary": False, "id": "", "resolution": 0.0, "data": []},
}
NO_MATRIX: Message = AllowedCollisionMatrix((), frozenset(), {}).message
NO_STATE: Message = state_message({}, "", 0.0)
_NO_GEOMETRY: dict[str, list[Message]] = {field: [] for field, _, _ in GEOMETRY_KINDS}
_EMPTY = CollisionObject("", "", IDENTITY, {"key": "", "db": ""}, _NO_GEOMETRY, (), {})
NO_OBJECT: Message = _EMPTY.message
_NO_POSTURE: Message = {"header": NO_HEADER, "joint_names": [], "points": []}
NO_ATTACHED_OBJECT: Message = AttachedCollisionObject(_EMPTY, (), _NO_POSTURE, 0.0).message


def scene_message(contents: SceneContents, robot: RobotModel, state: Message, components: int) -> dict[str, Any]:
    """Write a moveit_msgs/PlanningScene with all fields, filled for the requested moveit_msgs/PlanningSceneComponents.

    As in MoveIt, a sum of 0 stands for everything. ``state`` is its moveit_msgs/RobotState without attached objects.
    """
    requested = components or EVERYTHING
    settings = requested & SCENE_SETTINGS
    links = robot.links if requested & LINK_PADDING_AND_SCALING else ()
    colors = contents.colors if requested & OBJECT_COLORS else {}
    # As in MoveIt the planning frame is among the fixed frames; here it is the only one.
    frames = (robot.root_link,) if requested & TRANSFORMS else ()
    header = {"stamp": NO_STAMP, "frame_id": robot.root_link}
    return {
        "name": contents.name if settings else "",
        "robot_state": _state(contents, state, requested),
        "robot_model_name": robot.name if settings else "",
        "fixed_frame_transforms": [
            {"header": header, "child_frame_id": name, "transform": write_transform(IDENTITY)} for name in frames
        ],
        "allowed_collision_matrix": contents.allowed_collisions.message
        if requested & ALLOWED_COLLISION_MATRIX
        else NO_MATRIX,
        "link_padding": [{"link_name": link, "padding": contents.padding_m.get(link, NO_PADDING_M)} for link in links],
        "link_scale": [{"link_name": link, "scale": contents.scale.get(link, NO_SCALE)} for link in links],
        "object_colors": [{"id": name, "color": color} for name, color in colors.items()],
        "world": {"collision_objects": _objects(contents, robot, requested), "octomap": NO_OCTOMAP},
        "is_diff": False,
    }


def scene_diff(before: SceneContents, after: SceneContents, robot: RobotModel) -> dict[str, Any]:
    """Write the moveit_msgs/PlanningScene that turns one scene into another; it cannot remove colours."""
    changes = {
        ALLOWED_COLLISION_MATRIX: before.allowed_collisions != after.allowed_collisions,
        LINK_PADDING_AND_SCALING: (before.padding_m, before.scale) != (after.padding_m, after.scale),
        OBJECT_COLORS: before.colors != after.colors,
    }
    components = SCENE_SETTINGS + sum(component for component, changed in changes.items() if changed)
    # Detached first: an object must be in the world to be removed from it.
    detached = [
        {**NO_ATTACHED_OBJECT, "link_name": held.link, "object": {**NO_OBJECT, "id": name, "operation": REMOVE}}
        for name, held in before.attached.items()
        if name not in after.attached
    ]
    attached = [held.message for name, held in after.attached.items() if before.attached.get(name) is not held]
    # Attaching an object removes it from the world.
    known = {*after.objects, *after.attached}
    removed = [name for name in (*before.objects, *before.attached) if name not in known]
    put = [each.message for name, each in after.objects.items() if before.objects.get(name) is not each]
    return {
        **scene_message(after, robot, NO_STATE, components),
        "robot_state": {**NO_STATE, "attached_collision_objects": [*detached, *attached], "is_diff": True},
        "world": {
            "collision_objects": [*({**NO_OBJECT, "id": name, "operation": REMOVE} for name in removed), *put],
            "octomap": NO_OCTOMAP,
        },
        "is_diff": True,
    }


def _state(contents: SceneContents, state: Message, requested: int) -> Message:
    if requested & ROBOT_STATE_ATTACHED_OBJECTS:
        return {**state, "attached_collision_objects": [held.message for held in contents.attached.values()]}
    return state if requested & ROBOT_STATE else NO_STATE


def _objects(contents: SceneContents, robot: RobotModel, requested: int) -> list[Message]:
    if requested & WORLD_OBJECT_GEOMETRY:
        return [each.message for each in contents.objects.values()]
    if requested & WORLD_OBJECT_NAMES:
        header = {"stamp": NO_STAMP, "frame_id": robot.root_link}
        return [
            {**NO_OBJECT, "header": header, "id": name, "type": each.type} for name, each in contents.objects.items()
        ]
    return []


def _subscribe_to_scene_topics(node: LocalNode, state: SceneState, current: CurrentState) -> None:
    """Apply the messages of the scene's topics, without the joints: a topic does not tell its publisher."""
    topics: Mapping[str, tuple[str, Callable[[Message], SceneChange]]] = {
        "/planning_scene": ("moveit_msgs/msg/PlanningScene", state.diff),
        "/planning_scene_world": ("moveit_msgs/msg/PlanningSceneWorld", state.world),
        "/collision_object": ("moveit_msgs/msg/CollisionObject", state.collision_object),
        "/attached_collision_object": ("moveit_msgs/msg/AttachedCollisionObject", state.attached_object),
    }

    def end(topic: str, refusal: BaseException | None) -> None:
        if refusal is not None:
            log.warning("%s: refused, nothing is changed: %s", topic, refusal)

    def deliver(published: PublishedMessage) -> None:
        _, read = topics[published.topic]
        applied = state.submit(read(published.msg), current.positions_rad())
        # The publisher gets a status of a change that is refused at once; of a large one, which waits, there is a log.
        if applied.done() and (refusal := applied.exception()) is not None:
            raise GraphError("topic", published.topic, f"refused, nothing is changed: {refusal}") from refusal
        applied.add_done_callback(lambda applied: end(published.topic, applied.exception()))

    for topic, (type_name, _) in topics.items():
        node.subscribe(topic, type_name, deliver, functools.partial(end, topic), limits=SCENE_LIMITS, rule=WORKING)


class MonitoredScenePublisher:
    """Publisher of scene diffs on ``/monitored_planning_scene``; a new subscriber gets the whole scene first."""

    def __init__(self, graph: Graph, state: SceneState, current: CurrentState, rate_hz: float) -> None:
        self._graph = graph
        self._node = graph.node("planning_scene")
        self._state = state
        self._current = current
        self._published = state.contents
        self._period_s = 1.0 / rate_hz
        self._published_at_s = graph.clock() - self._period_s
        self._timer: asyncio.TimerHandle | None = None
        self._node.advertise(MONITORED_TOPIC, "moveit_msgs/PlanningScene")
        self._latch()
        state.on_change(self._schedule)

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _schedule(self) -> None:
        if self._timer is None:
            due_s = self._published_at_s + self._period_s
            self._timer = self._graph.call_later(max(0.0, due_s - self._graph.clock()), self._publish)

    def _publish(self) -> None:
        self._timer, self._published_at_s = None, self._graph.clock()
        before, self._published = self._published, self._state.contents
        if before != self._published:
            self._node.publish(
                MONITORED_TOPIC, scene_diff(before, self._published, self._state.robot), prevalidated=True
            )
            self._latch()

    def _latch(self) -> None:
        positions_rad = self._current.positions_rad() or {}
        state = state_message(positions_rad, self._state.robot.root_link, self._current.stamp_s)
        self._graph.latch(
            MONITORED_TOPIC, scene_message(self._published, self._state.robot, state, EVERYTHING), prevalidated=True
        )


class SceneInterface:
    """All topics and services of the planning scene."""

    def __init__(
        self,
        graph: Graph,
        state: SceneState,
        assumed: AssumedStates,
        current: CurrentState,
        parameters: MoveItParameters,
    ) -> None:
        self._state = state
        self._assumed = assumed
        self._current = current
        node = graph.node("planning_scene")
        _subscribe_to_scene_topics(node, state, current)
        node.offer_calls(GET, "moveit_msgs/srv/GetPlanningScene", self._get, limits=SCENE_LIMITS, rule=LOOKING)
        node.offer_calls(APPLY, "moveit_msgs/srv/ApplyPlanningScene", self._apply, limits=SCENE_LIMITS, rule=WORKING)
        # The scene has no octomap, so there is nothing to clear.
        node.offer(CLEAR_OCTOMAP, "std_srvs/srv/Empty", lambda _request: {}, rule=WORKING)
        offer_geometry_files(node, state, current, parameters.geometry_directory)
        rate_hz = parameters.publish_planning_scene_hz
        self._publisher = MonitoredScenePublisher(graph, state, current, rate_hz)

    def close(self) -> None:
        """Publish no more, and apply no more changes."""
        self._publisher.close()
        self._state.close()

    def _get(self, call: Call) -> None:
        async def get_settled() -> CompleteResponse:
            await self._state.settled()
            return self._response(call)

        # After the changes that were sent before, also those that take long.
        answer(call, lambda _request: get_settled() if self._state.pending else self._response(call))

    def _response(self, call: Call) -> CompleteResponse:
        assumed = self._assumed
        positions_rad = assumed.completed(assumed.of(call.caller), self._current.positions_rad()) or {}
        assumed.note_sent(call.caller, positions_rad)
        state = state_message(positions_rad, self._state.robot.root_link, self._current.stamp_s)
        components = call.request["components"]["components"]
        scene = scene_message(self._state.contents, self._state.robot, state, components)
        return CompleteResponse({"scene": scene})

    def _apply(self, call: Call) -> None:
        scene, caller, assumed = call.request["scene"], call.caller, self._assumed

        def refuse(reason: object) -> None:
            log.warning("%s: refused, nothing is changed: %s", APPLY, reason)
            call.succeed({"success": False}, f"refused, nothing is changed: {reason}")

        def end(applied: asyncio.Future[None]) -> None:
            if applied.cancelled():
                refuse("its request ended before the change was applied")
            elif (refusal := applied.exception()) is not None:
                refuse(refusal)
            else:
                # A client that has left assumes nothing any more.
                if not call.caller_left:
                    assumed.assume(caller, assumed_rad)
                call.succeed({"success": True})

        try:
            assumed_rad = assumed.after(caller, scene["robot_state"])
        except RefusedError as error:
            refuse(error)
            return
        positions_rad = assumed.completed(assumed_rad, self._current.positions_rad())
        applied = self._state.submit(self._state.diff(scene), positions_rad)
        if applied.done():
            end(applied)
            return
        applied.add_done_callback(end)
        # The change of a client that has left is made nevertheless: it got no failure as an answer.
        call.when_ended(lambda _response: call.caller_left or applied.cancel())

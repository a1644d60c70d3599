"""Topics and services by which clients see and change the planning scene."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any

from planners.problem import PlanningFailure
from planners.scene import Pose
from protocol.errors import MessageError
from protocol.publication import Publication
from robot.model import RobotModel
from server.calls import Call, answer
from server.errors import RefusedError
from server.graph import Graph, Subscriber
from server.moveit.current_state import CurrentState, state_message
from server.moveit.parameters import MoveItParameters
from server.moveit.poses import write_pose
from server.moveit.requests.error_codes import required
from server.moveit.scene.collision_objects import ADD, IDENTITY, NO_STAMP, REMOVE
from server.moveit.scene.geometry_files import GeometryFiles
from server.moveit.scene.planning_scene import NO_PADDING_M, NO_SCALE, SceneContents
from server.moveit.scene.scene_state import AssumedStates, Positions, SceneState
from server.node import Node
from server.timers import CallLater, Timer, call_later

Message = Mapping[str, Any]

# moveit_msgs/PlanningSceneComponents
SCENE_SETTINGS = 1
ROBOT_STATE = 2
ROBOT_STATE_ATTACHED_OBJECTS = 4
WORLD_OBJECT_NAMES = 8
WORLD_OBJECT_GEOMETRY = 16
OCTOMAP = 32
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
NO_MATRIX: Message = {
    "entry_names": [],
    "entry_values": [],
    "default_entry_names": [],
    "default_entry_values": [],
}
NO_STATE: Message = {
    "joint_state": {"header": NO_HEADER, "name": [], "position": [], "velocity": [], "effort": []},
    "multi_dof_joint_state": {"header": NO_HEADER, "joint_names": [], "transforms": [], "twist": [], "wrench": []},
    "attached_collision_objects": [],
    "is_diff": False,
}
NO_OBJECT: Message = {
    "header": NO_HEADER,
    "pose": write_pose(IDENTITY),
    "id": "",
    "type": {"key": "", "db": ""},
    "primitives": [],
    "primitive_poses": [],
    "meshes": [],
    "mesh_poses": [],
    "planes": [],
    "plane_poses": [],
    "subframe_names": [],
    "subframe_poses": [],
    "operation": ADD,
}


def scene_message(contents: SceneContents, robot: RobotModel, state: Message, components: int) -> dict[str, Any]:
    """The moveit_msgs/PlanningScene of a scene, with every field, empty where it was not asked for.

    Args:
        contents: the scene.
        robot: the arm.
        state: its moveit_msgs/RobotState without what is held.
        components: sum of what is wanted, as moveit_msgs/PlanningSceneComponents; 0 for everything, as in MoveIt.
    """
    wanted = components or EVERYTHING
    settings, links = wanted & SCENE_SETTINGS, wanted & LINK_PADDING_AND_SCALING
    return {
        "name": contents.name if settings else "",
        "robot_state": _state(contents, state, wanted),
        "robot_model_name": robot.name if settings else "",
        "fixed_frame_transforms": _transforms(contents, robot) if wanted & TRANSFORMS else [],
        "allowed_collision_matrix": contents.matrix.message if wanted & ALLOWED_COLLISION_MATRIX else NO_MATRIX,
        "link_padding": _padding(contents, robot) if links else [],
        "link_scale": _scale(contents, robot) if links else [],
        "object_colors": _colors(contents) if wanted & OBJECT_COLORS else [],
        "world": {"collision_objects": _objects(contents, robot, wanted), "octomap": NO_OCTOMAP},
        "is_diff": False,
    }


def difference(before: SceneContents, after: SceneContents, robot: RobotModel) -> dict[str, Any]:
    """The moveit_msgs/PlanningScene that makes one scene of another; colours and frames that are gone stay in it."""
    links = (before.padding_m, before.scale) != (after.padding_m, after.scale)
    return {
        "name": after.name,
        "robot_state": {**NO_STATE, "attached_collision_objects": _changed_attached(before, after), "is_diff": True},
        "robot_model_name": robot.name,
        "fixed_frame_transforms": _transforms(after, robot) if before.fixed_frames != after.fixed_frames else [],
        "allowed_collision_matrix": after.matrix.message if before.matrix != after.matrix else NO_MATRIX,
        "link_padding": _padding(after, robot) if links else [],
        "link_scale": _scale(after, robot) if links else [],
        "object_colors": _colors(after) if before.colors != after.colors else [],
        "world": {"collision_objects": _changed_objects(before, after), "octomap": NO_OCTOMAP},
        "is_diff": True,
    }


def _state(contents: SceneContents, state: Message, wanted: int) -> Message:
    if wanted & ROBOT_STATE_ATTACHED_OBJECTS:
        return {**state, "attached_collision_objects": [held.message for held in contents.attached.values()]}
    return state if wanted & ROBOT_STATE else NO_STATE


def _objects(contents: SceneContents, robot: RobotModel, wanted: int) -> list[Message]:
    if wanted & WORLD_OBJECT_GEOMETRY:
        return [thing.message for thing in contents.objects.values()]
    if wanted & WORLD_OBJECT_NAMES:
        header = {"stamp": NO_STAMP, "frame_id": robot.root_link}
        return [
            {**NO_OBJECT, "header": header, "id": name, "type": thing.type} for name, thing in contents.objects.items()
        ]
    return []


def _changed_objects(before: SceneContents, after: SceneContents) -> list[Message]:
    # What is held now is taken from the world by being attached.
    gone = [name for name in _known(before) if name not in _known(after)]
    changed = [thing.message for name, thing in after.objects.items() if before.objects.get(name) is not thing]
    return [*({**NO_OBJECT, "id": name, "operation": REMOVE} for name in gone), *changed]


def _changed_attached(before: SceneContents, after: SceneContents) -> list[Message]:
    # Being put down comes first, so that all that is gone stands around when it is removed.
    put_down = [
        {"link_name": held.link, "object": {**NO_OBJECT, "id": name, "operation": REMOVE}}
        for name, held in before.attached.items()
        if name not in after.attached
    ]
    taken = [held.message for name, held in after.attached.items() if before.attached.get(name) is not held]
    return [*put_down, *taken]


def _known(contents: SceneContents) -> dict[str, object]:
    return {**contents.objects, **contents.attached}


def _padding(contents: SceneContents, robot: RobotModel) -> list[Message]:
    return [{"link_name": link, "padding": contents.padding_m.get(link, NO_PADDING_M)} for link in robot.links]


def _scale(contents: SceneContents, robot: RobotModel) -> list[Message]:
    return [{"link_name": link, "scale": contents.scale.get(link, NO_SCALE)} for link in robot.links]


def _colors(contents: SceneContents) -> list[Message]:
    return [{"id": name, "color": color} for name, color in contents.colors.items()]


def _transforms(contents: SceneContents, robot: RobotModel) -> list[Message]:
    """Frames that stand still; as in MoveIt the planning frame is among them."""
    return [
        _transform(robot.root_link, name, pose)
        for name, pose in {robot.root_link: IDENTITY, **contents.fixed_frames}.items()
    ]


def _transform(root: str, name: str, pose: Pose) -> Message:
    written = write_pose(pose)
    return {
        "header": {"stamp": NO_STAMP, "frame_id": root},
        "child_frame_id": name,
        "transform": {"translation": written["position"], "rotation": written["orientation"]},
    }


log = logging.getLogger("armbridge.scene")

Apply = Callable[[Mapping[str, Any], Positions], PlanningFailure | None]


class SceneTopics:
    """Takes changes of the scene from topics; what is refused is told to the log.

    A topic does not say who speaks, so joints in a ``/planning_scene`` are passed over.

    Args:
        graph: where the topics are.
        node: who listens.
        state: the scene.
    """

    def __init__(self, graph: Graph, node: Node, state: SceneState) -> None:
        self._graph = graph
        self._node = node
        self._applied: Mapping[str, tuple[str, Apply]] = {
            "/planning_scene": ("moveit_msgs/PlanningScene", state.apply_diff),
            "/planning_scene_world": ("moveit_msgs/PlanningSceneWorld", state.apply_world),
            "/collision_object": ("moveit_msgs/CollisionObject", state.apply_object),
            "/attached_collision_object": ("moveit_msgs/AttachedCollisionObject", state.apply_held_object),
        }

    def open(self, current: CurrentState) -> None:
        """Subscribe.

        Args:
            current: where the joints are.
        """
        for topic, (type_name, apply) in self._applied.items():
            self._graph.subscribe(self._node, topic, type_name, _subscriber(topic, apply, current))


def _subscriber(topic: str, apply: Apply, current: CurrentState) -> Subscriber:
    def deliver(publication: Publication) -> None:
        failure = apply(publication.msg, current.positions_rad())
        if failure is not None:
            log.warning("%s: refused, nothing is changed: %s", topic, failure.message)

    def refused(error: MessageError) -> None:
        log.warning("%s: refused, nothing is changed: %s", topic, error)

    return Subscriber(deliver, refused)


TOPIC = "/monitored_planning_scene"


class MonitoredScene:
    """Publishes differences; a new subscriber gets the whole scene first.

    Args:
        graph: where the topic is.
        node: who publishes.
        robot: the arm.
        state: the scene.
        rate_hz: changes that come faster are told together [Hz].
        clock: monotonic time [s].
        call_later: does something after a delay.
    """

    def __init__(
        self,
        graph: Graph,
        node: Node,
        robot: RobotModel,
        state: SceneState,
        rate_hz: float,
        clock: Callable[[], float] = time.monotonic,
        call_later: CallLater = call_later,
    ) -> None:
        self._graph = graph
        self._node = node
        self._robot = robot
        self._state = state
        self._clock = clock
        self._call_later = call_later
        self._told = state.contents
        self._period_s = 1.0 / rate_hz
        self._told_at_s = clock() - self._period_s
        self._timer: Timer | None = None
        state.on_change(self._changed)

    def open(self, current: CurrentState) -> None:
        """Advertise the topic and tell the whole scene.

        Args:
            current: where the joints are.
        """
        self._current = current
        self._graph.advertise(self._node, TOPIC, "moveit_msgs/PlanningScene")
        self._latch()

    def close(self) -> None:
        """Tell no more."""
        if self._timer is not None:
            self._timer.cancel()

    def _changed(self) -> None:
        if self._timer is None:
            due_s = self._told_at_s + self._period_s
            self._timer = self._call_later(max(0.0, due_s - self._clock()), self._tell)

    def _tell(self) -> None:
        self._timer, self._told_at_s = None, self._clock()
        before, self._told = self._told, self._state.contents
        if before != self._told:
            self._graph.publish(self._node, TOPIC, difference(before, self._told, self._robot))
            self._latch()

    def _latch(self) -> None:
        state = self._current.message()
        self._graph.latch(TOPIC, scene_message(self._told, self._robot, state, EVERYTHING))


GET = "/get_planning_scene"
APPLY = "/apply_planning_scene"
CLEAR_OCTOMAP = "/clear_octomap"


class SceneServices:
    """Answers those who ask for the scene or change it by a service.

    Args:
        graph: where the services are.
        node: who offers them.
        robot: the arm.
        state: the scene.
        assumed: where clients take the joints to be.
    """

    def __init__(self, graph: Graph, node: Node, robot: RobotModel, state: SceneState, assumed: AssumedStates) -> None:
        self._graph = graph
        self._node = node
        self._robot = robot
        self._state = state
        self._assumed = assumed

    def open(self, current: CurrentState) -> None:
        """Offer the services.

        Args:
            current: where the joints are.
        """

        def get(call: Call) -> None:
            call.succeed_as_it_is(self._get(call.caller, call.request, current))

        def apply(call: Call) -> None:
            answer(call, lambda request: self._apply(call.caller, request, current))

        services = self._graph.services
        services.offer_calls(self._node, GET, "moveit_msgs/srv/GetPlanningScene", get)
        services.offer_calls(self._node, APPLY, "moveit_msgs/srv/ApplyPlanningScene", apply)
        # There is no octomap that could hold anything.
        services.offer(self._node, CLEAR_OCTOMAP, "std_srvs/srv/Empty", lambda _request: {})

    def _get(self, caller: Node, request: Message, current: CurrentState) -> Message:
        assumed = self._assumed
        positions_rad = assumed.completed(assumed.of(caller), current.positions_rad()) or {}
        assumed.tell(caller, positions_rad)
        state = state_message(positions_rad, self._robot.root_link, time.time())
        wanted = request["components"]["components"]
        return {"scene": scene_message(self._state.contents, self._robot, state, wanted)}

    def _apply(self, caller: Node, request: Message, current: CurrentState) -> Message:
        scene, assumed = request["scene"], self._assumed
        try:
            stated_rad = assumed.stated(caller, scene["robot_state"])
            required(self._state.apply_diff(scene, assumed.completed(stated_rad, current.positions_rad())))
        except RefusedError as error:
            log.warning("%s: refused, nothing is changed: %s", APPLY, error)
            return {"success": False}
        assumed.assume(caller, stated_rad)
        return {"success": True}


class SceneInterface:
    """The scene's topics and services.

    Args:
        graph: where they are.
        robot: the arm.
        state: the scene.
        assumed: where clients take the joints to be.
        parameters: how often changes are told, and where files of geometry are.
    """

    def __init__(
        self,
        graph: Graph,
        robot: RobotModel,
        state: SceneState,
        assumed: AssumedStates,
        parameters: MoveItParameters,
    ) -> None:
        node = Node("planning_scene")
        self._monitored = MonitoredScene(graph, node, robot, state, parameters.publish_planning_scene_hz)
        self._parts = (
            SceneTopics(graph, node, state),
            SceneServices(graph, node, robot, state, assumed),
            GeometryFiles(graph, node, state, parameters.geometry_directory),
            self._monitored,
        )

    def open(self, current: CurrentState) -> None:
        """Begin to listen, answer and tell.

        Args:
            current: where the joints are.
        """
        for part in self._parts:
            part.open(current)

    def close(self) -> None:
        """Tell no more."""
        self._monitored.close()

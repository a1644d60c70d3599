"""MoveIt's services on a graph of their own, with a planner in the same process and an arm that stands still."""

from __future__ import annotations

import asyncio
import functools
import time
from typing import Any

from planners.pipeline import Planner
from planners.problem import Answer, PlanningFailure, Request
from planners.scene import EMPTY_SCENE, Scene
from protocol.registry import Registry
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.display import DisplayTopics
from server.moveit.parameters import MoveItParameters
from server.moveit.planner_parameters import PlannerParameters
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.scene.frames import Frames
from server.moveit.scene.scene_state import SceneState
from server.moveit.services.move_group_services import offer_services

ROBOT = model.builtin()
HOME = {joint.name: 0.0 for joint in ROBOT.movable_joints}
REGISTRY = Registry.load()


@functools.cache
def planner() -> Planner:
    # By the clock of planner processes, which a busy machine does not hurry.
    return Planner(ROBOT, time.process_time)


class DirectPool:
    """Asks the planner at once."""

    def __init__(self) -> None:
        self.requests: list[Request] = []

    async def ask(self, request: Request, scene: Scene = EMPTY_SCENE) -> Answer:
        self.requests.append(request)
        refusal = planner().set_scene(scene)
        return refusal if isinstance(refusal, PlanningFailure) else planner().answer(request)


class StandingArm:
    """Where the arm is."""

    def __init__(self) -> None:
        self.at_rad: dict[str, float] | None = dict(HOME)

    def positions_rad(self) -> dict[str, float] | None:
        return self.at_rad


class Assumed:
    """What clients want to be assumed."""

    def __init__(self) -> None:
        self.by_node: dict[Node, dict[str, float]] = {}

    def of(self, node: Node) -> dict[str, float] | None:
        return self.by_node.get(node)


class ServiceRig:
    """All of it, and a client."""

    def __init__(self, robot: RobotModel = ROBOT, parameters: MoveItParameters | None = None) -> None:
        self.graph = Graph(REGISTRY)
        self.arm, self.assumed, self.pool = StandingArm(), Assumed(), DirectPool()
        self.client = Node("client", remote=True)
        self.scene_state = SceneState(robot)
        display = DisplayTopics(self.graph, robot)
        display.open()
        self.context = PlanningContext(
            robot=robot,
            pool=self.pool,
            forward=ForwardPlacements(robot),
            frames=Frames(robot, self.scene_state),
            scene_state=self.scene_state,
            current=self.arm,
            assumed=self.assumed,
            parameters=PlannerParameters(parameters or MoveItParameters()),
            display=display,
        )
        offer_services(self.graph, self.context)

    async def call(self, service: str, **request: Any) -> Any:
        """The values of the response; fails when the call failed."""
        ok, values = await self.outcome(service, **request)
        assert ok, values
        return values

    async def outcome(self, service: str, **request: Any) -> tuple[bool, Any]:
        """Whether a call succeeded, and its values."""
        answered = asyncio.get_running_loop().create_future()
        self.graph.services.call(self.client, service, request, answered.set_result)
        response = await asyncio.wait_for(answered, 60.0)
        return response.ok, response.values

    def listen(self, topic: str, type_name: str) -> list[Any]:
        """The messages that come on a topic from now on."""
        heard: list[Any] = []
        self.graph.subscribe(Node("viewer"), topic, type_name, Subscriber(lambda news: heard.append(news.msg)))
        return heard

"""``/get_planning_scene``, ``/apply_planning_scene`` and ``/clear_octomap``."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from typing import Any

from robot.description.model import RobotModel
from server.errors import RefusedError
from server.execution.current_state import CurrentState, state_message
from server.graph.node import Node
from server.graph.services import Call, answer
from server.graph.topics import Graph
from server.moveit.requests.refusals import required
from server.moveit.scene.assumed import AssumedStates
from server.moveit.scene.messages import scene_message
from server.moveit.scene.state import SceneState

Message = Mapping[str, Any]

log = logging.getLogger("armbridge.scene")

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

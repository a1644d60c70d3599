"""Named states on the wire: MoveIt's warehouse services, and the latched topic ``/named_states``.

Names and types of the services are those of moveit_ros_warehouse's node warehouse_services.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Awaitable, Mapping
from typing import Any

from robot.description.model import RobotModel
from server.errors import ServiceError
from server.graph.node import Node
from server.graph.services import ServiceFunction
from server.graph.topics import Graph
from server.moveit.current_state import CurrentState, state_message
from server.moveit.named_states import NamedStates, Positions

TOPIC = "/named_states"

# Matching goes back and forth: without groups and with two repeats it takes at most a few thousand steps a name.
MAX_PATTERN_LENGTH = 100
MAX_REPEATS = 2

Request = dict[str, Any]


class NamedStatesServices:
    """Offers the services and publishes the states at every change.

    Args:
        graph: where they are.
        robot: the arm.
        states: the states.
    """

    def __init__(self, graph: Graph, robot: RobotModel, states: NamedStates) -> None:
        self._graph = graph
        self._robot = robot
        self._states = states
        self._node = Node("named states")

    def open(self, current: CurrentState) -> None:
        """Offer and publish.

        Args:
            current: where the arm is.
        """
        self._graph.advertise(self._node, TOPIC, "std_msgs/String", latch=True)
        self._publish()
        self._states.on_change(self._publish)
        self._offer("/list_robot_states", "ListRobotStatesInWarehouse", self._list)
        self._offer("/save_robot_state", "SaveRobotStateToWarehouse", lambda request: self._save(request, current))
        self._offer("/get_robot_state", "GetRobotStateFromWarehouse", self._get)
        self._offer("/has_robot_state", "CheckIfRobotStateExistsInWarehouse", self._has)
        self._offer("/rename_robot_state", "RenameRobotStateInWarehouse", self._rename)
        self._offer("/delete_robot_state", "DeleteRobotStateFromWarehouse", self._delete)

    def _offer(self, name: str, type_name: str, function: ServiceFunction) -> None:
        def serve(request: Request) -> Mapping[str, Any] | Awaitable[Mapping[str, Any]]:
            if request["robot"] not in ("", self._robot.name):
                raise ServiceError(f"robot: there is no robot {request['robot']!r}; this is {self._robot.name!r}")
            return function(request)

        self._graph.services.offer(self._node, name, f"moveit_msgs/{type_name}", serve)

    def _publish(self) -> None:
        states = {
            **{name: {"saved": False, "joints": state} for name, state in self._states.described.items()},
            **{name: {"saved": True, "joints": state} for name, state in self._states.saved.items()},
        }
        self._graph.publish(self._node, TOPIC, {"data": json.dumps(states)})

    def _list(self, request: Request) -> Request:
        pattern = request["regex"]
        repeats = sum(map(pattern.count, "*+?{"))
        if len(pattern) > MAX_PATTERN_LENGTH or repeats > MAX_REPEATS or "(" in pattern:
            allowed = f"at most {MAX_PATTERN_LENGTH} characters, no group and {MAX_REPEATS} repeats"
            raise ServiceError(f"regex: must have {allowed}, not {pattern[:MAX_PATTERN_LENGTH]!r}")
        try:
            wanted = re.compile(pattern or ".*")
        except re.error as error:
            raise ServiceError(f"regex: {pattern!r} is no regular expression: {error}") from error
        return {"states": [name for name in self._states.names if wanted.fullmatch(name)]}

    async def _save(self, request: Request, current: CurrentState) -> Request:
        """Save the state in the request; of one without joints, where the arm is."""
        given = request["state"]["joint_state"]
        names, positions = given["name"], given["position"]
        if len(names) != len(positions):
            raise ServiceError(f"state.joint_state: {len(names)} names and {len(positions)} positions")
        positions_rad: Positions | None = dict(zip(names, positions, strict=True)) or current.positions_rad()
        if positions_rad is None:
            raise ServiceError("state: has no joints, and where the arm is is not known")
        await self._states.save(request["name"], positions_rad)
        return {"success": True}

    def _get(self, request: Request) -> Request:
        found = self._states.find(request["name"])
        if found is None:
            raise ServiceError(
                f"name: there is no state {request['name']!r}; known are: {', '.join(self._states.names)}"
            )
        return {"state": state_message(dict(found[1]), self._robot.root_link, time.time())}

    def _has(self, request: Request) -> Request:
        return {"exists": self._states.find(request["name"]) is not None}

    async def _rename(self, request: Request) -> Request:
        await self._states.rename(request["old_name"], request["new_name"])
        return {}

    async def _delete(self, request: Request) -> Request:
        await self._states.delete(request["name"])
        return {}

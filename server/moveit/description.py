"""Description of the robot for clients: latched topics, parameters, and the files that the URDF names.

MoveIt's clients read the URDF and SRDF from latched topics (ROS 2) or parameters (ROS 1), and fetch meshes by
``package://`` URLs from file_server's service ``/file_server/get_file`` (compas_robots, ros-sharp). Those that fetch
by HTTP are answered by :mod:`server.gateway.http`.
"""

from __future__ import annotations

import asyncio
import base64
import json
import logging
from collections.abc import Callable
from typing import Any

from robot.description.model import RobotModel
from server.graph.node import Node
from server.graph.permissions import LOOKING
from server.graph.topics import Graph
from server.robot_files import RobotFiles, package_name, with_package_urls

log = logging.getLogger("armbridge.description")

URDF_TOPIC = "/robot_description"
SRDF_TOPIC = "/robot_description_semantic"
# Nodes that have these parameters in ROS 2.
NODES = ("/robot_state_publisher", "/move_group")

FILE_SERVICE = "/file_server/get_file"


class RobotDescription:
    """Topics, parameters and file service of the description."""

    def __init__(self, graph: Graph, robot: RobotModel, keep_parameter: Callable[[str, str], None]) -> None:
        self._graph = graph
        self._robot = robot
        self._files = RobotFiles(robot)
        self._keep_parameter = keep_parameter
        self._node = Node("robot description")
        package = package_name(self._robot)
        texts = {URDF_TOPIC: with_package_urls(self._robot.urdf, package), SRDF_TOPIC: self._robot.srdf}
        for topic, text in texts.items():
            self._graph.advertise(self._node, topic, "std_msgs/String", latch=True)
            self._graph.publish(self._node, topic, {"data": text})
            name = topic.removeprefix("/")
            # ROS 1 clients ask for the name with its slash or without, clients of ROS 2 for a parameter of a node.
            for parameter in (topic, name, *(f"{node}:{name}" for node in NODES)):
                self._keep_parameter(parameter, json.dumps(text))
        self._graph.services.offer(self._node, FILE_SERVICE, "file_server/GetBinaryFile", self._get_file, rule=LOOKING)

    async def _get_file(self, request: dict[str, Any]) -> dict[str, Any]:
        # A slow disk must not hold up whatever else the server does; the call itself is bounded.
        octets = await asyncio.to_thread(self._files.read, request["name"])
        return {"value": base64.b64encode(octets).decode("ascii")}

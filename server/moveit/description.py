"""The robot's description as clients load it: latched topics, parameters, and the files that the URDF names.

MoveIt's clients read the URDF and SRDF from latched topics (ROS 2) or parameters (ROS 1), and fetch meshes by
``package://`` URLs from file_server's service ``/file_server/get_file`` (compas_robots, ros-sharp).
"""

from __future__ import annotations

import asyncio
import base64
import json
import logging
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robot.model import RobotModel
from server.errors import ServiceError
from server.graph import Graph
from server.node import Node

log = logging.getLogger("armbridge.description")

URDF_TOPIC = "/robot_description"
SRDF_TOPIC = "/robot_description_semantic"
FILE_SERVICE = "/file_server/get_file"

# A mesh of a million triangles is 50 MB; a link's has a thousandth of it. Base64 makes it a third more on the wire.
MAX_FILE_BYTES = 20 << 20

_SCHEME = re.compile(r"^[a-z][a-z0-9+.-]*://")


class RobotDescription:
    """Publishes the description and serves its files.

    Args:
        graph: where topics and service are.
        robot: the arm.
        keep_parameter: keeps a parameter for rosapi, its value as JSON text.
    """

    def __init__(self, graph: Graph, robot: RobotModel, keep_parameter: Callable[[str, str], None]) -> None:
        self._graph = graph
        self._robot = robot
        self._keep_parameter = keep_parameter
        self._node = Node("robot description")

    def open(self) -> None:
        """Publish, and offer the service."""
        package = package_name(self._robot)
        texts = {URDF_TOPIC: with_package_urls(self._robot.urdf, package), SRDF_TOPIC: self._robot.srdf}
        for topic, text in texts.items():
            self._graph.advertise(self._node, topic, "std_msgs/String", latch=True)
            self._graph.publish(self._node, topic, {"data": text})
            # ROS 1 clients ask for the name with its slash or without.
            for name in (topic, topic.removeprefix("/")):
                self._keep_parameter(name, json.dumps(text))
        self._graph.services.offer(self._node, FILE_SERVICE, "file_server/GetBinaryFile", self._get_file)

    async def _get_file(self, request: dict[str, Any]) -> dict[str, Any]:
        # A slow disk must not hold up whatever else the server does; the call itself is bounded.
        directory, package = self._robot.mesh_directory, package_name(self._robot)
        octets = await asyncio.to_thread(read_file, directory, package, request["name"])
        return {"value": base64.b64encode(octets).decode("ascii")}


def package_name(robot: RobotModel) -> str:
    """Name of the package under which the robot's files are served, as ROS packages are named."""
    return f"{re.sub(r'[^a-z0-9_]+', '_', robot.name.lower())}_description"


def with_package_urls(urdf: str, package: str) -> str:
    """The URDF with every mesh that is named by a path, such as ``assets/base.stl``, named by a package URL instead.

    Args:
        urdf: the text.
        package: whose files they are said to be.
    """
    root = ET.fromstring(urdf)  # noqa: S314 - the user's own file, already parsed by robot.model
    meshes = [mesh for mesh in root.iter("mesh") if not _SCHEME.match(mesh.get("filename", ""))]
    if not meshes:
        return urdf
    for mesh in meshes:
        mesh.set("filename", f"package://{package}/{mesh.get('filename', '').removeprefix('./')}")
    return ET.tostring(root, encoding="unicode")


def read_file(directory: Path | None, package: str, name: str) -> bytes:
    """Read one of the robot's files.

    Args:
        directory: that of the URDF; nothing outside it is served.
        package: the name in package URLs.
        name: a ``package://`` URL, or a path within the directory.

    Raises:
        ServiceError: no such file, one outside the directory, or one that is too large.
    """
    if directory is None:
        raise ServiceError(f"name: {name!r} is not here: this robot's description names no files")
    nowhere = f"name: {name!r} is no file below package://{package}/"
    try:
        path = (directory / name.removeprefix(f"package://{package}/")).resolve()
        # Whatever the name says, links included, the file must be where the description is.
        if not path.is_relative_to(directory.resolve()) or not path.is_file():
            raise ServiceError(nowhere)
        size_bytes = path.stat().st_size
        if size_bytes > MAX_FILE_BYTES:
            raise ServiceError(f"name: {name!r} has {size_bytes} bytes, the limit is {MAX_FILE_BYTES}")
        return path.read_bytes()
    # A name with a zero byte is no name of a file.
    except (OSError, ValueError) as error:
        raise ServiceError(f"{nowhere}: {error}") from error

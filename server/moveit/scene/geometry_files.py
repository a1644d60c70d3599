"""``/save_geometry_to_file`` and ``/load_geometry_from_file``: inside one folder, or nowhere."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from protocol.errors import MessageError
from server.errors import RefusedError
from server.execution.current_state import CurrentState
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.requests.refusals import invalid, required
from server.moveit.scene.contents import SceneContents
from server.moveit.scene.geometry_text import read_geometry, write_geometry
from server.moveit.scene.state import SceneState

log = logging.getLogger("armbridge.scene")

Message = Mapping[str, Any]

SAVE = "/save_geometry_to_file"
LOAD = "/load_geometry_from_file"

# A mesh of a hundred thousand triangles, with its vertices, has as much text.
MAX_FILE_BYTES = 10_000_000


class GeometryFiles:
    """Saves and loads what stands around.

    Args:
        graph: where the services are.
        node: who offers them.
        state: the scene.
        directory: where the files are; None for nowhere.
    """

    def __init__(self, graph: Graph, node: Node, state: SceneState, directory: Path | None) -> None:
        self._graph = graph
        self._node = node
        self._state = state
        self._directory = directory

    def open(self, current: CurrentState) -> None:
        """Offer the services.

        Args:
            current: where the joints are.
        """

        async def save(request: Message) -> Message:
            return await _told(SAVE, self._save(request["file_path_and_name"]))

        async def load(request: Message) -> Message:
            return await _told(LOAD, self._load(request["file_path_and_name"], current))

        services = self._graph.services
        services.offer(self._node, SAVE, "moveit_msgs/srv/SaveGeometryToFile", save)
        services.offer(self._node, LOAD, "moveit_msgs/srv/LoadGeometryFromFile", load)

    async def _save(self, name: str) -> None:
        path = file_within(self._directory, name)
        try:
            await asyncio.to_thread(_write_bounded, path, self._state.contents)
        except OSError as error:
            raise invalid(f"{path} cannot be written: {error}") from error

    async def _load(self, name: str, current: CurrentState) -> None:
        path = file_within(self._directory, name)
        try:
            objects = await asyncio.to_thread(_read_bounded, path, self._state.frame)
        except (OSError, UnicodeDecodeError) as error:
            raise invalid(f"{path} cannot be read: {error}") from error
        try:
            complete = self._graph.interfaces.complete
            world = complete("moveit_msgs/msg/PlanningSceneWorld", {"collision_objects": objects})
        except MessageError as error:
            raise invalid(f"{path}: {error}") from error
        # As in MoveIt, what the file does not name stays.
        required(self._state.apply_diff({"is_diff": True, "world": world}, current.positions_rad()))


def file_within(directory: Path | None, name: str) -> Path:
    """The file that a client means; relative names start in the directory.

    Args:
        directory: where files may be; None for nowhere.
        name: as the client gave it.

    Raises:
        RefusedError: it is elsewhere, or no file of any name.
    """
    if directory is None:
        raise invalid("the setting moveit.geometry_directory names no folder, so there are no files")
    folder = directory.resolve()
    try:
        path = (folder / name).resolve()
    except (ValueError, OSError) as error:
        raise invalid(f"file_path_and_name {name[:100]!r} is no file: {error}") from error
    if path == folder or not path.is_relative_to(folder):
        raise invalid(f"file_path_and_name {name[:100]!r} must be a file in {folder}")
    return path


async def _told(service: str, work: Any) -> Message:
    """Do it, and tell the log why it could not be done."""
    try:
        await work
    except RefusedError as error:
        log.warning("%s: %s", service, error)
        return {"success": False}
    return {"success": True}


def _write_bounded(path: Path, contents: SceneContents) -> None:
    text = write_geometry(contents)
    if len(text) > MAX_FILE_BYTES:
        raise invalid(f"the scene has {len(text)} characters as text, more than {MAX_FILE_BYTES}")
    path.write_text(text)


def _read_bounded(path: Path, frame: str) -> list[dict[str, Any]]:
    size = path.stat().st_size
    if size > MAX_FILE_BYTES:
        raise invalid(f"{path} has {size} bytes, more than {MAX_FILE_BYTES}")
    return read_geometry(path.read_text(), frame)

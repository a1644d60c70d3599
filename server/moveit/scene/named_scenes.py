"""Planning scenes that users save by name, and the services that list, save, load and delete them.

Each is a file of its own, in the format of the kept scene (:mod:`server.moveit.scene.saved_scene`).
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeAlias

from protocol.errors import MessageError
from server.answers import telling
from server.errors import RefusedError, ServiceError
from server.execution.monitors import CurrentState
from server.execution.motions import Positions
from server.graph.message_types import MessageTypes
from server.graph.node import Node
from server.graph.permissions import CONFIGURING, LOOKING, WORKING, Rule
from server.graph.topics import Graph
from server.moveit.poses import Message
from server.moveit.scene.planning_scene import SceneContents
from server.moveit.scene.saved_scene import complete_scene, encoded_bounded, kept_message
from server.moveit.scene.scene_state import SceneState
from server.named_files import NamedFiles, read_json

log = logging.getLogger("armbridge.scene")

# As many as a list shows that people read; with MAX_SCENE_BYTES they fill at most 1 GB of a disk.
MAX_SCENES = 50

# A mesh of 80 000 triangles, the largest, has 6 MB as text.
MAX_SCENE_BYTES = 20_000_000

_Work: TypeAlias = Callable[[str], Awaitable[str]]


def objects_in_words(contents: SceneContents) -> str:
    """Return the number of a scene's objects in words: "1 object", "2 objects"."""
    count = len(contents.objects) + len(contents.attached)
    return f"{count} object{'' if count == 1 else 's'}"


class NamedScenes(NamedFiles):
    """Store of scenes by name."""

    def __init__(self, folder: Path, state: SceneState, message_types: MessageTypes) -> None:
        super().__init__(folder, "scene", MAX_SCENES)
        self._state = state
        self._message_types = message_types

    async def save(self, name: str) -> str:
        """Save the present scene, in place of one of the same name; return a sentence about it."""
        await self._state.settled()
        contents, robot = self._state.contents, self._state.robot
        await self.write(name, lambda: encoded_bounded(kept_message(contents, robot), MAX_SCENE_BYTES))
        return f"the scene {name!r} is saved, with {objects_in_words(contents)}"

    async def load(self, name: str, positions_rad: Positions | None) -> str:
        """Replace the present scene by a saved one; return a sentence about it."""
        content = await self.read(name, lambda path: read_json(path, MAX_SCENE_BYTES), "loaded")
        try:
            message = complete_scene(self._message_types, content)
            await self._state.change(self._state.diff(message), positions_rad)
        except (MessageError, RefusedError) as error:
            raise ServiceError(f"the scene {name!r} cannot be loaded: {error}") from error
        return f"the scene {name!r} is loaded, with {objects_in_words(self._state.contents)}"


def offer_named_scenes(graph: Graph, scenes: NamedScenes, current: CurrentState) -> None:
    """Offer ``/arm/scenes/list``, ``/arm/scenes/save``, ``/arm/scenes/load`` and ``/arm/scenes/delete``."""
    node = Node("saved scenes")

    async def names(_request: Message) -> Message:
        return {"names": await scenes.names()}

    async def load(name: str) -> str:
        return await scenes.load(name, current.positions_rad())

    async def delete(name: str) -> str:
        await scenes.delete(name)
        return f"the scene {name!r} is deleted"

    def offer(name: str, type_name: str, work: _Work, rule: Rule) -> None:
        async def told(request: Message) -> dict[str, Any]:
            return {"success": True, "message": await work(request["name"])}

        name = f"/arm/scenes/{name}"
        graph.services.offer(node, name, f"armbridge_msgs/srv/{type_name}", telling(name, told, log), rule=rule)

    graph.services.offer(node, "/arm/scenes/list", "armbridge_msgs/srv/ListScenes", names, rule=LOOKING)
    offer("save", "SaveScene", scenes.save, CONFIGURING)
    offer("load", "LoadScene", load, WORKING)
    offer("delete", "DeleteScene", delete, CONFIGURING)

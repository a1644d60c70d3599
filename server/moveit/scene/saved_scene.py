"""Planning scenes in files: the scene between two runs of the server, and scenes that users save by name.

A file holds a moveit_msgs/PlanningScene as JSON, without joints. One server has the file of the present scene from
its start to its end; two servers would take the other's obstacles for their own.
"""

import asyncio
import json
import logging
import time
from collections.abc import Awaitable
from pathlib import Path
from typing import Any

from protocol.codecs.pieces import encoded_pieces, json_notation
from protocol.errors import MessageError
from robot import files
from robot.description.model import RobotModel
from server.disk import Disk
from server.errors import RefusedError, ServiceError
from server.execution.monitors import CurrentState
from server.execution.motions import Positions
from server.graph.message_types import MessageTypes
from server.graph.permissions import CONFIGURING, LOOKING, WORKING
from server.graph.topics import Graph
from server.moveit.messages import Message
from server.moveit.scene.allowed_collision_matrix import AllowedCollisionMatrix
from server.moveit.scene.interface import EVERYTHING, NO_MATRIX, NO_STATE, scene_message
from server.moveit.scene.planning_scene import SceneContents
from server.moveit.scene.scene_state import SceneState
from server.named_files import NamedFiles, read_json, set_aside

log = logging.getLogger("armbridge.scene")

SCENE_TYPE = "moveit_msgs/msg/PlanningScene"
OBJECT_TYPE = "moveit_msgs/msg/CollisionObject"
ATTACHED_TYPE = "moveit_msgs/msg/AttachedCollisionObject"

# A scene of 1000 boxes has half a megabyte, a mesh of 200 000 triangles 15 MB; reading takes a second for 60 MB.
MAX_FILE_BYTES = 64_000_000

# Where a disk takes longer to read the scene, the server begins without it. Where it takes longer to write, the writing
# goes on, and the server works and ends without waiting for it.
DISK_TIMEOUT_S = 20.0

# Time after which a change is written, with the changes since: clients build scenes object by object, and move objects
# many times a second.
DELAY_S = 1.0

# Share of its time that a slow disk may spend on the scene.
WRITING_SHARE = 0.1


class SavedScene:
    """Keeper of the scene: restores it at the start, and writes it after changes, off the event loop."""

    def __init__(self, path: Path, state: SceneState, message_types: MessageTypes) -> None:
        self._path = path
        self._lock = files.FileLock(path)
        self._disk = Disk(DISK_TIMEOUT_S)
        self._state = state
        self._message_types = message_types
        self._kept = state.contents
        self._changed = asyncio.Event()
        self._writing = asyncio.Lock()
        self._keeping: asyncio.Task[None] | None = None
        self._failing = False

    async def start(self) -> None:
        """Restore the scene, and keep its changes from now on; no fault of the file prevents the start."""
        path = self._path
        try:
            # Another server may hold the lock until its end.
            await self._disk.do(lambda: self._lock.acquire(files.LOCK_TIMEOUT_S))
            await self._restore()
        except files.FileLockedError as error:
            remedy = "give one of the two servers a scene.file of its own"
            log.warning("the planning scene is not kept: %s %s; %s", path, error.strerror, remedy)
            return
        except OSError as error:
            self._give_back()
            log.warning("the planning scene is not kept in %s: %s", path, error.strerror)
            return
        self._kept = self._state.contents
        self._state.on_change(self._changed.set)
        self._keeping = asyncio.create_task(self._keep(), name="keep the planning scene")

    async def close(self) -> None:
        """Write the last changes, and give the file back."""
        if self._keeping is None:
            return
        try:
            async with self._writing:
                self._keeping.cancel()
            await self._write()
        finally:
            self._keeping.cancel()
            self._give_back()

    def _give_back(self) -> None:
        """Give the lock back once the disk has ended its work: a late write would replace the next server's scene."""
        self._disk.follow(self._lock.release)

    async def _restore(self) -> None:
        try:
            content = await self._disk.do(lambda: read_json(self._path, MAX_FILE_BYTES))
            self._state.apply_diff(complete_scene(self._message_types, content), None)
        except FileNotFoundError:
            return
        except (ValueError, MessageError, RefusedError) as error:
            aside = set_aside(self._path)
            log.warning("the planning scene in %s cannot be restored: %s; the file is now %s", self._path, error, aside)
            return
        world, held = len(self._state.contents.objects), len(self._state.contents.attached)
        log.info("the planning scene is restored from %s: %d objects, %d of them held", self._path, world + held, held)

    async def _keep(self) -> None:
        clock, delay_s = asyncio.get_running_loop().time, DELAY_S
        while True:
            await self._changed.wait()
            await asyncio.sleep(delay_s)
            self._changed.clear()
            began_s = clock()
            async with self._writing:
                await self._write()
            delay_s = max(DELAY_S, (clock() - began_s) / WRITING_SHARE)

    async def _write(self) -> None:
        """Write the present scene, if it has changed; errors are logged once, until it can be written again."""
        contents = self._state.contents
        if contents is self._kept:
            return
        # What cannot be written is not tried again before the next change.
        self._kept = contents
        try:
            message = kept_message(contents, self._state.robot)
            await self._disk.do(lambda: self._replace(message))
        except Exception as error:  # a bug in writing one scene does not keep the next ones from it
            if not self._failing:
                bug = not isinstance(error, OSError | ValueError)
                log.warning("the planning scene is not kept in %s: %s", self._path, error, exc_info=bug)
            self._failing = True
        else:
            self._failing = False

    def _replace(self, message: Message) -> None:
        """Replace the file; a file of a scene that is too large is removed: an older scene would be a wrong one."""
        try:
            text = encoded_bounded(message, MAX_FILE_BYTES)
        except ValueError:
            self._path.unlink(missing_ok=True)
            raise
        files.replace(self._path, text)


def kept_message(contents: SceneContents, robot: RobotModel) -> Message:
    """Return a scene as the message to keep; a matrix that nobody has changed is left to the SRDF of the next start."""
    message = scene_message(contents, robot, NO_STATE, EVERYTHING)
    if contents.allowed_collisions == AllowedCollisionMatrix.of_robot(robot):
        message["allowed_collision_matrix"] = NO_MATRIX
    return message


def complete_scene(message_types: MessageTypes, content: Any) -> Message:
    """Return the moveit_msgs/PlanningScene of a file, object by object, as they came; raises MessageError for none."""
    complete = message_types.complete
    world: list[Any] = []
    held: list[Any] = []
    if isinstance(content, dict):
        world, content = _taken(content, "world", "collision_objects")
        held, content = _taken(content, "robot_state", "attached_collision_objects")
    message = complete(SCENE_TYPE, content)
    message["world"]["collision_objects"] = [complete(OBJECT_TYPE, each) for each in world]
    message["robot_state"]["attached_collision_objects"] = [complete(ATTACHED_TYPE, each) for each in held]
    return message


def encoded_bounded(message: Message, max_bytes: int) -> bytes:
    """Return a message as JSON, made in a thread beside the event loop; raises ValueError if it is too large."""
    pieces, size = [], 0
    # With numbers that are not finite, in pieces of at most a millisecond.
    for piece in encoded_pieces(message, _NOTATION):
        # Give the interpreter's lock to the event loop, if that waits for it, and not only every 5 ms.
        time.sleep(0)
        pieces.append(piece)
        size += len(piece)
        if size > max_bytes:
            raise ValueError(f"it has more than {max_bytes} bytes as text")
    return b"".join(pieces)


_NOTATION = json_notation(lambda value: json.dumps(value).encode())


def _taken(content: dict[str, Any], part: str, field: str) -> tuple[list[Any], dict[str, Any]]:
    """Take a list out of a part of a message; return the list, and the message without it."""
    inner = content.get(part)
    if not isinstance(inner, dict) or not isinstance(inner.get(field), list):
        return [], content
    return inner[field], {**content, part: {**inner, field: []}}


# As many as a list shows that people read; with MAX_SCENE_BYTES they fill at most 1 GB of a disk.
MAX_SCENES = 50

# A mesh of 80 000 triangles, the largest, has 6 MB as text.
MAX_SCENE_BYTES = 20_000_000


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
            await self._state.submit(self._state.diff(message), positions_rad)
        except (MessageError, RefusedError) as error:
            raise ServiceError(f"the scene {name!r} cannot be loaded: {error}") from error
        return f"the scene {name!r} is loaded, with {objects_in_words(self._state.contents)}"


def offer_named_scenes(graph: Graph, scenes: NamedScenes, current: CurrentState) -> None:
    """Offer ``/arm/scenes/list``, ``/arm/scenes/save``, ``/arm/scenes/load`` and ``/arm/scenes/delete``."""
    node = graph.node("saved scenes")

    def load(request: Message) -> Awaitable[str]:
        return scenes.load(request["name"], current.positions_rad())

    node.offer("/arm/scenes/list", "armbridge_msgs/srv/ListScenes", scenes.list_for, rule=LOOKING)
    node.offer(
        "/arm/scenes/save", "armbridge_msgs/srv/SaveScene", lambda each: scenes.save(each["name"]), rule=CONFIGURING
    )
    node.offer("/arm/scenes/load", "armbridge_msgs/srv/LoadScene", load, rule=WORKING)
    node.offer("/arm/scenes/delete", "armbridge_msgs/srv/DeleteScene", scenes.delete_for, rule=CONFIGURING)

"""Messages between the server and a planner process, and the transfer of scenes.

The server sends :class:`LoadRobot` once. Then, in any number: a scene as :class:`NewScene` followed by
:class:`MoreObjects` until it is whole, and requests, the next after the answer to the last. Each request gets one
:class:`Answered`, and a problem that takes longer than most :class:`StillSearching` before. Both ends know a scene by
its version, and it is sent once; after a break it is sent again from its beginning.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass

from planners.problem import Answer, Request
from planners.scene import EMPTY_SCENE, Mesh, Scene, SceneObject
from robot.description.model import RobotModel


@dataclass(frozen=True)
class LoadRobot:
    """First message to a worker and its template: the arm to plan for, and the memory that each may use [bytes]."""

    robot: RobotModel
    memory_limit_bytes: int


@dataclass(frozen=True)
class Loaded:
    """A worker, or a host of planners that has workers of these process ids, is ready for requests."""

    pids: tuple[int, ...] = ()


@dataclass(frozen=True)
class LoadFailed:
    """The worker cannot plan for this robot."""

    reason: str


@dataclass(frozen=True)
class NewScene:
    """The scene of the requests that follow, without its objects."""

    scene: Scene


@dataclass(frozen=True)
class MoreObjects:
    """Further objects of the scene, in its order: large scenes come in parts that are quick to pack."""

    objects: tuple[SceneObject, ...]


@dataclass(frozen=True)
class Ask:
    """One request; the number comes back with the answer."""

    number: int
    request: Request


@dataclass(frozen=True)
class Cancel:
    """Cancellation of a request; if it is still worked on, it is answered PREEMPTED at once."""

    number: int


@dataclass(frozen=True)
class StillSearching:
    """A planning problem exceeds the typical planning time; sent again each time that its own has doubled."""

    number: int
    spent_s: float  # allowed time that is spent on it [s]


@dataclass(frozen=True)
class Answered:
    """The answer to a request; ``ending`` if the worker ends now, so that a fresh one must take its place."""

    number: int
    answer: Answer
    ending: bool = False


OBJECT_BYTES = 8 << 10  # what packing an object costs, in terms of a mesh's bytes (which are only copied): 3 us

# This much of a scene is packed within half a millisecond; the server's event loop has its turns between the parts.
PART_BYTES = 1 << 20


class SceneSender:
    """Scenes on their way to one receiver, with a ``pause`` before each part; ``complete`` once all is sent."""

    def __init__(self, send: Callable[[object], None], pause: Callable[[], Awaitable[None]]) -> None:
        self._send_message, self._pause = send, pause
        self._version = EMPTY_SCENE.version
        self.complete = True

    def has_sent(self, scene: Scene) -> bool:
        """Return true if the receiver has this scene."""
        return self.complete and self._version == scene.version

    async def send(self, scene: Scene) -> None:
        """Send a scene unless the receiver has it."""
        if self.has_sent(scene):
            return
        self.complete = False
        self._send_message(NewScene(dataclasses.replace(scene, objects=())))
        for objects in parts(scene.objects):
            await self._pause()
            self._send_message(MoreObjects(objects))
        self._version, self.complete = scene.version, True


class SceneReceiver:
    """Scene at its receiver, as its parts arrive."""

    def __init__(self) -> None:
        self._scene = EMPTY_SCENE
        self._more: list[SceneObject] = []

    def take(self, message: NewScene | MoreObjects) -> None:
        """Take the beginning of a scene, which drops the one before, or more objects of it."""
        if isinstance(message, NewScene):
            self._scene, self._more = message.scene, []
        else:
            self._more += message.objects

    def scene(self) -> Scene:
        """Return the scene of all that has arrived."""
        if self._more:
            self._scene = dataclasses.replace(self._scene, objects=(*self._scene.objects, *self._more))
            self._more = []
        return self._scene


def parts(objects: tuple[SceneObject, ...]) -> Iterator[tuple[SceneObject, ...]]:
    """Divide objects, in their order, into parts that are quickly packed."""
    part: list[SceneObject] = []
    size = 0
    for each in objects:
        part.append(each)
        size += packed_bytes(each)
        if size >= PART_BYTES:
            yield tuple(part)
            part, size = [], 0
    if part:
        yield tuple(part)


def packed_bytes(packed: SceneObject) -> int:
    """Return the cost of packing an object, in terms of a mesh's bytes."""
    meshes = (shape for shape, _ in packed.shapes if isinstance(shape, Mesh))
    return OBJECT_BYTES + sum(mesh.vertices_m.nbytes + mesh.triangles.nbytes for mesh in meshes)

"""What runs in a Dask worker: the handling of its own planner processes, which do the work.

The planners hold the interpreter's lock for long, may hang in native code and may crash: a Dask worker that had them in
its own process would be taken for dead by its scheduler. So each Dask worker has a :class:`PlannerPool` of its own,
with all of that pool's guards, and these functions run in its event loop.
"""

from __future__ import annotations

import asyncio
import itertools
import pickle
from collections import OrderedDict
from typing import Any

from planners.cluster import contract
from planners.cluster.messages import Missing, SceneKey
from planners.pool import PlannerPool
from planners.problem import Answer, MoveItErrorCode, PlanningFailure, Request
from planners.scene import EMPTY_SCENE, Scene, SceneObject

# Begin of the tasks' names on the cluster; what follows is the token.
TASK_PREFIX = "armbridge-plan-"

# How soon a task notices that nobody waits for it any more.
WITHDRAWN_POLL_S = 0.02

# Loading the robot takes half a second; a loaded machine may take many times that.
READY_TIMEOUT_S = 25.0

# Robots whose processes are kept warm, and scenes kept for each robot: of a few servers that share the cluster.
MAX_ROBOTS = 4
MAX_SCENES = 4


class Bench:
    """The planner processes for one robot, and the scenes that they are asked in."""

    def __init__(self, pool: PlannerPool) -> None:
        self.pool = pool
        self._scenes: OrderedDict[SceneKey, Scene] = OrderedDict()
        self._coming: OrderedDict[str, tuple[Scene, list[SceneObject]]] = OrderedDict()
        self._versions = itertools.count(EMPTY_SCENE.version + 1)

    def scene(self, key: SceneKey) -> Scene | None:
        """The scene that a server calls so; None when it has not been sent, or was given up for others."""
        if key.version == EMPTY_SCENE.version:
            return EMPTY_SCENE
        if key in self._scenes:
            self._scenes.move_to_end(key)
        return self._scenes.get(key)

    def begin(self, upload: str, scene: Scene) -> None:
        """Begin to take a scene; the objects come in parts."""
        self._coming[upload] = (scene, [])
        while len(self._coming) > MAX_SCENES:
            self._coming.popitem(last=False)

    def extend(self, upload: str, objects: tuple[SceneObject, ...]) -> None:
        """Take further objects; nothing happens when the upload was given up for others."""
        if upload in self._coming:
            self._coming[upload][1].extend(objects)

    def finish(self, upload: str, key: SceneKey) -> None:
        """The scene is whole; nothing happens when the upload was given up for others."""
        scene, objects = self._coming.pop(upload, (None, []))
        if scene is None:
            return
        # Servers count their scenes alike; the processes tell scenes apart by a number that only this worker gives.
        self._scenes[key] = Scene(**{**vars(scene), "objects": tuple(objects), "version": next(self._versions)})
        while len(self._scenes) > MAX_SCENES:
            self._scenes.popitem(last=False)


_benches: OrderedDict[str, Bench] = OrderedDict()


async def agree() -> str:
    """Tell what this worker runs."""
    return contract.contract()


async def take_robot(digest: str, robot: bytes, memory_limit_bytes: int, dask_worker: Any = None) -> str | None:
    """Start planner processes for a robot, unless there are some, as many as the worker has threads.

    Returns:
        Why they cannot plan; None when they can.
    """
    if digest not in _benches:
        pool = PlannerPool(pickle.loads(robot), dask_worker.state.nthreads, memory_limit_bytes)  # noqa: S301 - a server's
        _benches[digest] = Bench(pool)
        try:
            await pool.start()
        except OSError:
            del _benches[digest]
            raise
    _benches.move_to_end(digest)
    refusal = await _benches[digest].pool.wait_ready(READY_TIMEOUT_S)
    while len(_benches) > MAX_ROBOTS:
        _, oldest = _benches.popitem(last=False)
        await oldest.pool.close()
    return refusal


async def take_scene_part(digest: str, upload: str, part: bytes) -> None:
    """Take a scene without objects, which begins an upload; objects; or a key, which ends it."""
    bench = _benches.get(digest)
    if bench is None:
        return
    match pickle.loads(part):  # noqa: S301 - a server's, whose tasks this worker runs anyway
        case Scene() as scene:
            bench.begin(upload, scene)
        case SceneKey() as key:
            bench.finish(upload, key)
        case objects:
            bench.extend(upload, objects)


async def answer(token: str, digest: str, scene_key: bytes, request: bytes) -> Answer | Missing:
    """Answer a request as a planner process does, until the task is withdrawn.

    Args:
        token: the rest of the task's name.
        digest: of the robot.
        scene_key: pickled; Dask looks into tuples.
        request: pickled.
    """
    from distributed import get_worker

    worker = get_worker()
    bench = _benches.get(digest)
    scene = bench.scene(pickle.loads(scene_key)) if bench is not None else None  # noqa: S301 - a server's
    if bench is None or scene is None:
        return Missing(worker.address, robot=bench is None)
    packed: Request = pickle.loads(request)  # noqa: S301 - a server's
    asking: asyncio.Task[Answer] = asyncio.create_task(bench.pool.ask(packed, scene))
    try:
        while not asking.done():
            if _withdrawn(worker, TASK_PREFIX + token):
                return PlanningFailure(MoveItErrorCode.PREEMPTED, "the task was taken back")
            await asyncio.wait([asking], timeout=WITHDRAWN_POLL_S)
        return asking.result()
    finally:
        # One that is done stays as it is.
        asking.cancel()


def _withdrawn(worker: Any, key: str) -> bool:
    """Whether the scheduler has taken a running task back: its client gave it up or is gone."""
    task = worker.state.tasks.get(key)
    return task is None or task.state == "cancelled"

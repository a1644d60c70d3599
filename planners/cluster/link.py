"""One connection to a Dask scheduler, and what a server sends over it."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import hashlib
import pickle
import uuid
from collections.abc import Callable, Coroutine, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from planners.cluster import tasks
from planners.cluster.contract import contract
from planners.cluster.messages import Missing, SceneKey
from planners.problem import Request
from planners.scene import Scene
from planners.worker_process import parts
from robot.description.model import RobotModel

if TYPE_CHECKING:
    from distributed import Client, Future

# A call of a worker's function outside of its tasks takes milliseconds; a robot is loaded within READY_TIMEOUT_S.
RUN_TIMEOUT_S = tasks.READY_TIMEOUT_S + 5.0

# Goodbye to a scheduler that may be gone.
CLOSE_TIMEOUT_S = 0.2


class Link:
    """One connection to a scheduler.

    Args:
        client: of this event loop; connected before anything is asked of the link.
        robot: the arm to plan for.
        memory_limit_bytes: what each planner process may use for data.

    Attributes:
        members: addresses of the workers that plan for this server.
    """

    def __init__(self, client: Client, robot: RobotModel, memory_limit_bytes: int) -> None:
        self._client = client
        self._memory_limit_bytes = memory_limit_bytes
        self._robot = pickle.dumps(robot, protocol=pickle.HIGHEST_PROTOCOL)
        self._digest = digest(robot, memory_limit_bytes)
        self._name = uuid.uuid4().hex
        self.members: Sequence[str] = ()

    @property
    def open(self) -> bool:
        """Whether the scheduler is in reach, as far as is known."""
        return bool(self._client.status == "running")

    async def threads(self, timeout_s: float) -> dict[str, int]:
        """Ask the scheduler for its workers' addresses and how many tasks each takes at the same time.

        Raises:
            OSError: it is out of reach.
            TimeoutError: it does not answer.
        """
        async with asyncio.timeout(timeout_s):
            return dict(await self._client.nthreads())

    async def recruit(self, worker: str) -> str | None:
        """Make a worker ready to plan for this server.

        Returns:
            Why it cannot; None when it can.

        Raises:
            OSError: it is out of reach.
            TimeoutError: it does not answer.
        """
        try:
            theirs = await self._run(worker, tasks.agree)
        except (ImportError, AttributeError) as error:
            return f"it cannot run armbridge: {error}; install there what runs here, armbridge {contract()}"
        if theirs != contract():
            return f"it runs armbridge {theirs}, this server {contract()}: install the same on both"
        refusal: str | None = await self._send_robot(worker)
        return refusal

    def submit(self, request: Request, scene: Scene, worker: str | None) -> Future[Any]:
        """Have a worker answer a request: a certain one if it can, else any.

        Returns:
            Dask's future of the answer, or of :class:`Missing`.

        Raises:
            ConnectionError: the scheduler is gone.
        """
        if not self.open:
            raise ConnectionError("the scheduler is gone")
        token = uuid.uuid4().hex
        packed = pickle.dumps(request, protocol=pickle.HIGHEST_PROTOCOL)
        return self._client.submit(
            tasks.answer,
            token,
            self._digest,
            pickle.dumps(self._key(scene)),
            packed,
            key=tasks.TASK_PREFIX + token,
            workers=[worker] if worker else list(self.members),
            allow_other_workers=worker is not None,
            pure=False,
        )

    async def supply(self, missing: Missing, scene: Scene) -> None:
        """Send a worker what it lacks.

        Raises:
            OSError: it is out of reach.
            TimeoutError: it does not answer.
        """
        if missing.robot:
            await self._send_robot(missing.worker)
        upload = uuid.uuid4().hex
        for part in self._scene_parts(scene):
            packed = pickle.dumps(part, protocol=pickle.HIGHEST_PROTOCOL)
            await self._run(missing.worker, tasks.take_scene_part, self._digest, upload, packed)

    async def close(self) -> None:
        """Leave the scheduler, whether it hears of it or not."""
        with contextlib.suppress(OSError, TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await self._client.close()

    async def _send_robot(self, worker: str) -> Any:
        return await self._run(worker, tasks.take_robot, self._digest, self._robot, self._memory_limit_bytes)

    def _key(self, scene: Scene) -> SceneKey:
        return SceneKey(self._name, scene.version)

    def _scene_parts(self, scene: Scene) -> Iterator[object]:
        """What :func:`tasks.take_scene_part` takes, each quickly packed."""
        yield dataclasses.replace(scene, objects=())
        yield from parts(scene.objects)
        yield self._key(scene)

    async def _run(self, worker: str, function: Callable[..., Coroutine[Any, Any, Any]], *arguments: object) -> Any:
        async with asyncio.timeout(RUN_TIMEOUT_S):
            results = await self._client.run(function, *arguments, workers=[worker])
        if worker not in results:
            raise ConnectionError(f"the worker {worker} has left")
        return results[worker]


def digest(robot: RobotModel, memory_limit_bytes: int) -> str:
    """What tells processes for one robot from those for another; the same whichever server computes it.

    Not of the pickled robot: sets are pickled in another order by every process.
    """
    made = hashlib.sha256()
    # Groups, named states and pairs are what the SRDF says.
    described = (memory_limit_bytes, robot.urdf, robot.srdf, str(robot.mesh_directory), *robot.joints.values())
    made.update(repr(described).encode())
    for link, hull in sorted(robot.hulls.items()):
        made.update(link.encode() + hull.vertices.tobytes() + hull.triangles.tobytes())
    for link, shapes in sorted(robot.parts.items()):
        made.update(link.encode() + b"".join(shape.tobytes() for shape in shapes))
    return made.hexdigest()

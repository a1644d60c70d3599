"""Host of planners that several servers share: one pool, reached over a Unix socket.

A server's connection (:mod:`planners.shared_pool`) carries the messages of :mod:`planners.messages`: scenes in parts,
and requests, several at a time. The pool gives turns in the order in which requests come. A server
asks for one motion and one question at a time, so however many goals one has, it takes one turn of each round.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import itertools
import logging
from pathlib import Path
from typing import Any

from planners.messages import Answered, Ask, Cancel, Loaded, LoadFailed, MoreObjects, NewScene
from planners.pool import MEMORY_LIMIT_BYTES, PlannerPool
from planners.problem import MoveItErrorCode, PlanningFailure, Request, TimedRequest
from planners.scene import EMPTY_SCENE, Scene
from planners.scene_transfer import SceneReceiver
from robot.channel import Decoder, encode
from robot.description.model import RobotModel

log = logging.getLogger("armbridge.planners")

# Longest planning of one request, whatever it allows itself: others wait for the same planners. MoveIt's default is 5.
LONGEST_PLANNING_S = 10.0

# A server that asks for one motion and one question at a time has two requests under way.
REQUESTS_OF_SERVER = 2

READ_BYTES = 64 << 10


class PlannerHost:
    """Host of one pool of planners that a number of ``servers`` share.

    Every user who can open the Unix socket at ``address`` is trusted, so its folder is the user's alone.
    """

    def __init__(
        self,
        robot: RobotModel,
        address: Path,
        servers: int,
        active: int,
        questions: int,
        memory_limit_bytes: int = MEMORY_LIMIT_BYTES,
    ) -> None:
        self._address = address
        # No races: another server's goal may need the worker.
        self._pool = PlannerPool(
            robot, active, memory_limit_bytes, questions, max_waiting=REQUESTS_OF_SERVER * servers, racing=False
        )
        self._versions = itertools.count(EMPTY_SCENE.version + 1)
        self._writers: set[asyncio.StreamWriter] = set()

    async def run(self) -> None:
        """Serve until cancelled; OSError: the socket cannot be made, or a process cannot be started."""
        self._address.unlink(missing_ok=True)
        server = await asyncio.start_unix_server(self._serve, self._address)
        try:
            async with server:
                await self._pool.start()
                await server.serve_forever()
        finally:
            for writer in self._writers:
                writer.close()
            await self._pool.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one server until it closes its connection, which cancels its requests."""
        connection = _Connection(self._pool, writer, self._versions)
        self._writers.add(writer)
        try:
            refusal = await self._pool.wait_until_loaded()
            writer.write(encode(Loaded(self._pool.pids) if refusal is None else LoadFailed(refusal)))
            decoder = Decoder()
            while data := await reader.read(READ_BYTES):
                for message in decoder.feed(data):
                    connection.take(message)
        except (OSError, ValueError) as error:
            log.debug("the connection of a server to the planners ends: %s", error)
        finally:
            self._writers.discard(writer)
            connection.close()
            writer.close()


class _Connection:
    """Requests of one server, and its scene, whose version no other server's scene has."""

    def __init__(self, pool: PlannerPool, writer: asyncio.StreamWriter, versions: itertools.count[int]) -> None:
        self._pool = pool
        self._writer = writer
        self._versions = versions
        self._scene = SceneReceiver()
        self._tasks: dict[int, asyncio.Task[None]] = {}

    def take(self, message: Any) -> None:
        match message:
            case NewScene(scene):
                self._scene.take(NewScene(dataclasses.replace(scene, version=next(self._versions))))
            case MoreObjects():
                self._scene.take(message)
            case Ask(number, request):
                answering = self._answer(number, bounded(request), self._scene.scene())
                self._tasks[number] = task = asyncio.create_task(answering, name="planners' request")
                task.add_done_callback(lambda _: self._tasks.pop(number, None))
            case Cancel(number) if number in self._tasks:
                self._tasks[number].cancel()

    def close(self) -> None:
        for task in self._tasks.values():
            task.cancel()

    async def _answer(self, number: int, request: Request, scene: Scene) -> None:
        try:
            answer = await self._pool.ask(request, scene)
        except asyncio.CancelledError:
            raise
        except Exception as error:  # whatever a request does must not leave its server without an answer
            log.exception("a request to the planners failed")
            answer = PlanningFailure(MoveItErrorCode.CRASH, f"the planners failed: {type(error).__name__}: {error}")
        # A server that has gone needs no answer.
        with contextlib.suppress(OSError):
            self._writer.write(encode(Answered(number, answer)))


def bounded(request: Request) -> Request:
    """Return the request with no more planning time than :data:`LONGEST_PLANNING_S`."""
    if isinstance(request, TimedRequest):
        return dataclasses.replace(request, allowed_time_s=min(request.allowed_time_s, LONGEST_PLANNING_S))
    return request

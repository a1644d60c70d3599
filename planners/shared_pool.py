"""Planners that several servers share: the host of one pool at a Unix socket, and the connection of each server to it.

A connection carries the messages of :mod:`planners.messages`: scenes in parts, and requests, several at a time. The
pool gives turns in the order in which requests come. A server asks for one motion and one question at a time, so
however many goals one has, it takes one turn of each round.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import itertools
import logging
import time
from pathlib import Path
from typing import Any

from planners.interface import LOAD_TIMEOUT_S, Planners
from planners.messages import (
    Answered,
    Ask,
    Cancel,
    Loaded,
    LoadFailed,
    MoreObjects,
    NewScene,
    SceneReceiver,
    SceneSender,
)
from planners.pool import MEMORY_LIMIT_BYTES, PlannerPool
from planners.problem import Answer, MoveItErrorCode, PlanningFailure, Request, TimedRequest
from planners.scene import EMPTY_SCENE, Scene
from robot.channel import Decoder, encode
from robot.description.model import RobotModel
from robot.processes import RestartDelay

log = logging.getLogger("armbridge.planners")

# Longest planning of one request, whatever it allows itself: others wait for the same planners. MoveIt's default is 5.
LONGEST_PLANNING_S = 10.0

REQUESTS_OF_SERVER = 2  # a server that asks for one motion and one question at a time has two requests under way

# Rounds that a request may wait for its turn, each of the longest planning: the host itself answers long before.
ROUNDS = 6
ANSWER_TIMEOUT_S = ROUNDS * LONGEST_PLANNING_S

READ_BYTES = 64 << 10


class PlannerHost:
    """Host of one pool for ``servers``; every user who can open the socket at ``address`` is trusted."""

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
            await self._pool.start()
            await asyncio.Event().wait()
        finally:
            # From Python 3.12.1 on, `Server.serve_forever` ends only when every client has left.
            server.close()
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


class SharedPlanners(Planners):
    """Connection to a host of planners: one motion and one question at a time."""

    def __init__(self, address: Path) -> None:
        super().__init__()
        self._address = address
        self._numbers = itertools.count(1)
        self._answers: dict[int, asyncio.Future[Answer]] = {}
        self._pids: tuple[int, ...] = ()
        self._hosted = asyncio.Event()
        self._hosted_or_refused = asyncio.Event()
        self._writer: asyncio.StreamWriter | None = None
        self._sending = asyncio.Lock()
        self._scenes = SceneSender(self._write, self._drain)
        self._connecting: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Begin to connect; requests sent meanwhile wait."""
        self._connecting = asyncio.create_task(self._stay_connected(), name="connection to the planners")

    async def close(self) -> None:
        """Close the connection."""
        if self._connecting is not None:
            self._connecting.cancel()
            await asyncio.wait([self._connecting])

    async def wait_until_loaded(self) -> str | None:
        """Wait until the host has planners; return the reason for which they cannot plan for the robot, else None."""
        await self._hosted_or_refused.wait()
        return self.load_failure

    @property
    def pids(self) -> tuple[int, ...]:
        """Ids of the shared processes; none while there is no connection."""
        return self._pids

    @property
    def idle_count(self) -> int:
        """Number of shared processes while none works for this server."""
        return len(self._pids) if not self._answers else 0

    async def _answer(self, request: Request, scene: Scene) -> Answer:
        try:
            async with asyncio.timeout(LOAD_TIMEOUT_S):
                await self._hosted.wait()
        except TimeoutError:
            reason = self.load_failure or f"the shared planners were not ready within {LOAD_TIMEOUT_S:g} s"
            return PlanningFailure(MoveItErrorCode.FAILURE, f"planning is not available: {reason}")
        number = next(self._numbers)
        answer: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        self._answers[number] = answer
        try:
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                async with self._sending:
                    await self._scenes.send(scene)
                    self._write(Ask(number, request))
                return await answer
        except TimeoutError:
            self._write(Cancel(number))
            message = f"the shared planners did not answer within {ANSWER_TIMEOUT_S:g} s"
            return PlanningFailure(MoveItErrorCode.TIMED_OUT, message)
        except ValueError as error:
            return PlanningFailure(MoveItErrorCode.FAILURE, f"the problem cannot be given to a planner: {error}")
        except asyncio.CancelledError:
            self._write(Cancel(number))
            raise
        finally:
            self._answers.pop(number, None)

    def _write(self, message: object) -> None:
        if self._writer is not None:
            self._writer.write(encode(message))

    async def _drain(self) -> None:
        if self._writer is not None:
            with contextlib.suppress(OSError):
                await self._writer.drain()

    async def _stay_connected(self) -> None:
        delay = RestartDelay()
        while True:
            began_s = time.monotonic()
            try:
                reader, self._writer = await asyncio.open_unix_connection(self._address)
                await self._receive(reader)
            except (OSError, ValueError) as error:
                log.debug("the shared planners cannot be reached: %s", error)
            finally:
                self._disconnect()
            await asyncio.sleep(delay.after(time.monotonic() - began_s))

    async def _receive(self, reader: asyncio.StreamReader) -> None:
        decoder = Decoder()
        while data := await reader.read(READ_BYTES):
            for message in decoder.feed(data):
                match message:
                    case Loaded(pids):
                        self._pids, self.load_failure = pids, None
                        self._hosted.set()
                        self._hosted_or_refused.set()
                    case LoadFailed(reason):
                        self.load_failure = reason
                        self._hosted_or_refused.set()
                    case Answered(number, answer) if (waiting := self._answers.get(number)) and not waiting.done():
                        waiting.set_result(answer)

    def _disconnect(self) -> None:
        """Answer open requests: the host has ended, or this server does."""
        if self._writer is not None:
            self._writer.close()
        self._writer, self._pids = None, ()
        self._scenes = SceneSender(self._write, self._drain)
        self._hosted.clear()
        for waiting in self._answers.values():
            if not waiting.done():
                waiting.set_result(PlanningFailure(MoveItErrorCode.CRASH, "the shared planners ended meanwhile"))
